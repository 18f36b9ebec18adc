// The other side of `tools.rs`: how long OpenVDB takes for the same work.
//
//   openvdb_tools RUNS from-mesh MESH VOXEL_SIZE
//   openvdb_tools RUNS to-mesh GRID
//   openvdb_tools RUNS csg GRID GRID OUT
//   openvdb_tools RUNS redistance GRID OUT
//
// Prints the nanoseconds of each run, on the clock and of all threads, one run a line, and last the
// peak memory in kilobytes. Reading and freeing is not timed.

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <functional>
#include <iostream>
#include <string>
#include <vector>

#include <openvdb/openvdb.h>
#include <openvdb/tools/Composite.h>
#include <openvdb/tools/LevelSetRebuild.h>
#include <openvdb/tools/MeshToVolume.h>
#include <openvdb/tools/VolumeToMesh.h>
#include <sys/resource.h>

using openvdb::FloatGrid;

static FloatGrid::Ptr read(const std::string& path) {
    openvdb::io::File file(path);
    file.open(/*delayLoad=*/false);
    return openvdb::gridPtrCast<FloatGrid>(file.getGrids()->at(0));
}

static void write(const std::string& path, const FloatGrid::Ptr& grid) {
    openvdb::io::File(path).write({grid});
}

int main(int argc, char** argv) {
    const std::vector<std::string> args(argv + 1, argv + argc);
    if (args.size() < 3) return 2;
    openvdb::initialize();
    const auto timed = [&](const std::function<void()>& work) {
        for (int run = 0; run < std::stoi(args[0]); ++run) {
            const auto clock = std::clock();
            const auto start = std::chrono::steady_clock::now();
            work();
            const std::chrono::nanoseconds taken = std::chrono::steady_clock::now() - start;
            std::cout << taken.count() << ' ' << (std::clock() - clock) * (1'000'000'000 / CLOCKS_PER_SEC) << '\n';
        }
    };
    FloatGrid::Ptr made;
    if (args[1] == "from-mesh") {
        std::ifstream file(args[2], std::ios::binary);
        std::uint32_t counts[2];
        file.read(reinterpret_cast<char*>(counts), sizeof counts);
        std::vector<openvdb::Vec3s> points(counts[0]);
        std::vector<openvdb::Vec3I> triangles(counts[1]);
        file.read(reinterpret_cast<char*>(points.data()), points.size() * sizeof points[0]);
        file.read(reinterpret_cast<char*>(triangles.data()), triangles.size() * sizeof triangles[0]);
        const auto transform = openvdb::math::Transform::createLinearTransform(std::stod(args[3]));
        timed([&] {
            made.reset();
            made = openvdb::tools::meshToLevelSet<FloatGrid>(*transform, points, triangles, 3.0f);
        });
    } else if (args[1] == "to-mesh") {
        const auto grid = read(args[2]);
        std::vector<openvdb::Vec3s> points;
        std::vector<openvdb::Vec3I> triangles;
        std::vector<openvdb::Vec4I> quads;
        timed([&] { openvdb::tools::volumeToMesh(*grid, points, triangles, quads, 0.0, 0.0); });
    } else if (args[1] == "csg") {
        const auto a = read(args[2]), b = read(args[3]);
        timed([&] { made = openvdb::tools::csgUnionCopy(*a, *b); });
        write(args[4], made);
    } else if (args[1] == "redistance") {
        const auto grid = read(args[2]);
        timed([&] { made = openvdb::tools::levelSetRebuild(*grid, 0.0f, 3.0f); });
        write(args[3], made);
    } else {
        return 2;
    }
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    std::cout << usage.ru_maxrss << '\n';
}
