// Beam optimisation (Laine and Karras 2010, "Efficient sparse voxel octrees"): how far all rays of a tile
// can advance together before anything can stop one of them.
#define_import_path bevy_vdb::traversal::beam

#import bevy_vdb::gpu::types::{Grid, Rays}
#import bevy_vdb::traversal::rays::ray_through
#import bevy_vdb::traversal::tree::{CHILD, OCCUPIED, locate_slot, new_accessor, skip_of}
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray}

// Maximum number of skips of a beam. A beam may end anywhere, so this limits its cost only.
const MAX_SKIPS: u32 = 48u;
// No ray of a beam begins further behind its middle ray than this, in cells.
const MAX_CELLS_BEHIND: i32 = 1073741824;
// Error bounds of positions in f32: relative to the distance, and in cells.
const RELATIVE: f32 = 3.814697265625e-6;    // 2^-18
const MARGIN: f32 = 0.0009765625;           // 2^-10

// The rays of a tile of pixels. On the axes of the mirrored middle ray, they lie in a box that moves and
// grows with t.
struct Beam {
    mirrored: MirroredRay,
    slowest: vec3<f32>,
    fastest: vec3<f32>,
    low: vec3<f32>,         // low corner at t = 0, relative to the middle ray's cell
    high: vec3<f32>,        // high corner
    has_one_octant: bool,   // if false, the rays point to different octants and cannot be bounded
}

// The beam of a tile of 8×8 pixels.
fn beam_of(grid: Grid, rays: Rays, tile: vec2<u32>, size: vec2<u32>, t_min: f32) -> Beam {
    let pixel = 2.0 / vec2<f32>(size);
    let middle = vec2<f32>(8u * tile + 4u) * pixel - 1.0;
#ifdef VDB_EDGES
    // Rays pass anywhere through their pixels.
    let half = 4.1 * pixel;
#else
    // Pixel centres are up to 3½ pixels from the tile's centre.
    let half = 3.6 * pixel;
#endif
    let mirrored = mirrored_ray(grid, ray_through(rays, vec2(middle.x, -middle.y), t_min, FAR));
    let half_width = half.x * abs(rays.eye_x) + half.y * abs(rays.eye_y) + MARGIN;
    let growth = half.x * abs(rays.dir_x) + half.y * abs(rays.dir_y) + RELATIVE * mirrored.speed;
    let slowest = mirrored.speed - growth;
    let fastest = mirrored.speed + growth;
    let has_one_octant = all(slowest > vec3(0.0));
    return Beam(
        mirrored,
        slowest,
        fastest,
        mirrored.frac - half_width,
        mirrored.frac + half_width,
        has_one_octant,
    );
}

// A t before which no ray of the beam is in the grid's box.
fn beam_box_t(grid: Grid, beam: Beam) -> f32 {
    let mirrored = beam.mirrored;
    // If the middle ray begins past the box, other rays may not.
    if !beam.has_one_octant || !mirrored.meets {
        return mirrored.t_min;
    }
    let first = vec3<f32>(mirrored.first);
    let t_box = select(vec3(mirrored.t_min), (first - beam.high) / beam.fastest, mirrored.before);
    return max(max(max(t_box.x, t_box.y), t_box.z), mirrored.t_min);
}

// A t before which nothing can stop a ray of the beam, found by skipping empty space; FAR if nothing can.
fn beam_start_t(grid: Grid, beam: Beam) -> f32 {
    let mirrored = beam.mirrored;
    if !beam.has_one_octant || !mirrored.meets {
        return mirrored.t_min;
    }
    // Start of the box, relative to the middle ray's cell; behind that cell if the cell is in the box.
    let box_low = select(grid.occupied_min, ~grid.occupied_max, mirrored.mirror != vec3(0)) - mirrored.cell;
    // Further behind than 32 bits can express.
    let lowest = select(box_low, vec3(-MAX_CELLS_BEHIND), !mirrored.before & (box_low > vec3(0)));
    var t = beam_box_t(grid, beam);
    let first = max(vec3<i32>(floor(beam.low + t * beam.slowest)), lowest);
    var accessor = new_accessor((mirrored.cell + first) ^ mirrored.mirror);
    for (var skip = 0u; skip < MAX_SKIPS; skip++) {
        // Low corner of the beam. Cells below the box are as empty as those in it.
        let corner = vec3<i32>(floor(beam.low + t * beam.slowest));
        let cell = max(corner, lowest);
        if any(vec3<u32>(max(cell, vec3(0))) > mirrored.last) {
            return FAR;
        }
        let slot = locate_slot(grid, (mirrored.cell + cell) ^ mirrored.mirror, &accessor);
        if (slot & (CHILD | OCCUPIED)) != 0u {
            return t;
        }
        let size = 1i << accessor.log_dim;
        let low = (mirrored.cell + cell) & vec3(-size);
        let far = low + size * (1 + i32(skip_of(slot, mirrored.octant))) - mirrored.cell;
        // The whole beam stays in the empty cube until its high corner reaches a far plane.
        let t_out = (vec3<f32>(far) - beam.high) / beam.fastest;
        let next = min(min(t_out.x, t_out.y), t_out.z);
        if !(next > t) {
            return t;
        }
        t = next;
    }
    return t;
}
