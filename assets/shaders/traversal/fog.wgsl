// What a fog does to a ray. Twin of the traversal: `optical_length` in `pack/traverse.rs`.
#define_import_path bevy_vdb::traversal::fog

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::samples::{brick_corners, brick_of, brick_slot, fog_cell, tile_value, trilinear}
#import bevy_vdb::traversal::tree::{CHILD, LEAF_NUMBER, OCCUPIED, Place, LOWER_BITS, Span, empty_cell, locate, locate_slot, nowhere, skip_of, span_constant, span_occupied}
#import bevy_vdb::traversal::rebase::{Rebased, rebased_exit, rebased_t, rebased_at}
#import bevy_vdb::traversal::hdda::{FAR, Dda, advance, box_exit, confirm, count_step, enter, local_cell, plane_t, planes_behind, unmirrored}

// Half the distance between the two points of Gauss and Legendre on an interval of length 1.
const GAUSS: f32 = 0.28867513;

// The mean density between two parameters from the rebased origin on, within the cube of a span.
fn mean_density(
    grid: Grid,
    mirrored: MirroredRay,
    near: Rebased,
    dda: Dda,
    span: Span,
    t_from: f32,
    t_to: f32,
) -> f32 {
    if span_constant(span) {
        return tile_value(grid, span.word);
    }
    let fog = fog_cell(grid, span, local_cell(mirrored, dda.rel));
    let origin = near.frac - vec3<f32>(dda.rel - near.cell);
    let first = saturate(origin + mix(t_from, t_to, 0.5 - GAUSS) * mirrored.speed);
    let second = saturate(origin + mix(t_from, t_to, 0.5 + GAUSS) * mirrored.speed);
    let sum = trilinear(fog.corners, unmirrored(mirrored, first)) + trilinear(fog.corners, unmirrored(mirrored, second));
    return fog.offset + 0.5 * fog.scale * sum;
}

// Cells that a traversal may be away from its rebased origin before it gets a new one.
const REBASE_RANGE: u32 = 64u;

// What ∫ density dt is at most: that of the greatest densities exceeds f32 where a ray takes long to pass.
const MOST_LENGTH: f32 = 3e38;

// ∫ density dt along the mirrored ray, up to `enough`. Within one trilinear cell the density is a cubic in t,
// which the two-point rule of Gauss and Legendre integrates exactly: there is no step to choose.
//
// Rebased origins stand where a run of cells with a density begins: a place that does not depend on how the
// tree cuts the void into cubes, so that a grid looks the same, bit for bit, wherever it stands.
fn optical_length(grid: Grid, mirrored: MirroredRay, enters: Dda, enough: f32) -> f32 {
    var dda = enters;
    var place = nowhere(local_cell(mirrored, dda.rel));
    var near = Rebased(vec3(0u), vec3(0.0), 0.0, FAR);
    var in_run = false;
    var t_from = 0.0;
    var sum = 0.0;
    while dda.inside && sum < enough {
        count_step();
        var span = locate(grid, local_cell(mirrored, dda.rel), mirrored.octant, &place);
        let here = dda;
        if !span_occupied(span) {
            dda = advance(mirrored, here, span);
            in_run = false;
            continue;
        }
        if !in_run || any(here.rel - near.cell > vec3(REBASE_RANGE)) {
            let own = confirm(mirrored, here);
            if !own.inside {
                dda = advance(mirrored, here, empty_cell());
                continue;
            }
            near = rebased_at(mirrored, own.rel, own.axis, own.t);
            t_from = 0.0;
        }
        dda = advance(mirrored, here, span);
        let plane = planes_behind(mirrored, here.rel, span);
        let t_to = max(rebased_exit(near, mirrored, plane, dda.axis), t_from);
        let t_end = min(t_to, near.end);
        let mean = mean_density(grid, mirrored, near, here, span, t_from, t_end);
        sum += (t_end - t_from) * mean;
        t_from = t_to;
        // Of a boundary tile, cells without density count as void.
        in_run = mean > 0.0 && !span_constant(span);
    }
    return min(sum, MOST_LENGTH);
}

// A ray between samples of a fog: places in cells of the lattice, from the cell of its rebased origin on.
struct Samples {
    cell: vec3<i32>,
    origin: vec3<f32>,
    way: vec3<f32>,
}

// A place of a sample.
struct Sample {
    cell: vec3<i32>,
    u: vec3<f32>,
}

fn sample_at(samples: Samples, t: f32) -> Sample {
    let at = samples.origin + t * samples.way;
    let whole = floor(at);
    return Sample(samples.cell + vec3<i32>(whole), at - whole);
}

// The density at a place in a leaf or a tile. At the border of a boundary tile, it is that of the tile.
fn density_in(grid: Grid, place: Place, sample: Sample) -> f32 {
    if (place.word & CHILD) == 0u {
        return tile_value(grid, place.word);
    }
    let brick = brick_of(grid, place.head + (place.word & LEAF_NUMBER));
    return brick.offset + brick.scale * trilinear(brick_corners(grid, brick, brick_slot(sample.cell)), sample.u);
}

// How many times its length a step becomes at most.
const MOST_STRIDE: f32 = 8.0;

// The largest f32 below 1.
const BELOW_ONE: f32 = 0.999999940395355224609375;

// Cells from its first sample on that a ray is sampled at most: farther, an f32 counts cells by the hundred.
const FARTHEST: f32 = 1073741824.0;     // 2^30

// From 2^24 steps on, an f32 plus 1 can be itself, and a loop that adds 1 would stand still.
#ifdef VDB_WIDE_GRIDS
// Next to 1: an f32 times this is another one, however large.
const ONWARDS: f32 = 1.00000011920928955078125;
#else
// What a ray through other grids is divided into at most; where that is too few, steps are longer.
const MOST_STEPS: f32 = 8388608.0;      // 2^23
#endif

// The number of a step from which the ray goes on, at least a step after the last.
fn onwards(k: f32, next: f32) -> f32 {
#ifdef VDB_WIDE_GRIDS
    return max(next, k * ONWARDS);
#else
    return next;
#endif
}

// Cells from the ray's own within which f32 says where a sample is to a thousandth of a voxel.
const CLOSE: u32 = 8192u;

// The same by the density in the middles of steps, the first of them `step` voxels long. They are counted
// from the ray's own place, or from where it comes into the grid's box if that is far away: places that do
// not depend on the tree. Nothing dims the ray before `start`; `dims` is the optical depth of a unit of what
// is integrated.
//
// Of the transmittance T, a step errs by T times what the optical depth errs, which grows with its square.
// The least error for a number of steps has them in proportion to T^(-1/3).
fn stepped_length(
    grid: Grid,
    mirrored: MirroredRay,
    start: f32,
    enough: f32,
    step: f32,
    dims: f32,
) -> f32 {
    let entries = select(vec3(mirrored.t_min), plane_t(mirrored, mirrored.first), mirrored.before);
    let t_in = max(max(max(entries.x, entries.y), entries.z), mirrored.t_min);
    if !mirrored.meets || !(t_in < min(box_exit(mirrored), mirrored.t_max)) {
        return 0.0;
    }
    var near = Rebased(vec3(0u), mirrored.frac, 0.0, mirrored.t_max);
    if any(mirrored.last >= vec3(CLOSE)) {
        let enters = enter(mirrored);
        if !enters.inside {
            return 0.0;
        }
        near = rebased_at(mirrored, enters.rel, enters.axis, enters.t);
    }
    let is_down = mirrored.mirror != vec3(0);
    let way = select(mirrored.speed, -mirrored.speed, is_down);
    let inverse = select(mirrored.inverse, -mirrored.inverse, is_down);
    // Below 1, so that no sample is behind the cell, whichever way the ray goes.
    let origin = min(unmirrored(mirrored, near.frac), vec3(BELOW_ONE));
    let samples = Samples(local_cell(mirrored, near.cell), origin, way);
    let exits = rebased_t(near, mirrored, mirrored.last + 1u);
    let farthest = FARTHEST * min(min(mirrored.inverse.x, mirrored.inverse.y), mirrored.inverse.z);
    let t_end = min(min(min(exits.x, exits.y), exits.z), min(near.end, farthest));
#ifdef VDB_WIDE_GRIDS
    let t_step = step / length(mirrored.speed);
#else
    let t_step = max(step / length(mirrored.speed), t_end / MOST_STEPS);
#endif
    let per_step = 1.0 / t_step;
    // Of T^(-1/3), as a power of 2.
    let growth = dims * 0.48089835;
    var place = nowhere(samples.cell);
    var sum = 0.0;
    var k = max(ceil((max(start, t_in) - near.t) * per_step - 0.5), 0.0);
    while sum < enough && k * t_step < t_end {
        let stride = min(exp2(growth * sum), MOST_STRIDE);
        // The last step ends with the ray.
        let part = min(stride * t_step, t_end - k * t_step);
        var here = sample_at(samples, k * t_step + 0.5 * part);
        let apart = here.cell ^ place.cell;
        if ((apart.x | apart.y | apart.z) >> LOWER_BITS) != 0 {
            // Rounding may lead a cell out of the box, and the top-level tree knows of nothing there.
            here.cell = clamp(here.cell, grid.occupied_min, grid.occupied_max);
        }
        let slot = locate_slot(grid, here.cell, &place);
        count_step();
        if (slot & (CHILD | OCCUPIED)) == 0u {
            let size = 1i << place.log_dim;
            let low = here.cell & vec3(-size);
            let ahead = i32(skip_of(slot, mirrored.octant) << place.log_dim);
            let planes = select(low + (size + ahead), low - ahead, is_down);
            // A plane ahead can be more than 2^31 cells away, which only an unsigned number can hold.
            let cells = vec3<f32>(bitcast<vec3<u32>>(select(planes - samples.cell, samples.cell - planes, is_down)));
            let out = (select(cells, -cells, is_down) - samples.origin) * inverse;
            k = onwards(k, max(k + 1.0, ceil(min(min(out.x, out.y), out.z) * per_step - 0.5)));
            continue;
        }
        sum += part * density_in(grid, place, here);
        k = onwards(k, k + stride);
    }
    return min(sum, MOST_LENGTH);
}
