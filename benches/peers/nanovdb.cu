// NanoVDB in CUDA, the rival of our shaders: its stock level-set intersection and the march through
// fog of its sample, timed on rays that our benchmark traces too. README.md beside this file says how
// it is built and what is fair about it.
//
//   nanovdb FILE.nvdb… [--sizes 1024x1024,1920x1080,3840x2160] [--dists 3.0,1.8,1.1] [--runs 40]
//           [--rays primary,shuffled,fog] [--rows] [--dump DIR]
//
// Prints CSV, a line for each measurement: see HEADER.
//
// Level sets: nanovdb::ZeroCrossing, whose answer is the voxel in which the sign changes. `stock` hands
// it NanoVDB's accessor, `fused` the one below. Every measurement of a view has to give the very same
// answers, or the program fails after the last.
//
// Fog: a step of half a voxel, the nearest value at each, nothing skipped, no early end.
//
// Camera: eye = centre + back · dist · half the diagonal of the grid's world box, back =
// normalize(0.45, 0.35, 0.82), looking at the centre, up is +y, 45° from bottom to top, square pixels,
// rays through their centres. Pixel (x, y) is number y · width + x; y = 0 is the bottom row.
//
// --dump writes MODEL_WIDTHxHEIGHT_DIST.f32 for each view: a little-endian f32 per pixel in that order.
// Level sets: the distance from the eye, in voxels, at which the ray enters the voxel of the hit, or -1.
// Fog: the transmittance.

#if __has_include(<nanovdb/math/HDDA.h>) // since 32.7
#include <nanovdb/io/IO.h>
#include <nanovdb/math/HDDA.h>
#include <nanovdb/math/Ray.h>
#else
#include <nanovdb/util/HDDA.h>
#include <nanovdb/util/IO.h>
#include <nanovdb/util/Ray.h>
namespace nanovdb {
namespace math = ::nanovdb;
}
#endif

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

using Grid = nanovdb::NanoGrid<float>;
using Ray = nanovdb::math::Ray<float>;
using nanovdb::Coord;
using nanovdb::Vec3f;

constexpr const char* HEADER = "peer,variant,model,kind,rays,width,height,dist,block,median_ms,min_ms,"
                               "max_ms,mrays_per_s,hit_percent,bytes,device";

#define TEXT_OF(x) #x
#define TEXT(x) TEXT_OF(x)
#ifndef SUFFIX // what else the name of the peer is to say: scripts/bench-peers builds more than one
#define SUFFIX ""
#endif
constexpr const char* PEER = "nanovdb_" TEXT(NANOVDB_MAJOR_VERSION_NUMBER) "." TEXT(
    NANOVDB_MINOR_VERSION_NUMBER) "." TEXT(NANOVDB_PATCH_VERSION_NUMBER) SUFFIX;

[[noreturn]] void fail(const std::string& message) {
    std::fprintf(stderr, "nanovdb: %s\n", message.c_str());
    std::exit(1);
}

void check(cudaError_t error, const char* call, int line) {
    if (error != cudaSuccess)
        fail(std::string(call) + ": " + cudaGetErrorString(error) + " (nanovdb.cu:" + std::to_string(line) + ")");
}
#define CUDA(call) check(call, #call, __LINE__)

// ---------------------------------------------------------------------------------------- on the GPU

struct Camera {
    Vec3f eye, right, up, back;
    float tan_half_fov;
};

struct View {
    Camera camera;
    uint32_t width, height;
    uint32_t bits; // of width · height - 1
    bool rows;     // blocks of 512 pixels of a row, else of 8 × 8
};

// The rays in an order in which neighbours have nothing in common, the same each time: a bijection of
// 0 .. count - 1 onto itself. Each round takes numbers below 2^bits to numbers below 2^bits, one to one:
// an odd factor modulo 2^bits, then the upper half of the bits over the lower. What falls on count or
// above goes round again, which must come back below it at last. Here, bits is the least for which
// count <= 2^bits, and all arithmetic is u32 that wraps:
//
//     do {
//         i = (i * 0x9E3779B1) & (2^bits - 1);  i = i ^ (i >> ((bits + 1) / 2));
//         i = (i * 0x85EBCA6B) & (2^bits - 1);  i = i ^ (i >> ((bits + 1) / 2));
//         i = (i * 0xC2B2AE35) & (2^bits - 1);  i = i ^ (i >> ((bits + 1) / 2));
//     } while (i >= count);
//
// The thread that has pixel i when the order is `primary` traces pixel permute(i) when it is `shuffled`
// and writes the answer where it belongs.
__hostdev__ inline uint32_t permute(uint32_t i, uint32_t count, uint32_t bits) {
    const uint32_t mask = (1u << bits) - 1u, half = (bits + 1u) / 2u;
    do {
        i = (i * 0x9E3779B1u) & mask;
        i ^= i >> half;
        i = (i * 0x85EBCA6Bu) & mask;
        i ^= i >> half;
        i = (i * 0xC2B2AE35u) & mask;
        i ^= i >> half;
    } while (i >= count);
    return i;
}

__hostdev__ inline Ray ray_through(const Grid& grid, const View& view, uint32_t x, uint32_t y) {
    const Camera& camera = view.camera;
    const float right = (2.f * (x + .5f) / view.width - 1.f) * camera.tan_half_fov * view.width / view.height;
    const float up = (2.f * (y + .5f) / view.height - 1.f) * camera.tan_half_fov;
    Vec3f dir = camera.right * right + camera.up * up - camera.back;
    dir.normalize();
    return Ray(camera.eye, dir).worldToIndexF(grid);
}

// NanoVDB's accessor, asked once for two answers wherever ZeroCrossing wants both of one voxel:
// how far to step and whether the voxel is active; whether it is active and its value.
struct FusedAccessor {
    using Stock = nanovdb::DefaultReadAccessor<float>;
    using ValueType = float;

    Stock stock;
    float value = 0.f;
    bool stepped = false; // getDim was called last: isActive, if it comes next, is about that voxel
    bool probed = false;  // isActive was called last: getValue, if it comes next, is about that voxel

    __hostdev__ explicit FusedAccessor(const Grid& grid) : stock(grid.tree().root()) {}

    __hostdev__ auto root() const -> decltype(stock.root()) { return stock.root(); }

    __hostdev__ uint32_t getDim(const Coord& voxel, const Ray& ray) {
        stepped = true;
        probed = false;
        return stock.getDim(voxel, ray);
    }

    __hostdev__ bool isActive(const Coord& voxel) {
        if (stepped) { // and to a voxel, or nobody asks: its leaf is in the cache
            stepped = false;
            return stock.template getNode<0>()->isActive(voxel);
        }
        probed = true;
        return stock.probeValue(voxel, value);
    }

    __hostdev__ float getValue(const Coord& voxel) { return probed ? value : stock.getValue(voxel); }
};

enum class Walk { stock, fused, fog };

template<typename Accessor>
__hostdev__ inline float zero_crossing(Ray ray, Accessor accessor) {
    Coord voxel;
    float value, t;
    return nanovdb::math::ZeroCrossing(ray, accessor, voxel, value, t) ? t : -1.f;
}

__hostdev__ inline float fog(Ray ray, const Grid& grid) {
    const auto accessor = grid.tree().getAccessor();
    float transmittance = 1.f;
    if (ray.clip(grid.tree().bbox()))
        for (float t = ray.t0(); t < ray.t1(); t += 0.5f)
            transmittance *= 1.f - accessor.getValue(Coord::Floor(ray(t))) * 0.1f * 0.5f;
    return transmittance;
}

template<Walk walk>
__hostdev__ inline float answer(const Grid& grid, const View& view, uint32_t x, uint32_t y) {
    const Ray ray = ray_through(grid, view, x, y);
    if constexpr (walk == Walk::stock) return zero_crossing(ray, grid.tree().getAccessor());
    else if constexpr (walk == Walk::fused) return zero_crossing(ray, FusedAccessor(grid));
    else return fog(ray, grid);
}

template<Walk walk, bool shuffled>
__global__ void trace(const Grid* grid, View view, float* out) {
    const uint32_t i = blockIdx.x * blockDim.x + threadIdx.x;
    uint32_t x = view.rows ? i % view.width : i;
    uint32_t y = view.rows ? i / view.width : blockIdx.y * blockDim.y + threadIdx.y;
    if (x >= view.width || y >= view.height) return;
    if constexpr (shuffled) {
        const uint32_t pixel = permute(y * view.width + x, view.width * view.height, view.bits);
        x = pixel % view.width;
        y = pixel / view.width;
    }
    out[y * view.width + x] = answer<walk>(*grid, view, x, y);
}

// --------------------------------------------------------------------------------------- on the host

struct Options {
    std::vector<std::string> files, dists{"3.0", "1.8", "1.1"};
    std::vector<std::pair<uint32_t, uint32_t>> sizes{{1024, 1024}, {1920, 1080}, {3840, 2160}};
    int runs = 40;
    bool primary = true, shuffled = true, fog = true, rows = false;
    std::string dump;
};

[[noreturn]] void usage(const std::string& why) {
    if (!why.empty()) std::fprintf(stderr, "nanovdb: %s\n", why.c_str());
    std::fputs("usage: nanovdb FILE.nvdb... [--sizes 1024x1024,1920x1080,3840x2160] [--dists 3.0,1.8,1.1]\n"
               "               [--runs 40] [--rays primary,shuffled,fog] [--rows] [--dump DIR]\n", stderr);
    std::exit(2);
}

std::vector<std::string> split(const std::string& list) {
    std::vector<std::string> parts;
    for (size_t at = 0; at <= list.size();) {
        const size_t end = std::min(list.find(',', at), list.size());
        parts.push_back(list.substr(at, end - at));
        at = end + 1;
    }
    return parts;
}

Options parse(int argc, char** argv) {
    Options options;
    for (int i = 1; i < argc; ++i) {
        const std::string arg = argv[i];
        if (arg.rfind("--", 0) != 0) {
            options.files.push_back(arg);
            continue;
        }
        if (arg == "--rows") {
            options.rows = true;
            continue;
        }
        if (i + 1 == argc) usage(arg + " wants a value, or is unknown");
        const std::string value = argv[++i];
        if (arg == "--sizes") {
            options.sizes.clear();
            for (const std::string& size : split(value)) {
                unsigned width = 0, height = 0;
                int end = 0;
                if (std::sscanf(size.c_str(), "%5ux%5u%n", &width, &height, &end) != 2 || size_t(end) != size.size() ||
                    width == 0 || height == 0 || uint64_t(width) * height < 2 || uint64_t(width) * height >> 31)
                    usage("--sizes: not a size: '" + size + "'");
                options.sizes.push_back({width, height});
            }
        } else if (arg == "--dists") {
            options.dists = split(value);
            for (const std::string& dist : options.dists) {
                char* end;
                if (!(std::strtof(dist.c_str(), &end) > 0) || *end) usage("--dists: not a distance: '" + dist + "'");
            }
        } else if (arg == "--runs") {
            char* end;
            options.runs = int(std::strtol(value.c_str(), &end, 10));
            if (*end || options.runs < 1 || options.runs > 10000) usage("--runs: not a number from 1: '" + value + "'");
        } else if (arg == "--rays") {
            options.primary = options.shuffled = options.fog = false;
            for (const std::string& rays : split(value)) {
                if (rays == "primary") options.primary = true;
                else if (rays == "shuffled") options.shuffled = true;
                else if (rays == "fog") options.fog = true;
                else usage("--rays: neither primary, shuffled nor fog: '" + rays + "'");
            }
        } else if (arg == "--dump") {
            options.dump = value;
        } else {
            usage("no such option: " + arg);
        }
    }
    if (options.files.empty()) usage("");
    return options;
}

Camera camera_of(const Grid& grid, float dist) {
    const auto box = grid.worldBBox();
    const Vec3f centre(box.min() + box.dim() * 0.5);
    const float radius = 0.5f * float(box.dim().length());
    Vec3f back(0.45f, 0.35f, 0.82f);
    back.normalize();
    Vec3f right = Vec3f(0, 1, 0).cross(back);
    right.normalize();
    return {centre + back * (radius * dist), right, back.cross(right), back, std::tan(22.5f * 3.14159265f / 180)};
}

uint32_t bits_of(uint32_t count) {
    uint32_t bits = 1;
    while ((count - 1) >> bits) ++bits;
    return bits;
}

using Kernel = void (*)(const Grid*, View, float*);

// Milliseconds of each launch, ascending. The launches stand in the queue before the first has ended,
// so that none waits for the host, and each is timed from the end of the one before.
std::vector<float> launch_times(Kernel kernel, const Grid* grid, const View& view, int runs, float* out) {
    const dim3 block = view.rows ? dim3(512) : dim3(8, 8);
    const dim3 blocks = view.rows ? dim3((view.width * view.height + 511) / 512)
                                  : dim3((view.width + 7) / 8, (view.height + 7) / 8);
    const auto launch = [&] {
        kernel<<<blocks, block>>>(grid, view, out);
        CUDA(cudaGetLastError());
    };
    // A GPU that had nothing to do runs at a fraction of its clock.
    static bool awake = false;
    for (const auto start = std::chrono::steady_clock::now(); !awake;) {
        launch();
        CUDA(cudaDeviceSynchronize());
        awake = std::chrono::steady_clock::now() - start > std::chrono::milliseconds(500);
    }
    std::vector<cudaEvent_t> events(size_t(runs) + 1);
    for (cudaEvent_t& event : events) CUDA(cudaEventCreate(&event));
    for (int warm_up = 0; warm_up < 10; ++warm_up) launch();
    CUDA(cudaEventRecord(events[0]));
    for (int run = 0; run < runs; ++run) {
        launch();
        CUDA(cudaEventRecord(events[size_t(run) + 1]));
    }
    CUDA(cudaDeviceSynchronize());
    std::vector<float> ms(static_cast<size_t>(runs));
    for (size_t run = 0; run < ms.size(); ++run) CUDA(cudaEventElapsedTime(&ms[run], events[run], events[run + 1]));
    for (cudaEvent_t event : events) CUDA(cudaEventDestroy(event));
    std::sort(ms.begin(), ms.end());
    return ms;
}

void write(const std::string& path, const std::vector<float>& values) {
    FILE* file = std::fopen(path.c_str(), "wb");
    const bool written = file && std::fwrite(values.data(), sizeof(float), values.size(), file) == values.size();
    if (!file || std::fclose(file) != 0 || !written) fail("cannot write " + path);
}

// How many answers of all measurements differ from those of the first of their view.
size_t measure(const std::string& path, const Options& options, const std::string& device) {
    const auto handle = nanovdb::io::readGrid(path);
    const Grid* host = handle.template grid<float>();
    if (!host) fail(path + ": its first grid is not of float values");
    const bool is_fog = host->isFogVolume();
    if (!is_fog && !host->isLevelSet()) fail(path + ": neither a level set nor a fog volume, by its own account");

    struct Measurement {
        const char *variant, *rays;
        bool rows;
        Kernel kernel;
    };
    std::vector<Measurement> measurements;
    if (is_fog) {
        if (options.fog) measurements.push_back({"stock", "primary", false, trace<Walk::fog, false>});
        if (options.fog && options.rows) measurements.push_back({"stock", "primary", true, trace<Walk::fog, false>});
    } else {
        if (options.primary) measurements.push_back({"stock", "primary", false, trace<Walk::stock, false>});
        if (options.primary) measurements.push_back({"fused", "primary", false, trace<Walk::fused, false>});
        if (options.primary && options.rows)
            measurements.push_back({"stock", "primary", true, trace<Walk::stock, false>});
        if (options.shuffled) measurements.push_back({"stock", "shuffled", false, trace<Walk::stock, true>});
        if (options.shuffled) measurements.push_back({"fused", "shuffled", false, trace<Walk::fused, true>});
    }
    if (measurements.empty()) std::fprintf(stderr, "nanovdb: %s: left out, by --rays\n", path.c_str());

    const size_t slash = path.rfind('/') + 1; // npos + 1 is 0
    const std::string model = path.substr(slash, path.rfind('.') > slash ? path.rfind('.') - slash : std::string::npos);
    const size_t bytes = host->gridSize();
    Grid* grid;
    CUDA(cudaMalloc(&grid, bytes));
    CUDA(cudaMemcpy(grid, host, bytes, cudaMemcpyHostToDevice));

    size_t different = 0;
    for (const auto& [width, height] : options.sizes) {
        const uint32_t count = width * height;
        float* out;
        CUDA(cudaMalloc(&out, count * sizeof(float)));
        for (const std::string& dist : options.dists) {
            const Camera camera = camera_of(*host, std::strtof(dist.c_str(), nullptr));
            std::vector<float> first, answers(count);
            for (const Measurement& m : measurements) {
                const View view{camera, width, height, bits_of(count), m.rows};
                // Not a number, which no ray gives: what is left of it was not traced.
                CUDA(cudaMemset(out, 0xff, count * sizeof(float)));
                const std::vector<float> ms = launch_times(m.kernel, grid, view, options.runs, out);
                CUDA(cudaMemcpy(answers.data(), out, count * sizeof(float), cudaMemcpyDeviceToHost));

                const auto hits = std::count_if(answers.begin(), answers.end(),
                                                [&](float a) { return is_fog ? a < 0.999f : a >= 0.f; });
                const float median = 0.5f * (ms[(ms.size() - 1) / 2] + ms[ms.size() / 2]);
                std::printf("%s,%s,%s,%s,%s,%u,%u,%s,%s,%.4f,%.4f,%.4f,%.1f,%.3f,%zu,%s\n", PEER, m.variant,
                            model.c_str(), is_fog ? "fog" : "level_set", m.rays, width, height, dist.c_str(),
                            m.rows ? "512x1" : "8x8", median, ms.front(), ms.back(), count / (median * 1e3),
                            100. * double(hits) / count, bytes, device.c_str());
                std::fflush(stdout);

                if (first.empty()) {
                    first = answers;
                    if (!options.dump.empty())
                        write(options.dump + "/" + model + "_" + std::to_string(width) + "x" +
                                  std::to_string(height) + "_" + dist + ".f32", first);
                }
                size_t here = 0; // not a number differs from itself
                for (uint32_t i = 0; i < count; ++i) here += first[i] != answers[i];
                if (here)
                    std::fprintf(stderr, "nanovdb: %s %ux%u %s: %s %s %s differs from the first in %zu rays\n",
                                 model.c_str(), width, height, dist.c_str(), m.variant, m.rays,
                                 m.rows ? "512x1" : "8x8", here);
                different += here;
            }
        }
        CUDA(cudaFree(out));
    }
    CUDA(cudaFree(grid));
    return different;
}

int main(int argc, char** argv) {
    const Options options = parse(argc, argv);
    cudaDeviceProp device;
    CUDA(cudaGetDeviceProperties(&device, 0));
    std::puts(HEADER);
    size_t different = 0;
    try {
        for (const std::string& file : options.files) different += measure(file, options, device.name);
    } catch (const std::exception& error) {
        fail(error.what());
    }
    if (different) fail(std::to_string(different) + " answers are not those of the first measurement of their view");
}
