// The other side of `tools.rs`: how long OpenVDB takes for the same work.
//
//   openvdb_tools RUNS from-mesh MESH VOXEL_SIZE
//   openvdb_tools RUNS to-mesh GRID
//   openvdb_tools RUNS csg GRID GRID OUT
//   openvdb_tools RUNS redistance|resample|resample-fog|offset|smooth|smooth-fog|fog GRID OUT
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
#include <openvdb/tools/Filter.h>
#include <openvdb/tools/GridTransformer.h>
#include <openvdb/tools/LevelSetFilter.h>
#include <openvdb/tools/LevelSetRebuild.h>
#include <openvdb/tools/LevelSetUtil.h>
#include <openvdb/tools/MeshToVolume.h>
#include <openvdb/tools/Morphology.h>
#include <openvdb/tools/VolumeToMesh.h>

using openvdb::FloatGrid;

static FloatGrid::Ptr read(const std::string& path) {
    openvdb::io::File file(path);
    file.open(/*delayLoad=*/false);
    return openvdb::gridPtrCast<FloatGrid>(file.getGrids()->at(0));
}

static void write(const std::string& path, const FloatGrid::Ptr& grid) {
    openvdb::io::File(path).write({grid});
}

// A task that makes one grid of another one.
static FloatGrid::Ptr apply(const std::string& task, const FloatGrid& grid, double edge) {
    if (task == "redistance") return openvdb::tools::levelSetRebuild(grid, 0.0f, 3.0f);
    if (task == "resample") {
        const float size = static_cast<float>(1.5 * edge);
        const auto made = FloatGrid::create(3.0f * size);
        made->setGridClass(openvdb::GRID_LEVEL_SET);
        made->setTransform(openvdb::math::Transform::createLinearTransform(1.5 * edge));
        openvdb::tools::resampleToMatch<openvdb::tools::BoxSampler>(grid, *made);
        return made;
    }
    if (task == "resample-fog") {
        const auto made = grid.copyWithNewTree();
        openvdb::math::Mat4d matrix = openvdb::math::Mat4d::identity();
        matrix.setToRotation(openvdb::Vec3d(0, 1, 0), 0.3);
        matrix.preScale(openvdb::Vec3d(edge));
        made->setTransform(openvdb::math::Transform::createLinearTransform(matrix));
        openvdb::tools::resampleToMatch<openvdb::tools::BoxSampler>(grid, *made);
        return made;
    }
    const auto made = grid.deepCopy();
    if (task == "offset") {
        // Positive values are inwards.
        openvdb::tools::LevelSetFilter<FloatGrid>(*made).offset(static_cast<float>(-2.0 * edge));
    } else if (task == "smooth") {
        openvdb::tools::LevelSetFilter<FloatGrid>(*made).gaussian(1);
    } else if (task == "smooth-fog") {
        // Without these voxels, fog would not spread.
        openvdb::tools::dilateActiveValues(made->tree(), 4, openvdb::tools::NN_FACE_EDGE_VERTEX);
        openvdb::tools::Filter<FloatGrid> filter(*made);
        filter.setProcessTiles(true);
        filter.gaussian(1);
    } else if (task == "fog") {
        openvdb::tools::sdfToFogVolume(*made);
    } else {
        return nullptr;
    }
    return made;
}

// In kilobytes. `getrusage` would count what the parent had before it started this program.
static std::string peak_memory() {
    std::ifstream status("/proc/self/status");
    std::string word;
    while (status >> word) {
        if (word == "VmHWM:" && status >> word) break;
    }
    return word;
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
    } else {
        const auto grid = read(args[2]);
        const double edge = grid->voxelSize()[0];
        timed([&] { made = apply(args[1], *grid, edge); });
        if (!made) return 2;
        write(args[3], made);
    }
    std::cout << peak_memory() << '\n';
}
