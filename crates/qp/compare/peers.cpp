// Other solvers for benches/compare.rs, as a library that it loads: qpmad, eiquadprog and DAQP, each through its own C or C++
// interface. See compare.py.
#include <chrono>
#include <cmath>
#include <cstring>
#include <vector>

#include <eiquadprog/eiquadprog-fast.hpp>
#include <qpmad/solver.h>

extern "C" {
#include <api.h>
#include <utils.h>
}

namespace {

using Matrix = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Clock = std::chrono::steady_clock;

// A problem in the form that each solver wants: half xᵀHx + fᵀx, lower ≤ Ax ≤ upper.
struct Problem {
  int n, m;
  Matrix h;
  Vector f, lower, upper;
  Rows rows;
  Matrix columns, one_sided;
  Vector offsets;

  // qpmad; H becomes L⁻¹, which later solves start from.
  qpmad::Solver mad;
  Matrix inverse_factor;
  // eiquadprog
  eiquadprog::solvers::EiquadprogFast fast;
  Matrix no_equalities;
  Vector no_offsets;
  // DAQP
  DAQPProblem daqp{};
  DAQPWorkspace work{};
  std::vector<int> sense;
  std::vector<double> multipliers;
  bool set_up = false;
};

double since(Clock::time_point began) { return std::chrono::duration<double, std::nano>(Clock::now() - began).count(); }

double qpmad_solve(Problem &p, bool warm, Vector &x) {
  qpmad::SolverParameters parameters;
  parameters.return_inverted_cholesky_factor_ = true;
  if (warm) {
    parameters.hessian_type_ = qpmad::SolverParameters::HESSIAN_INVERTED_CHOLESKY_FACTOR;
  } else {
    parameters.return_inverted_cholesky_factor_ = false;
    p.inverse_factor = p.h;
  }
  const auto began = Clock::now();
  p.mad.solve(x, p.inverse_factor, p.f, Vector(), Vector(), p.columns, p.lower, p.upper, parameters);
  return since(began);
}

double eiquadprog_solve(Problem &p, bool, Vector &x) {
  Matrix copy = p.h;
  const auto began = Clock::now();
  p.fast.solve_quadprog(copy, p.f, p.no_equalities, p.no_offsets, p.one_sided, p.offsets, x);
  return since(began);
}

double daqp_cold(Problem &p, Vector &x) {
  DAQPResult result{};
  result.x = x.data();
  result.lam = p.multipliers.data();
  const auto began = Clock::now();
  daqp_quadprog(&result, &p.daqp, nullptr);
  return since(began);
}

double daqp_warm(Problem &p, Vector &x) {
  DAQPResult result{};
  result.x = x.data();
  result.lam = p.multipliers.data();
  const auto began = Clock::now();
  daqp_update_ldp(DAQP_UPDATE_v | DAQP_UPDATE_d, &p.work, &p.daqp);
  daqp_solve(&result, &p.work);
  return since(began);
}

}  // namespace

extern "C" {

// `rows` has m rows: normal, lower, upper.
Problem *peer_new(int n, int m, const double *h, const double *rows) {
  auto *p = new Problem{};
  p->n = n;
  p->m = m;
  p->h = Eigen::Map<const Matrix>(h, n, n);
  const Eigen::Map<const Rows> all(rows, m, n + 2);
  p->rows = all.leftCols(n);
  p->columns = p->rows;
  p->lower = all.col(n).cwiseMax(-1e30);
  p->upper = all.col(n + 1).cwiseMin(1e30);
  std::vector<std::pair<Vector, double>> sides;  // a·x + b >= 0
  for (int i = 0; i < m; ++i) {
    if (p->lower[i] > -1e29) sides.emplace_back(p->rows.row(i).transpose(), -p->lower[i]);
    if (p->upper[i] < 1e29) sides.emplace_back(-p->rows.row(i).transpose(), p->upper[i]);
  }
  p->one_sided.resize(sides.size(), n);
  p->offsets.resize(sides.size());
  for (size_t i = 0; i < sides.size(); ++i) {
    p->one_sided.row(i) = sides[i].first.transpose();
    p->offsets[i] = sides[i].second;
  }
  p->f = Vector::Zero(n);
  p->fast.reset(n, 0, sides.size());
  p->no_equalities.resize(0, n);
  p->mad.reserve(n, 0, m);
  p->sense.assign(m, 0);
  p->multipliers.assign(m, 0);
  p->daqp.n = n;
  p->daqp.m = m;
  p->daqp.H = p->h.data();
  p->daqp.f = p->f.data();
  p->daqp.A = p->rows.data();
  p->daqp.bupper = p->upper.data();
  p->daqp.blower = p->lower.data();
  p->daqp.sense = p->sense.data();
  return p;
}

void peer_gradient(Problem *p, const double *f) { std::memcpy(p->f.data(), f, p->n * sizeof(double)); }

// One solve: which is 0 qpmad, 1 eiquadprog, 2 DAQP; ns, infinite if it gives up.
double peer_solve(Problem *p, int which, int warm, double *out) {
  Vector x = Vector::Zero(p->n);
  double ns = 0;
  // qpmad throws where it finds no solution.
  if (which == 0) try {
      ns = qpmad_solve(*p, warm, x);
    } catch (const std::exception &) {
      ns = INFINITY;
    }
  if (which == 1) ns = eiquadprog_solve(*p, warm, x);
  if (which == 2) ns = warm ? daqp_warm(*p, x) : daqp_cold(*p, x);
  std::memcpy(out, x.data(), p->n * sizeof(double));
  return ns;
}

// What a later warm solve starts from: factors and active rows of the present problem.
void peer_keep(Problem *p) {
  qpmad::SolverParameters parameters;
  parameters.return_inverted_cholesky_factor_ = true;
  p->inverse_factor = p->h;
  Vector x = Vector::Zero(p->n);
  try {
    p->mad.solve(x, p->inverse_factor, p->f, Vector(), Vector(), p->columns, p->lower, p->upper, parameters);
  } catch (const std::exception &) {
  }
  setup_daqp(&p->daqp, &p->work, nullptr);
  p->set_up = true;
  DAQPResult result{};
  result.x = x.data();
  result.lam = p->multipliers.data();
  daqp_solve(&result, &p->work);
}

void peer_free(Problem *p) {
  if (p->set_up) {
    free_daqp_workspace(&p->work);
    free_daqp_ldp(&p->work);
  }
  delete p;
}
}
