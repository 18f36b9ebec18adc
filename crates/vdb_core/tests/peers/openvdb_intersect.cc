// OpenVDB's own ray intersectors on a grid and rays from a file: a second opinion on the reference
// tracer. Built and run by tests/reference/peers.rs:
//
//     openvdb_intersect levelset|volume CASE > RESULTS
//
// CASE, little endian: u32 values, u32 rays, f32 background; per value i32 x, y, z of its lowest
// voxel, i32 level (0 voxel, 1 tile of 8³, 2 of 128³, 3 of 4096³), f32 value, i32 active; per ray
// f64 origin x, y, z and direction x, y, z in index space.
//
// RESULTS, a line a ray. levelset: the first hit of LevelSetRayIntersector, "t refined", with its
// default of one linear interpolation and with 30 more (a template argument of its own), or "-".
// volume: the spans "t0 t1 ..." of active leaves and tiles of VolumeRayIntersector.

#include <cstdint>
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include <openvdb/openvdb.h>
#include <openvdb/tools/RayIntersector.h>

template <typename T> static T read(std::ifstream &file) {
    T value;
    file.read(reinterpret_cast<char *>(&value), sizeof value);
    if (!file) {
        std::fprintf(stderr, "the case file is cut short\n");
        std::exit(2);
    }
    return value;
}

int main(int argc, char **argv) {
    if (argc != 3) {
        std::fprintf(stderr, "usage: openvdb_intersect levelset|volume CASE\n");
        return 2;
    }
    const std::string mode = argv[1];
    std::ifstream file(argv[2], std::ios::binary);
    openvdb::initialize();

    const auto values = read<uint32_t>(file);
    const auto rays = read<uint32_t>(file);
    const auto background = read<float>(file);
    auto grid = openvdb::FloatGrid::create(background);
    for (uint32_t i = 0; i < values; ++i) {
        openvdb::Coord at;
        for (int axis = 0; axis < 3; ++axis) at[axis] = read<int32_t>(file);
        const auto level = read<int32_t>(file);
        const auto value = read<float>(file);
        const auto active = read<int32_t>(file);
        grid->tree().addTile(level, at, value, active != 0);
    }

    using Ray = openvdb::math::Ray<double>;
    std::vector<Ray> index_rays;
    for (uint32_t i = 0; i < rays; ++i) {
        openvdb::Vec3d origin, direction;
        for (int axis = 0; axis < 3; ++axis) origin[axis] = read<double>(file);
        for (int axis = 0; axis < 3; ++axis) direction[axis] = read<double>(file);
        index_rays.emplace_back(origin, direction);
    }

    if (mode == "levelset") {
        grid->setGridClass(openvdb::GRID_LEVEL_SET);
        using openvdb::FloatGrid;
        using Refined = openvdb::tools::LinearSearchImpl<FloatGrid, 30>;
        openvdb::tools::LevelSetRayIntersector<FloatGrid> intersector(*grid);
        openvdb::tools::LevelSetRayIntersector<FloatGrid, Refined> refining(*grid);
        for (const Ray &ray : index_rays) {
            openvdb::Vec3d at;
            double t, refined;
            if (intersector.intersectsIS(ray, at, t) && refining.intersectsIS(ray, at, refined))
                std::printf("%.17g %.17g\n", t, refined);
            else std::printf("-\n");
        }
    } else if (mode == "volume") {
        openvdb::tools::VolumeRayIntersector<openvdb::FloatGrid> intersector(*grid);
        for (const Ray &ray : index_rays) {
            if (intersector.setIndexRay(ray)) {
                double from, to;
                while (intersector.march(from, to)) std::printf("%.17g %.17g ", from, to);
            }
            std::printf("\n");
        }
    } else {
        std::fprintf(stderr, "levelset or volume, not %s\n", argv[1]);
        return 2;
    }
    return 0;
}
