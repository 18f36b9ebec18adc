// Fills the light cache of one fog for one light: the optical depth of all fogs between each sample and the
// light. Samples beside which there is no fog are NO_FOG: nothing is computed for them, since no point in fog
// is interpolated from them.

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::light_cache::lattice::NO_FOG
#import bevy_vdb::light_cache::store::{Place, store_samples}
#import bevy_vdb::trace::occlusion::fog_depth_to_light
#import bevy_vdb::trace::segment::Point
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::traversal::tree::{CHILD, OCCUPIED, locate_slot, new_accessor}
#import bevy_vdb::view::scene::{view, volumes}

struct Job {
    origin: vec3<f32>,      // first sample, world space, relative to the view's eye
    volume: u32,            // in the volumes of the view
    axis_x: vec3<f32>,      // world units per cell of the volume's lattice
    range: f32,             // samples farther from a lamp are never read, world units
    axis_y: vec3<f32>,
    // Cells between samples, and the least between samples of density on the way to the light.
    spacing: f32,
    axis_z: vec3<f32>,
    is_lamp: u32,           // 1 for a point or spot light, 0 for a sun
    // The position of a lamp relative to the view's eye; the direction to a sun, of unit length. World space.
    light: vec3<f32>,
    place: Place,
}

@group(2) @binding(6) var<uniform> job: Job;

const LEAF_CELLS: i32 = 8;

// Whether fog may touch any of the eight cubes between samples around a sample, given by its local cell and its position
// in that cell.
fn is_beside_fog(grid: Grid, cell: vec3<i32>, frac: vec3<f32>) -> bool {
    let low = max(cell + vec3<i32>(floor(frac - job.spacing)), grid.occupied_min);
    let high = min(cell + vec3<i32>(ceil(frac + job.spacing)) - 1, grid.occupied_max);
    if any(low > high) {
        return false;
    }
    var accessor = new_accessor(low);
    // There are at most two leaves along each axis: spacings of a cell and more divide the edge of a leaf, with samples at
    // multiples of them, and below a cell, the cubes touch at most three cells.
    for (var i = 0; i < 8; i++) {
        let corner = vec3(i & 1, (i >> 1u) & 1, i >> 2u) * LEAF_CELLS;
        let at = min(low + corner, high);
        if (locate_slot(grid, at, &accessor) & (CHILD | OCCUPIED)) != 0u {
            return true;
        }
    }
    return false;
}

fn depth_at_sample(volume: u32, grid: Grid, sample: vec3<u32>) -> f32 {
    let from_origin = vec3<f32>(sample) * job.spacing;
    let offset = floor(from_origin);
    let cell = volumes[volume].light_origin + vec3<i32>(offset);
    let frac = from_origin - offset;
    if !is_beside_fog(grid, cell, frac) {
        return NO_FOG;
    }
    let from_eye = job.origin
        + from_origin.x * job.axis_x
        + from_origin.y * job.axis_y
        + from_origin.z * job.axis_z;
    let point = Point(vec2(0.0), 0.0, from_eye, volume, cell, frac);
    if job.is_lamp == 0u {
        return fog_depth_to_light(point, job.light, FAR, job.spacing);
    }
    let to_lamp = job.light - from_eye;
    let distance = length(to_lamp);
    if distance > job.range || distance <= 0.0 {
        return 0.0;
    }
    return fog_depth_to_light(point, to_lamp / distance, distance, job.spacing);
}

// Each thread writes two samples along x.
@compute @workgroup_size(4, 4, 4)
fn fill(@builtin(global_invocation_id) id: vec3<u32>) {
    let volume = view.volume_first + job.volume;
    let grid = grids[volumes[volume].grid];
    let sample = id * vec3(2u, 1u, 1u);
    if any(sample >= job.place.samples) {
        return;
    }
    let first = depth_at_sample(volume, grid, sample);
    var second = 0.0;
    if sample.x + 1u < job.place.samples.x {
        second = depth_at_sample(volume, grid, sample + vec3(1u, 0u, 0u));
    }
    store_samples(job.place, sample, first, second);
}
