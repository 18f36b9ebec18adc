// Writes grids of points with every codec, and prints what OpenVDB reads from files.
//
//     g++ -std=c++17 -O1 -o write_points write_points.cc -lopenvdb -ltbb -lImath-3_1
//     ./write_points FOLDER               writes files, and prints what is read back from them
//     ./write_points --print FILE JSON    prints what is read from a file
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include <openvdb/openvdb.h>
#include <openvdb/io/Stream.h>
#include <openvdb/points/AttributeArrayString.h>
#include <openvdb/points/PointAttribute.h>
#include <openvdb/points/PointConversion.h>
#include <openvdb/points/PointCount.h>
#include <openvdb/points/PointGroup.h>
#include <openvdb/points/PointRasterizeTrilinear.h>

using namespace openvdb;
using namespace openvdb::points;

// The same numbers everywhere (xorshift64*, Vigna 2014).
struct Random
{
    uint64_t state = 88172645463325252ull;
    double next()
    {
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        return double((state * 0x2545F4914F6CDD1Dull) >> 11) / 9007199254740992.0;
    }
};

// Positions in a cube with this edge and centre.
static std::vector<Vec3d> scattered(int count, double extent, double centre = 0.0)
{
    Random random;
    std::vector<Vec3d> positions;
    for (int i = 0; i < count; ++i) {
        const double x = random.next(), y = random.next(), z = random.next();
        positions.push_back((Vec3d(x, y, z) - Vec3d(0.5)) * extent + Vec3d(centre));
    }
    return positions;
}

template <typename Codec>
static PointDataGrid::Ptr make(const std::vector<Vec3d>& positions, double voxel, const char* name)
{
    auto transform = math::Transform::createLinearTransform(voxel);
    PointAttributeVector<Vec3d> wrapper(positions);
    auto index = tools::createPointIndexGrid<tools::PointIndexGrid>(wrapper, *transform);
    auto grid = createPointDataGrid<Codec, PointDataGrid>(*index, wrapper, *transform);
    grid->setName(name);
    return grid;
}

template <typename Value, typename Codec = NullCodec, typename F>
static void attribute(PointDataGrid& grid, const char* name, F value, Index stride = 1)
{
    appendAttribute(grid.tree(), name, TypedAttributeArray<Value, Codec>::attributeType(), stride);
    int number = 0;
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) {
        AttributeWriteHandle<Value, Codec> handle(leaf->attributeArray(name));
        for (Index i = 0; i < leaf->pointCount(); ++i, ++number) {
            for (Index j = 0; j < stride; ++j) handle.set(i, j, value(number + 1000 * int(j)));
        }
    }
}

static void every_attribute(PointDataGrid& grid)
{
    auto wave = [](int n) { return float((n * 37 % 101) / 100.0 - 0.3); };
    auto unit = [](int n) { return float((n * 37 % 101) / 100.0); };
    auto small = [](int n) { return float((n * 37 % 101) / 101.0 - 0.5); };
    auto vector = [=](int n) { return Vec3s(wave(n), wave(3 * n + 1), wave(7 * n + 2)); };
    attribute<float>(grid, "pscale", unit);
    attribute<float, TruncateCodec>(grid, "half", wave);
    attribute<float>(grid, "uniform", [](int) { return 0.25f; });
    attribute<float>(grid, "pair", wave, 2);
    attribute<double>(grid, "double", [=](int n) { return wave(n) * 1.0 / 3; });
    attribute<bool>(grid, "bool", [](int n) { return n % 3 == 0; });
    attribute<int8_t>(grid, "byte", [](int n) { return int8_t(n * 7); });
    attribute<int16_t>(grid, "short", [](int n) { return int16_t(n * 771); });
    attribute<int32_t>(grid, "id", [](int n) { return n * 100003; });
    attribute<int64_t>(grid, "long", [](int n) { return int64_t(n) * 100000000003ll; });
    attribute<Vec3s>(grid, "v", vector);
    attribute<Vec3s, TruncateCodec>(grid, "v_half", vector);
    attribute<Vec3s, FixedPointCodec<true, UnitRange>>(grid, "Cd8",
        [=](int n) { return Vec3s(unit(n), unit(n + 1), unit(n + 2)); });
    attribute<Vec3s, FixedPointCodec<false, UnitRange>>(grid, "Cd16",
        [=](int n) { return Vec3s(unit(n), unit(n + 1), unit(n + 2)); });
    attribute<Vec3s, FixedPointCodec<true, PositionRange>>(grid, "offset8",
        [=](int n) { return Vec3s(small(n), small(n + 1), small(n + 2)); });
    attribute<Vec3s, FixedPointCodec<false, PositionRange>>(grid, "offset16",
        [=](int n) { return Vec3s(small(n), small(n + 1), small(n + 2)); });
    attribute<Vec3s, UnitVecCodec>(grid, "N", [=](int n) {
        Vec3s v = vector(n);
        v.normalize();
        return v;
    });
    attribute<Vec3d>(grid, "Pref", [=](int n) { return Vec3d(vector(n)) / 3; });
    attribute<Vec3i>(grid, "cell", [](int n) { return Vec3i(n, -n, n * n); });
    attribute<math::Quat<float>>(grid, "orient",
        [](int n) { return math::Quat<float>(0, 0, 0, float(n)); });
    appendAttribute<std::string>(grid.tree(), "label");
    appendGroup(grid.tree(), "odd");
    appendGroup(grid.tree(), "third");
    int number = 0;
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) {
        GroupWriteHandle odd = leaf->groupWriteHandle("odd");
        GroupWriteHandle third = leaf->groupWriteHandle("third");
        for (Index i = 0; i < leaf->pointCount(); ++i, ++number) {
            odd.set(i, number % 2 == 1);
            third.set(i, number % 3 == 0);
        }
    }
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) leaf->attributeArray("uniform").compact();
}

static void number(FILE* out, double value) { std::fprintf(out, "%.17g", value); }
static void number(FILE* out, float value) { std::fprintf(out, "%.17g", double(value)); }
static void number(FILE* out, bool value) { std::fprintf(out, "%d", int(value)); }
static void number(FILE* out, int8_t value) { std::fprintf(out, "%d", int(value)); }
static void number(FILE* out, int16_t value) { std::fprintf(out, "%d", int(value)); }
static void number(FILE* out, int32_t value) { std::fprintf(out, "%d", value); }
static void number(FILE* out, int64_t value) { std::fprintf(out, "\"%lld\"", (long long)value); }
template <typename T> static void number(FILE* out, const math::Vec3<T>& v)
{
    std::fputc('[', out);
    for (int i = 0; i < 3; ++i) {
        if (i) std::fputc(',', out);
        number(out, v[i]);
    }
    std::fputc(']', out);
}

template <typename Value>
static bool values(FILE* out, const PointDataGrid& grid, const std::string& name, Index stride)
{
    const char* between = "";
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        AttributeHandle<Value> handle(leaf->constAttributeArray(name));
        for (Index i = 0; i < leaf->pointCount(); ++i) {
            for (Index j = 0; j < stride; ++j) {
                std::fputs(between, out);
                between = ",";
                number(out, handle.get(i, j));
            }
        }
    }
    return true;
}

static void attributes(FILE* out, const PointDataGrid& grid)
{
    auto first = grid.tree().cbeginLeaf();
    if (!first) return;
    const auto& descriptor = first->attributeSet().descriptor();
    for (size_t i = 0; i < descriptor.size(); ++i) {
        std::string name;
        for (const auto& entry : descriptor.map()) if (entry.second == i) name = entry.first;
        const auto& type = descriptor.type(i);
        const Index stride = first->constAttributeArray(i).stride();
        std::fprintf(out, "%s\n{\"name\":\"%s\",\"type\":\"%s\",\"codec\":\"%s\",\"stride\":%u,\"values\":[",
            i ? "," : "", name.c_str(), type.first.c_str(), type.second.c_str(), stride);
        if (name == "P" || type.second == "grp" || type.second == "str") {}
        else if (type.first == "float") values<float>(out, grid, name, stride);
        else if (type.first == "double") values<double>(out, grid, name, stride);
        else if (type.first == "bool") values<bool>(out, grid, name, stride);
        else if (type.first == "int8") values<int8_t>(out, grid, name, stride);
        else if (type.first == "int16") values<int16_t>(out, grid, name, stride);
        else if (type.first == "int32") values<int32_t>(out, grid, name, stride);
        else if (type.first == "int64") values<int64_t>(out, grid, name, stride);
        else if (type.first == "vec3s") values<Vec3s>(out, grid, name, stride);
        else if (type.first == "vec3d") values<Vec3d>(out, grid, name, stride);
        else if (type.first == "vec3i") values<Vec3i>(out, grid, name, stride);
        std::fputs("]}", out);
    }
}

static void print(FILE* out, const PointDataGrid& grid)
{
    std::fprintf(out, "{\"name\":\"%s\",\"points\":%llu,\"positions\":[", grid.getName().c_str(),
        (unsigned long long)pointCount(grid.tree()));
    const char* between = "";
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        AttributeHandle<Vec3f> handle(leaf->constAttributeArray("P"));
        for (auto index = leaf->beginIndexAll(); index; ++index) {
            // In index space, as the sum in double of the voxel and the offset.
            std::fputs(between, out);
            between = ",";
            number(out, Vec3d(handle.get(*index)) + index.getCoord().asVec3d());
        }
    }
    std::fputs("],\"attributes\":[", out);
    attributes(out, grid);
    std::fputs("],\"groups\":{", out);
    if (auto first = grid.tree().cbeginLeaf()) {
        between = "";
        for (const auto& group : first->attributeSet().descriptor().groupMap()) {
            std::fprintf(out, "%s\"%s\":[", between, group.first.c_str());
            between = "";
            for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
                GroupHandle handle = leaf->groupHandle(group.first);
                for (Index i = 0; i < leaf->pointCount(); ++i) {
                    std::fprintf(out, "%s%d", between, int(handle.get(i)));
                    between = ",";
                }
            }
            std::fputs("]", out);
            between = ",";
        }
    }
    std::fputs("}}", out);
}

static void print_file(const std::string& path, const std::string& json)
{
    std::ifstream in(path, std::ios::binary);
    GridPtrVecPtr read = io::Stream(in, /*delayLoad=*/false).getGrids();
    FILE* out = std::fopen(json.c_str(), "w");
    std::fputs("{\"grids\":[", out);
    const char* between = "";
    for (const auto& grid : *read) {
        if (auto points = gridPtrCast<PointDataGrid>(grid)) {
            std::fputs(between, out);
            print(out, *points);
            between = ",\n";
        }
    }
    std::fputs("]}\n", out);
    std::fclose(out);
}

static void save(const std::string& folder, const std::string& name, const GridPtrVec& grids,
    uint32_t compression, bool stream = false)
{
    const std::string path = folder + "/" + name + ".vdb";
    if (stream) {
        std::ofstream out(path, std::ios::binary);
        io::Stream writer(out);
        writer.setCompression(compression);
        writer.write(grids);
    } else {
        io::File writer(path);
        writer.setCompression(compression);
        writer.write(grids);
    }
    // Printed as it was read back, not as it was made.
    print_file(path, folder + "/" + name + ".json");
}

int main(int argc, char** argv)
{
    openvdb::initialize();
    if (argc == 4 && std::string(argv[1]) == "--print") {
        print_file(argv[2], argv[3]);
        return 0;
    }
    if (argc != 2) return 2;
    const std::string folder = argv[1];
    const uint32_t blosc = io::COMPRESS_BLOSC | io::COMPRESS_ACTIVE_MASK;
    const auto positions = scattered(24, 12.0, 7.0);
    auto null = make<NullCodec>(positions, 0.5, "null");
    every_attribute(*null);
    save(folder, "points_blosc", {null}, blosc);
    save(folder, "points_zip", {null}, io::COMPRESS_ZIP | io::COMPRESS_ACTIVE_MASK);
    auto truncated = make<TruncateCodec>(positions, 0.5, "trnc");
    auto fixed8 = make<FixedPointCodec<true>>(positions, 0.5, "fxpt8");
    auto fixed16 = make<FixedPointCodec<false>>(positions, 0.5, "fxpt16");
    attribute<float>(*fixed16, "pscale", [](int n) { return float(n % 5) * 0.1f; });
    auto empty = make<NullCodec>({}, 0.5, "empty");
    FloatGrid::Ptr fog = FloatGrid::create();
    fog->setName("zfog");
    fog->tree().setValueOn(Coord(1, 2, 3), 0.5f);
    save(folder, "points_codecs", {truncated, fixed8, fixed16, empty, fog}, blosc);
    save(folder, "points_stream", {fixed16, fog}, blosc, true);
    auto instance = fixed16->copyGrid();
    instance->setName("twin");
    instance->setTransform(math::Transform::createLinearTransform(2.0));
    auto voxels = make<FixedPointCodec<false>>(std::vector<Vec3d>(600, Vec3d(1.0)), 0.5, "one_voxel");
    for (auto leaf = voxels->tree().beginLeaf(); leaf; ++leaf) leaf->compactAttributes();
    save(folder, "points_shared", GridPtrVec{fixed16, instance, voxels}, blosc);
    // Several pages, and an array larger than a page.
    auto many = make<NullCodec>(scattered(300000, 40.0), 0.5, "many");
    attribute<int32_t>(*many, "id", [](int n) { return n; });
    auto dense = make<NullCodec>(scattered(120000, 0.4), 0.5, "dense");
    attribute<float>(*dense, "pscale", [](int n) { return float(n); });
    // Not for the repository: too large.
    save(folder, "points_pages", {many, dense}, blosc);
    return 0;
}
