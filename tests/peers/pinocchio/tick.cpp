// Ticks of others on the data of generate.py: Pinocchio with Eigen, and C that CasADi (generate_tick.py) and CppADCodeGen
// (generate_tick.cpp) generated.
//
// usage: tick DIR [PASSES]; prints a JSON object a line: name, ns_min and ns_median of a pass over all inputs, per tick, and the largest relative error.
// Exits non-zero if a tick is further than 1e-9 from ref.csv, over the largest torque of its row.
#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>
#include <sstream>
#include <string>
#include <vector>

// What the generated C declares of atomic functions, of which this tick has none.
struct LangCAtomicFun {
  void *library;
  void *forward, *reverse;
};
extern "C" void cppad_tick(const double *const *in, double *const *out, LangCAtomicFun atomic);
extern "C" int casadi_tick(const double **arg, double **res, long long *iw, double *w, int mem);
extern "C" int casadi_tick_work(long long *sz_arg, long long *sz_res, long long *sz_iw, long long *sz_w);

namespace {

namespace pin = pinocchio;
template <int R, int C = 1> using Matrix = Eigen::Matrix<double, R, C>;
using Rows = std::vector<std::vector<double>>;
using Torque = Matrix<10>;

Rows rows(const std::string &path) {
  std::ifstream file(path);
  if (!file) {
    std::fprintf(stderr, "cannot open %s: generate.py writes it\n", path.c_str());
    std::exit(2);
  }
  Rows all;
  for (std::string line; std::getline(file, line);) {
    std::istringstream cells(line);
    all.emplace_back();
    for (std::string cell; std::getline(cells, cell, ',');) all.back().push_back(std::atof(cell.c_str()));
  }
  return all;
}

// Numbers of a row, taken from the left.
struct Taken {
  const double *at;
  template <int R, int C = 1> Matrix<R, C> next() {
    const double *from = at;
    at += R * C;
    if constexpr (C == 1) return Eigen::Map<const Matrix<R>>(from);
    else return Eigen::Map<const Eigen::Matrix<double, R, C, Eigen::RowMajor>>(from);
  }
};

struct Parameters {
  Matrix<3> mount, virtual_mass;
  Matrix<10> weight;
  Matrix<6> stiffness, damping;
  Matrix<7> posture_stiffness, posture_damping, posture;
  explicit Parameters(Taken t)
      : mount(t.next<3>()), virtual_mass(t.next<3>()), weight(t.next<10>()), stiffness(t.next<6>()), damping(t.next<6>()),
        posture_stiffness(t.next<7>()), posture_damping(t.next<7>()), posture(t.next<7>()) {}
};

struct Input {
  Matrix<3> base;
  Matrix<7> q;
  Matrix<10> rates;
  Matrix<3, 3> desired_rotation;
  Matrix<3> desired;
  Matrix<6> twist;
  Matrix<3> wrench;
  explicit Input(Taken t)
      : base(t.next<3>()), q(t.next<7>()), rates(t.next<10>()), desired_rotation(t.next<3, 3>()), desired(t.next<3>()),
        twist(t.next<6>()), wrench(t.next<3>()) {}
};

struct Arm {
  pin::Model model;
  pin::FrameIndex tool;
  explicit Arm(const Rows &rows) {
    pin::JointIndex parent = 0;
    for (int joint = 0; joint < 7; ++joint) {
      Taken t{rows[joint].data()};
      const Matrix<3, 3> turn = t.next<3, 3>();
      const Matrix<3> place = t.next<3>();
      const double mass = t.next<1>()(0);
      const Matrix<3> com = t.next<3>();
      const Matrix<3, 3> inertia = t.next<3, 3>();
      parent = model.addJoint(parent, pin::JointModelRZ(), pin::SE3(turn, place), "joint" + std::to_string(joint + 1));
      model.appendBodyToJoint(parent, pin::Inertia(mass, com, inertia), pin::SE3::Identity());
    }
    Taken t{rows[7].data()};
    const Matrix<3, 3> turn = t.next<3, 3>();
    tool = model.addFrame(pin::Frame("tool", parent, 0, pin::SE3(turn, t.next<3>()), pin::OP_FRAME));
  }
};

// What a law is given.
struct Task {
  Matrix<7, 7> mass;
  Matrix<6, 10> jacobian;
  Matrix<6> force;
  Torque null;
};

// The paper's H is one number for the base and one for the arm: W⁻¹ M⁻¹ Jᵀ is H⁻² Jᵀ, and only the arm's mass is factored.
Torque block(const Parameters &p, const Task &t) {
  const double base = 1 / (p.weight[0] * p.weight[0]), arm = 1 / (p.weight[3] * p.weight[3]);
  const Torque wanted = t.jacobian.transpose() * t.force - t.null;
  const Eigen::LLT<Matrix<7, 7>> factor(t.mass);
  Matrix<7, 6> y = t.jacobian.rightCols<7>().transpose();
  Matrix<7> right = wanted.tail<7>();
  factor.matrixL().solveInPlace(y);
  factor.matrixL().solveInPlace(right);
  const Matrix<3, 6> of_base = p.virtual_mass.cwiseInverse().asDiagonal() * t.jacobian.leftCols<3>().transpose();
  Matrix<6, 6> inner;
  inner.noalias() = arm * y.transpose() * y;
  inner.noalias() += base * t.jacobian.leftCols<3>() * of_base;
  const Matrix<6> z =
      Eigen::LLT<Matrix<6, 6>>(inner).solve(y.transpose() * right + of_base.transpose() * wanted.head<3>());
  Torque torque = t.null;
  torque.head<3>().noalias() += base * t.jacobian.leftCols<3>().transpose() * z;
  torque.tail<7>().noalias() += arm * t.jacobian.rightCols<7>().transpose() * z;
  return torque;
}

// Any diagonal H: the 10×10 mass matrix is factored once, no inverse is formed.
Torque general(const Parameters &p, const Task &t) {
  Matrix<10, 10> mass = Matrix<10, 10>::Zero();
  mass.topLeftCorner<3, 3>() = p.virtual_mass.asDiagonal();
  mass.bottomRightCorner<7, 7>() = t.mass;
  const Torque h = p.weight.cwiseInverse();
  const Matrix<10, 6> mobile = Eigen::LLT<Matrix<10, 10>>(mass).solve(t.jacobian.transpose());
  const Matrix<10, 10> weight = h.asDiagonal() * mass * h.asDiagonal();
  Matrix<10, 6> spread;
  spread.noalias() = weight * mobile;
  Matrix<6, 6> inner, mobility;
  inner.noalias() = mobile.transpose() * spread;
  mobility.noalias() = t.jacobian * mobile;
  const Matrix<6> right = mobility * t.force - mobile.transpose() * t.null;
  return t.null + spread * Eigen::LLT<Matrix<6, 6>>(inner).solve(right);
}

// Kinematics and dynamics by the leanest sequence of calls that was found: CRBA in world axes leaves the placements and the
// Jacobian behind, the non-linear effects are all that remains.
template <class Law> Torque tick(const Arm &arm, pin::Data &data, const Parameters &p, const Input &in, Law law) {
  static thread_local Eigen::VectorXd q(7), v(7);
  static thread_local Eigen::Matrix<double, 6, Eigen::Dynamic> of_arm = Eigen::Matrix<double, 6, Eigen::Dynamic>::Zero(6, 7);
  q = in.q;
  v = in.rates.tail<7>();
  pin::crba(arm.model, data, q, pin::Convention::WORLD);
  pin::updateFramePlacement(arm.model, data, arm.tool);
  of_arm.setZero();
  pin::getFrameJacobian(arm.model, data, arm.tool, pin::LOCAL_WORLD_ALIGNED, of_arm);
  pin::nonLinearEffects(arm.model, data, q, v);

  const double cos = std::cos(in.base[2]), sin = std::sin(in.base[2]);
  Matrix<3, 3> turn;
  turn << cos, -sin, 0, sin, cos, 0, 0, 0, 1;
  const pin::SE3 &at = data.oMf[arm.tool];
  const Matrix<3> lever = turn * (p.mount + at.translation());
  const Matrix<3, 3> rotation = turn * at.rotation();
  const Matrix<3> place(lever[0] + in.base[0], lever[1] + in.base[1], lever[2]);
  Task task;
  task.mass = data.M;
  task.mass.triangularView<Eigen::StrictlyLower>() = task.mass.transpose();
  Matrix<6, 10> &jacobian = task.jacobian;
  jacobian.leftCols<3>().setZero();
  jacobian(0, 0) = jacobian(1, 1) = jacobian(5, 2) = 1;
  jacobian(0, 2) = -lever[1];
  jacobian(1, 2) = lever[0];
  jacobian.topRightCorner<3, 7>().noalias() = turn * of_arm.topRows<3>();
  jacobian.bottomRightCorner<3, 7>().noalias() = turn * of_arm.bottomRows<3>();
  Matrix<6> error;
  error.head<3>() = in.desired - place;
  error.tail<3>().setZero();
  for (int k = 0; k < 3; ++k) error.tail<3>() += 0.5 * rotation.col(k).cross(in.desired_rotation.col(k));
  task.force = p.damping.cwiseProduct(in.twist - jacobian * in.rates) + p.stiffness.cwiseProduct(error);
  task.null.head<3>() = in.wrench;
  task.null.tail<7>() =
      p.posture_stiffness.cwiseProduct(p.posture - in.q) - p.posture_damping.cwiseProduct(in.rates.tail<7>());
  Torque torque = law(p, task);
  torque.tail<7>() += data.nle;
  return torque;
}

double furthest(const std::vector<Torque> &torques, const Rows &reference) {
  double worst = 0;
  for (size_t i = 0; i < torques.size(); ++i) {
    const Eigen::Map<const Torque> right(reference[i].data());
    worst = std::max(worst, (torques[i] - right).cwiseAbs().maxCoeff() / right.cwiseAbs().maxCoeff());
  }
  return worst;
}

template <class Tick> bool timed(const char *name, const Rows &reference, int passes, Tick one) {
  std::vector<Torque> torques(reference.size());
  std::vector<double> ns;
  for (int pass = 0; pass < passes + 3; ++pass) {
    const auto begun = std::chrono::steady_clock::now();
    for (size_t i = 0; i < torques.size(); ++i) {
      torques[i] = one(i);
      asm volatile("" : : "g"(&torques[i]) : "memory");
    }
    const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - begun;
    if (pass >= 3) ns.push_back(took.count() / torques.size());
  }
  std::sort(ns.begin(), ns.end());
  const double error = furthest(torques, reference);
  if (!(error < 1e-9)) std::fprintf(stderr, "%s is off by %.1e\n", name, error);
  std::printf("{\"name\": \"%s\", \"ns_min\": %.1f, \"ns_median\": %.1f, \"rel_error\": %.2e}\n", name, ns.front(), ns[ns.size() / 2], error);
  return error < 1e-9;
}

}  // namespace

int main(int argc, char **argv) {
  const std::string folder = argc > 1 ? argv[1] : ".";
  const int passes = argc > 2 ? std::atoi(argv[2]) : 400;
  const Arm arm(rows(folder + "/model.csv"));
  pin::Data data(arm.model);
  const Parameters parameters(Taken{rows(folder + "/params.csv")[0].data()});
  const Rows numbers = rows(folder + "/inputs.csv"), reference = rows(folder + "/ref.csv");
  std::vector<Input, Eigen::aligned_allocator<Input>> inputs;
  for (const auto &row : numbers) inputs.emplace_back(Taken{row.data()});
  bool right = timed("Pinocchio " PINOCCHIO_VERSION ", general-h", reference, passes,
                     [&](size_t i) { return tick(arm, data, parameters, inputs[i], general); });
  right &= timed("Pinocchio " PINOCCHIO_VERSION ", block-h", reference, passes,
                 [&](size_t i) { return tick(arm, data, parameters, inputs[i], block); });
  long long sizes[4];
  casadi_tick_work(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
  std::vector<const double *> arg(sizes[0]);
  std::vector<double *> res(sizes[1]);
  std::vector<long long> iw(sizes[2]);
  std::vector<double> w(sizes[3]);
  right &= timed("C from CasADi, block-h", reference, passes, [&](size_t i) {
    Torque torque;
    arg[0] = numbers[i].data();
    res[0] = torque.data();
    casadi_tick(arg.data(), res.data(), iw.data(), w.data(), 0);
    return torque;
  });
  right &= timed("C from Pinocchio and CppADCodeGen, block-h", reference, passes, [&](size_t i) {
    Torque torque;
    const double *in[] = {numbers[i].data()};
    double *out[] = {torque.data()};
    cppad_tick(in, out, {});
    return torque;
  });
  return right ? 0 : 1;
}
