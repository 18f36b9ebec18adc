// Optical depths along rays to a sun, from which the samples of the light cache are interpolated.
//
// The rays are parallel to the sun and cross every plane of samples, across the axis that is nearest to the
// sun's direction, in a square grid with the spacing of the samples. Planes are counted from the sun. From
// one to the next, the grid shifts by `job.slopes`; a *column* is a place in the plane, so rays move from
// column to column. In each plane there are columns around all samples, with one more on the low and two more
// on the high side, as cubic interpolation needs.
//
// `src/render/light_cache/columns.rs` sizes the buffer: a depth for each column of each plane, then the sum
// over each run of each ray.
#define_import_path bevy_vdb::light_cache::columns

#import bevy_vdb::light_cache::store::Place

// The planes whose segments one invocation adds up.
const RUN: u32 = 8u;

struct Job {
    origin: vec3<f32>,      // first sample, world space, relative to the view's eye
    volume: u32,            // in the volumes of the view
    axis_x: vec3<f32>,      // world units per cell of the volume's lattice
    step: f32,              // least voxels between samples of density on the way to the light
    axis_y: vec3<f32>,
    segment: f32,           // length of a ray between two planes, world units
    axis_z: vec3<f32>,
    planes: u32,
    light: vec3<f32>,       // direction to the sun, of unit length, world space
    major: u32,             // the axis across the planes
    slopes: vec2<f32>,      // shift of the rays from plane to plane along the next two axes, in spacings
    low_shift: vec2<i32>,   // the least and the greatest shift in any plane, rounded down
    high_shift: vec2<i32>,
    columns: vec2<u32>,     // of a plane
    is_reversed: u32,       // 1 if the first plane has the largest coordinate
    place: Place,
}

@group(2) @binding(6) var<uniform> job: Job;
@group(2) @binding(8) var<storage, read_write> depths: array<f32>;

// How far rays have shifted from the first plane, in spacings: whole ones and the rest.
struct Shift {
    whole: vec2<i32>,
    rest: vec2<f32>,
}

fn shift_at(plane: u32) -> Shift {
    let shift = f32(plane) * job.slopes;
    let whole = clamp(vec2<i32>(floor(shift)), job.low_shift, job.high_shift);
    return Shift(whole, saturate(shift - vec2<f32>(whole)));
}

fn ray_count() -> vec2<u32> {
    return job.columns + vec2<u32>(job.high_shift - job.low_shift);
}

// The column of a ray in a plane; outside the plane, it is negative or too large.
fn column_at(ray: vec2<u32>, plane: u32) -> vec2<i32> {
    return vec2<i32>(ray) + job.low_shift - shift_at(plane).whole;
}

fn is_in_plane(column: vec2<i32>) -> bool {
    return all(column >= vec2(0)) && all(column < vec2<i32>(job.columns));
}

fn depth_index(plane: u32, column: vec2<u32>) -> u32 {
    return (plane * job.columns.y + column.y) * job.columns.x + column.x;
}

fn run_index(ray: vec2<u32>, run: u32) -> u32 {
    let rays = ray_count();
    return job.planes * job.columns.x * job.columns.y + (run * rays.y + ray.y) * rays.x + ray.x;
}
