// The whole tick as one C function: Pinocchio's own algorithms and eq. (6) in block form, recorded and written out by CppADCodeGen.
//
// usage: generate_tick DIR; writes DIR/cppad_tick.c with the numbers of model.csv and params.csv as constants.
#include <cppad/cg.hpp>
#include <pinocchio/codegen/cppadcg.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>
#include <fstream>
#include <iostream>
#include <sstream>

namespace {

namespace pin = pinocchio;
using Code = CppAD::cg::CG<double>;
using Number = CppAD::AD<Code>;
template <int R, int C = 1> using Matrix = Eigen::Matrix<Number, R, C>;

std::vector<std::vector<double>> rows(const std::string &path) {
  std::ifstream file(path);
  std::vector<std::vector<double>> all;
  for (std::string line; std::getline(file, line);) {
    all.emplace_back();
    std::istringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) all.back().push_back(std::atof(cell.c_str()));
  }
  return all;
}

// Numbers from the left. What rounding left of a 0 or a 1 is one: the generator folds it.
struct Taken {
  const double *at;
  static double plain(double value) { return std::abs(value - std::round(value)) < 1e-12 ? std::round(value) : value; }
  template <int R, int C = 1> Matrix<R, C> next() {
    Matrix<R, C> out;
    for (int i = 0; i < R; ++i)
      for (int j = 0; j < C; ++j) out(i, j) = Number(plain(*at++));
    return out;
  }
};

// A⁻¹ by Cholesky, in halves: no branch may depend on a number.
template <int N> struct Factor {
  Matrix<N, N> low = Matrix<N, N>::Zero();
  Matrix<N> inverse;
  explicit Factor(const Matrix<N, N> &a) {
    for (int j = 0; j < N; ++j) {
      Number pivot = a(j, j);
      for (int k = 0; k < j; ++k) pivot -= low(j, k) * low(j, k);
      low(j, j) = CppAD::sqrt(pivot);
      inverse(j) = 1.0 / low(j, j);
      for (int i = j + 1; i < N; ++i) {
        Number value = a(i, j);
        for (int k = 0; k < j; ++k) value -= low(i, k) * low(j, k);
        low(i, j) = value * inverse(j);
      }
    }
  }
  template <int C> Matrix<N, C> forward(Matrix<N, C> b) const {
    for (int c = 0; c < C; ++c)
      for (int i = 0; i < N; ++i) {
        for (int k = 0; k < i; ++k) b(i, c) -= low(i, k) * b(k, c);
        b(i, c) *= inverse(i);
      }
    return b;
  }
  Matrix<N> back(Matrix<N> b) const {
    for (int i = N - 1; i >= 0; --i) {
      for (int k = i + 1; k < N; ++k) b(i) -= low(k, i) * b(k);
      b(i) *= inverse(i);
    }
    return b;
  }
};

}  // namespace

int main(int, char **argv) {
  const std::string folder = argv[1];
  const auto table = rows(folder + "/model.csv"), numbers = rows(folder + "/params.csv");
  pin::ModelTpl<Number> model;
  pin::JointIndex parent = 0;
  for (int joint = 0; joint < 7; ++joint) {
    Taken t{table[joint].data()};
    const auto turn = t.next<3, 3>();
    const auto place = t.next<3>();
    const Number mass = t.next<1>()(0);
    const auto com = t.next<3>();
    const auto inertia = t.next<3, 3>();
    parent = model.addJoint(parent, pin::JointModelRevoluteTpl<Number, 0, 2>(), pin::SE3Tpl<Number>(turn, place),
                            "joint" + std::to_string(joint + 1));
    model.appendBodyToJoint(parent, pin::InertiaTpl<Number>(mass, com, inertia), pin::SE3Tpl<Number>::Identity());
  }
  Taken frame{table[7].data()};
  const auto tool_turn = frame.next<3, 3>();
  const auto tool = model.addFrame(pin::FrameTpl<Number>("tool", parent, 0, pin::SE3Tpl<Number>(tool_turn, frame.next<3>()), pin::OP_FRAME));
  pin::DataTpl<Number> data(model);
  Taken p{numbers[0].data()};
  const auto mount = p.next<3>(), virtual_mass = p.next<3>();
  const auto weight = p.next<10>();
  const auto stiffness = p.next<6>(), damping = p.next<6>();
  const auto posture_stiffness = p.next<7>(), posture_damping = p.next<7>(), posture = p.next<7>();

  using Vector = Eigen::Matrix<Number, Eigen::Dynamic, 1>;
  Vector in(41);
  for (int i = 0; i < 41; ++i) in[i] = Number(0.05 + 0.1 * i);
  CppAD::Independent(in);
  const Vector q = in.segment(3, 7), v = in.segment(13, 7);
  pin::crba(model, data, q, pin::Convention::LOCAL);
  pin::nonLinearEffects(model, data, q, v);
  pin::computeJointJacobians(model, data, q);
  pin::updateFramePlacement(model, data, tool);
  Eigen::Matrix<Number, 6, Eigen::Dynamic> of_arm = Eigen::Matrix<Number, 6, Eigen::Dynamic>::Zero(6, 7);
  pin::getFrameJacobian(model, data, tool, pin::LOCAL_WORLD_ALIGNED, of_arm);

  const Number cos = CppAD::cos(in[2]), sin = CppAD::sin(in[2]);
  Matrix<3, 3> turn = Matrix<3, 3>::Zero();
  turn(0, 0) = turn(1, 1) = cos;
  turn(1, 0) = sin;
  turn(0, 1) = -sin;
  turn(2, 2) = Number(1);
  const Matrix<3> lever = turn * (mount + data.oMf[tool].translation());
  const Matrix<3, 3> rotation = turn * data.oMf[tool].rotation();
  Matrix<6, 10> jacobian = Matrix<6, 10>::Zero();
  jacobian(0, 0) = jacobian(1, 1) = jacobian(5, 2) = Number(1);
  jacobian(0, 2) = -lever[1];
  jacobian(1, 2) = lever[0];
  jacobian.topRightCorner<3, 7>() = turn * of_arm.topRows(3);
  jacobian.bottomRightCorner<3, 7>() = turn * of_arm.bottomRows(3);
  Matrix<6> error = Matrix<6>::Zero();
  for (int i = 0; i < 3; ++i) error[i] = in[29 + i] - lever[i] - (i < 2 ? in[i] : Number(0));
  for (int k = 0; k < 3; ++k) {
    const Matrix<3> wanted(in[20 + k], in[23 + k], in[26 + k]);
    error.tail<3>() += Number(0.5) * Matrix<3>(rotation.col(k)).cross(wanted);
  }
  const Matrix<10> rates = in.segment(10, 10);
  const Matrix<6> twist = in.segment(32, 6);
  const Matrix<6> force = damping.cwiseProduct(twist - jacobian * rates) + stiffness.cwiseProduct(error);
  Matrix<10> null;
  null.head<3>() = in.tail(3);
  null.tail<7>() = posture_stiffness.cwiseProduct(posture - q) - posture_damping.cwiseProduct(v);
  const Matrix<10> wanted = jacobian.transpose() * force - null;
  const Number base = 1.0 / (weight[0] * weight[0]), arm = 1.0 / (weight[3] * weight[3]);
  Matrix<7, 7> mass = data.M;
  for (int i = 0; i < 7; ++i)
    for (int j = 0; j < i; ++j) mass(i, j) = mass(j, i);
  const Factor<7> factor(mass);
  const Matrix<7, 6> y = factor.forward<6>(jacobian.rightCols<7>().transpose());
  const Matrix<7> right = factor.forward<1>(wanted.tail<7>());
  Matrix<3, 6> of_base = jacobian.leftCols<3>().transpose();
  for (int i = 0; i < 3; ++i) of_base.row(i) *= 1.0 / virtual_mass[i];
  const Factor<6> inner(arm * (y.transpose() * y) + base * (jacobian.leftCols<3>() * of_base));
  const Matrix<6> z = inner.back(inner.forward<1>(y.transpose() * right + of_base.transpose() * wanted.head<3>()));
  Vector torque(10);
  torque.head(3) = null.head<3>() + base * (jacobian.leftCols<3>().transpose() * z);
  torque.tail(7) = null.tail<7>() + arm * (jacobian.rightCols<7>().transpose() * z) + data.nle;

  CppAD::ADFun<Code> function(in, torque);
  function.optimize();
  CppAD::cg::CodeHandler<double> handler;
  std::vector<Code> variables(41);
  handler.makeVariables(variables);
  std::vector<Code> result = function.Forward(0, variables);
  CppAD::cg::LanguageC<double> language("double");
  language.setGenerateFunction("cppad_tick");
  CppAD::cg::LangCDefaultVariableNameGenerator<double> names;
  std::ofstream out(folder + "/cppad_tick.c");
  handler.generateCode(out, language, result, names);
}
