// The other side of `read.rs`: how long OpenVDB itself takes from file to tree.
//
//   openvdb_read FILE RUNS
//
// Prints the nanoseconds of each run, one a line, and last the peak memory in kilobytes. Reading is
// complete, not delayed until values are asked for; freeing the grids is not timed.

#include <chrono>
#include <cstdlib>
#include <iostream>
#include <openvdb/openvdb.h>
#include <sys/resource.h>

int main(int argc, char** argv) {
    if (argc != 3) {
        std::cerr << "usage: openvdb_read FILE RUNS\n";
        return 2;
    }
    openvdb::initialize();
    for (int run = 0; run < std::atoi(argv[2]); ++run) {
        const auto start = std::chrono::steady_clock::now();
        openvdb::io::File file(argv[1]);
        file.open(/*delayLoad=*/false);
        const auto grids = file.getGrids();
        const std::chrono::nanoseconds taken = std::chrono::steady_clock::now() - start;
        if (grids->empty()) return 1;
        std::cout << taken.count() << '\n';
    }
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    std::cout << usage.ru_maxrss << '\n';
}
