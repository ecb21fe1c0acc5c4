// Put before the authors' source by the compiler (-include): tells how long each solve of Ceres takes, changes nothing.
#include <ceres/ceres.h>

#include <cstdio>
#include <ctime>

namespace ceres {
inline double CpuMilliseconds() {
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return 1e3 * now.tv_sec + 1e-6 * now.tv_nsec;
}

inline void TimedSolve(const Solver::Options& options, Problem* problem, Solver::Summary* summary) {
  const double started = CpuMilliseconds();
  Solve(options, problem, summary);
  std::fprintf(stdout, "%.6f %.6f\n", CpuMilliseconds() - started, 1e3 * summary->total_time_in_seconds);
}
}  // namespace ceres

#define Solve TimedSolve
