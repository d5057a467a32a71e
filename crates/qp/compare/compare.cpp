// eiquadprog on the problems of examples/compare.rs; see compare.py.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <vector>

#include <eiquadprog/eiquadprog-fast.hpp>

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

int main(int, char** arguments) {
  std::ifstream file(arguments[1], std::ios::binary);
  auto take = [&](size_t count) {
    std::vector<double> values(count);
    file.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(count * sizeof(double)));
    return values;
  };
  for (const char* name : {"contact 4x36", "random 4x36", "random 10x30"}) {
    auto head = take(3);
    int count = int(head[0]), n = int(head[1]), m = int(head[2]);
    std::vector<double> times;
    double furthest = 0;
    for (int k = 0; k < count; ++k) {
      auto hv = take(size_t(n * n)), fv = take(size_t(n)), rv = take(size_t(m * (n + 2))), xv = take(size_t(n));
      Eigen::MatrixXd h = Eigen::Map<Matrix>(hv.data(), n, n);
      Eigen::VectorXd f = Eigen::Map<Eigen::VectorXd>(fv.data(), n), x = Eigen::Map<Eigen::VectorXd>(xv.data(), n);
      Matrix rows = Eigen::Map<Matrix>(rv.data(), m, n + 2);
      std::vector<std::pair<Eigen::VectorXd, double>> sides;  // a·x + b >= 0
      for (int i = 0; i < m; ++i) {
        Eigen::VectorXd a = rows.row(i).head(n).transpose();
        if (rows(i, n) > -1e29) sides.emplace_back(a, -rows(i, n));
        if (rows(i, n + 1) < 1e29) sides.emplace_back(-a, rows(i, n + 1));
      }
      Eigen::MatrixXd inequalities(sides.size(), n), equalities(0, n);
      Eigen::VectorXd bounds(sides.size()), none(0), found(n);
      for (size_t i = 0; i < sides.size(); ++i) {
        inequalities.row(Eigen::Index(i)) = sides[i].first;
        bounds(Eigen::Index(i)) = sides[i].second;
      }
      eiquadprog::solvers::EiquadprogFast solver;
      solver.reset(size_t(n), 0, sides.size());
      double best = 1;
      for (int j = 0; j < 5; ++j) {
        Eigen::MatrixXd copy = h;
        auto began = std::chrono::steady_clock::now();
        solver.solve_quadprog(copy, f, equalities, none, inequalities, bounds, found);
        best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count());
      }
      times.push_back(best * 1e6);
      furthest = std::max(furthest, (found - x).cwiseAbs().maxCoeff());
    }
    std::sort(times.begin(), times.end());
    std::printf("%-14s %-20s median %7.2f  99 %% %7.2f  worst %7.2f us; furthest from moca-qp %.1e\n", name, "eiquadprog-fast",
                times[times.size() / 2], times[times.size() * 99 / 100], times.back(), furthest);
  }
}
