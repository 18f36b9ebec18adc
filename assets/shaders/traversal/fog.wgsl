// Optical depth of fog along a ray. Twin of the exact integration: `optical_length` in
// `crates/vdb_core/src/pack/traverse.rs`.
#define_import_path bevy_vdb::traversal::fog

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::samples::{brick_corners, brick_of, brick_slot, fog_cell, tile_value, trilinear}
#import bevy_vdb::traversal::tree::{CHILD, LEAF_NUMBER, OCCUPIED, Accessor, LOWER_BITS, Span, empty_cell}
#import bevy_vdb::traversal::tree::{empty_accessor, locate, locate_moved, new_accessor, skip_of, span_constant}
#import bevy_vdb::traversal::tree::span_occupied
#import bevy_vdb::traversal::rebase::{Rebased, rebased_exit, rebased_t, rebased_at}
#import bevy_vdb::traversal::hdda::{FAR, MIN_SPEED, Dda, advance, box_exit, confirm, count_step, enter, local_cell}
#import bevy_vdb::traversal::hdda::{plane_t, exit_planes, unmirrored}
#ifdef VDB_RAMPS
#import bevy_vdb::traversal::ramps::{has_ramp, mean_extinction}
#endif
#ifdef VDB_FOG_MATERIALS
#import bevy_vdb::material::fog::{density_factor, has_function, mean_factor}
#endif

// Half the distance between the two Gauss–Legendre points on an interval of length 1.
const GAUSS: f32 = 0.28867513;

#ifdef VDB_RAMPS
// Values at the start, in the middle and at the end of a stretch between two parameters, counted from the
// rebased origin, within the cube of a span.
fn stretch_values(
    grid: Grid,
    mirrored: MirroredRay,
    rebased: Rebased,
    dda: Dda,
    span: Span,
    t_from: f32,
    t_to: f32,
) -> vec3<f32> {
    if span_constant(span) {
        return vec3(tile_value(grid, span.word));
    }
    let cell = fog_cell(grid, span, local_cell(mirrored, dda.rel));
    let origin = rebased.frac - vec3<f32>(dda.rel - rebased.cell);
    let first = saturate(origin + t_from * mirrored.speed);
    let last = saturate(origin + t_to * mirrored.speed);
    let middle = 0.5 * (first + last);
    return cell.offset
        + cell.scale
        * vec3(
            trilinear(cell.corners, unmirrored(mirrored, first)),
            trilinear(cell.corners, unmirrored(mirrored, middle)),
            trilinear(cell.corners, unmirrored(mirrored, last)),
        );
}
#endif

// Mean density between two parameters, counted from the rebased origin, within the cube of a span, changed by a
// custom material; for a grid with a ramp, mean extinction.
fn mean_density(
    grid: Grid,
    mirrored: MirroredRay,
    rebased: Rebased,
    dda: Dda,
    span: Span,
    t_from: f32,
    t_to: f32,
) -> f32 {
    let mean = mean_stored_density(grid, mirrored, rebased, dda, span, t_from, t_to);
#ifdef VDB_FOG_MATERIALS
    if mean > 0.0 && has_function(grid) {
        return mean * mean_factor(grid, mirrored, rebased, t_from, t_to);
    }
#endif
    return mean;
}

// The same without the material.
fn mean_stored_density(
    grid: Grid,
    mirrored: MirroredRay,
    rebased: Rebased,
    dda: Dda,
    span: Span,
    t_from: f32,
    t_to: f32,
) -> f32 {
#ifdef VDB_RAMPS
    if has_ramp(grid) {
        return mean_extinction(grid, stretch_values(grid, mirrored, rebased, dda, span, t_from, t_to));
    }
#endif
    if span_constant(span) {
        return tile_value(grid, span.word);
    }
    let cell = fog_cell(grid, span, local_cell(mirrored, dda.rel));
    let origin = rebased.frac - vec3<f32>(dda.rel - rebased.cell);
    let first = saturate(origin + mix(t_from, t_to, 0.5 - GAUSS) * mirrored.speed);
    let second = saturate(origin + mix(t_from, t_to, 0.5 + GAUSS) * mirrored.speed);
    let sum = trilinear(cell.corners, unmirrored(mirrored, first))
        + trilinear(cell.corners, unmirrored(mirrored, second));
    return cell.offset + 0.5 * cell.scale * sum;
}

// Cells that a traversal may move away from its rebased origin before it is rebased again.
const REBASE_RANGE: u32 = 64u;

// Upper limit of ∫ density dt. A slow ray through the largest densities would overflow f32.
const MAX_LENGTH: f32 = 3e38;

// ∫ density dt along a mirrored ray, up to `cutoff`. Within a trilinear cell, density is a cubic in t, which
// two-point Gauss–Legendre quadrature integrates exactly, so there is no step size to choose.
//
// The ray is rebased where a run of cells with density begins. This point does not depend on how the tree
// divides empty space into cubes, so a grid looks the same, bit for bit, wherever it is.
fn optical_length(grid: Grid, mirrored: MirroredRay, entry: Dda, cutoff: f32) -> f32 {
    var dda = entry;
    var accessor = new_accessor(local_cell(mirrored, dda.rel));
    var rebased = Rebased(vec3(0u), vec3(0.0), 0.0, FAR);
    var in_run = false;
    var t_from = 0.0;
    var sum = 0.0;
    while dda.inside && sum < cutoff {
        count_step();
        var span = locate(grid, local_cell(mirrored, dda.rel), mirrored.octant, &accessor);
        let current = dda;
        if !span_occupied(span) {
            dda = advance(mirrored, current, span);
            in_run = false;
            continue;
        }
        if !in_run || any(current.rel - rebased.cell > vec3(REBASE_RANGE)) {
            let confirmed = confirm(mirrored, current);
            if !confirmed.inside {
                dda = advance(mirrored, current, empty_cell());
                continue;
            }
            rebased = rebased_at(mirrored, confirmed.rel, confirmed.axis, confirmed.t);
            t_from = 0.0;
        }
        dda = advance(mirrored, current, span);
        let plane = exit_planes(mirrored, current.rel, span);
        let t_to = max(rebased_exit(rebased, mirrored, plane, dda.axis), t_from);
        let t_end = min(t_to, rebased.end);
        let mean = mean_density(grid, mirrored, rebased, current, span, t_from, t_end);
        sum += (t_end - t_from) * mean;
        t_from = t_to;
        // In a boundary tile, cells without density count as empty.
        in_run = mean > 0.0 && !span_constant(span);
    }
    return min(sum, MAX_LENGTH);
}

// A ray for sampling a grid.
struct SampledRay {
    cell: vec3<i32>,    // lattice cell of the origin
    origin: vec3<f32>,  // relative to that cell
    dir: vec3<f32>,
    t_origin: f32,      // t at the origin; all other t are counted from there
}

// The part of a ray that may be sampled.
struct SampledPart {
    ray: SampledRay,
    t_first: f32,       // where the ray enters the grid's box
    t_last: f32,        // where it leaves the box or ends; negative if it misses the box
}

// A sample position: a cell and a fraction in it.
struct SamplePoint {
    cell: vec3<i32>,
    u: vec3<f32>,
}

fn sample_at(ray: SampledRay, t: f32) -> SamplePoint {
    let position = ray.origin + t * ray.dir;
    let whole = floor(position);
    return SamplePoint(ray.cell + vec3<i32>(whole), position - whole);
}

// The largest f32 below 1.
const BELOW_ONE: f32 = 0.999999940395355224609375;

// Distance in cells from the first sample beyond which a ray is not sampled: f32 would skip cells by the
// hundred.
const MAX_DISTANCE: f32 = 1073741824.0;     // 2^30

// Distance in cells from the ray's origin within which f32 locates a sample to a thousandth of a voxel.
const PRECISE_RANGE: u32 = 8192u;

// The part of a mirrored ray in the box of its grid. Its origin is that of the ray or, if that is far away,
// where the ray enters the box: points that do not depend on the tree.
fn sampled_part(mirrored: MirroredRay) -> SampledPart {
    var ray = SampledRay();
    let t_entry = select(vec3(mirrored.t_min), plane_t(mirrored, mirrored.first), mirrored.before);
    let t_in = max(max(max(t_entry.x, t_entry.y), t_entry.z), mirrored.t_min);
    if !mirrored.meets || !(t_in < min(box_exit(mirrored), mirrored.t_max)) {
        return SampledPart(ray, 0.0, -1.0);
    }
    var rebased = Rebased(vec3(0u), mirrored.frac, 0.0, mirrored.t_max);
    if any(mirrored.last >= vec3(PRECISE_RANGE)) {
        let entry = enter(mirrored);
        if !entry.inside {
            return SampledPart(ray, 0.0, -1.0);
        }
        rebased = rebased_at(mirrored, entry.rel, entry.axis, entry.t);
    }
    let is_mirrored = mirrored.mirror != vec3(0);
    ray.cell = local_cell(mirrored, rebased.cell);
    // Less than 1, so that no sample lies behind the cell in either direction.
    ray.origin = min(unmirrored(mirrored, rebased.frac), vec3(BELOW_ONE));
    ray.dir = select(mirrored.speed, -mirrored.speed, is_mirrored);
    ray.t_origin = rebased.t;
    let t_exit = rebased_t(rebased, mirrored, mirrored.last + 1u);
    let farthest = MAX_DISTANCE * min(min(mirrored.inverse.x, mirrored.inverse.y), mirrored.inverse.z);
    let t_last = min(min(min(t_exit.x, t_exit.y), t_exit.z), min(rebased.end, farthest));
    return SampledPart(ray, t_in - rebased.t, t_last);
}

// What a ray finds at one of its points.
struct Sample {
    is_empty: bool,     // whether the point is in an empty cube
    t_out: f32,         // where the ray leaves that cube
    density: f32,
    point: SamplePoint,
}

// The sample position at t on a ray, in a cell of the grid's box.
fn point_in_box(grid: Grid, ray: SampledRay, t: f32) -> SamplePoint {
    let point = sample_at(ray, t);
    return SamplePoint(clamp(point.cell, grid.occupied_min, grid.occupied_max), point.u);
}

// A sample position and the word of the smallest slot that covers it.
struct Located {
    point: SamplePoint,
    slot: u32,
}

// Looks up the point at t on a ray.
fn slot_at(grid: Grid, ray: SampledRay, accessor: ptr<function, Accessor>, t: f32) -> Located {
    var point = sample_at(ray, t);
    let changed = point.cell ^ (*accessor).cell;
    // An empty accessor has no cell to compare with.
    let moved = select(bitcast<u32>(changed.x | changed.y | changed.z), ~0u, (*accessor).log_dim == 0u);
    if (moved >> LOWER_BITS) != 0u {
        // Rounding may move a cell out of the box, which the top-level tree does not cover.
        point.cell = clamp(point.cell, grid.occupied_min, grid.occupied_max);
    }
    return Located(point, locate_moved(grid, point.cell, moved, accessor));
}

// Where a ray leaves the empty cube at a point, with the further ones that its word says it can skip.
fn skipped_t(ray: SampledRay, located: Located, log_dim: u32) -> f32 {
    let is_mirrored = ray.dir < vec3(0.0);
    let octant = dot(vec3<u32>(is_mirrored), vec3(4u, 2u, 1u));
    let size = 1i << log_dim;
    let low = located.point.cell & vec3(-size);
    let ahead = i32(skip_of(located.slot, octant) << log_dim);
    let planes = select(low + (size + ahead), low - ahead, is_mirrored);
    // A plane ahead may be more than 2^31 cells away, which requires an unsigned integer.
    let cells =
        vec3<f32>(bitcast<vec3<u32>>(select(planes - ray.cell, ray.cell - planes, is_mirrored)));
    // Computed here, because keeping it along the ray would take three registers.
    let inverse = 1.0 / max(abs(ray.dir), vec3(MIN_SPEED));
    let t_out = (cells - select(ray.origin, -ray.origin, is_mirrored)) * inverse;
    return min(min(t_out.x, t_out.y), t_out.z);
}

// Density at t on a ray.
fn sample_fog(grid: Grid, ray: SampledRay, accessor: ptr<function, Accessor>, t: f32) -> Sample {
    let located = slot_at(grid, ray, accessor, t);
    count_step();
    if (located.slot & (CHILD | OCCUPIED)) == 0u {
        return Sample(true, skipped_t(ray, located, (*accessor).log_dim), 0.0, located.point);
    }
    return Sample(false, t, changed_density(grid, *accessor, located.point), located.point);
}

// What a ray finds at one of its points, without the density.
struct Probe {
    is_empty: bool,     // whether the point is in an empty cube
    t_out: f32,         // where the ray leaves that cube
}

fn probe_fog(grid: Grid, ray: SampledRay, accessor: ptr<function, Accessor>, t: f32) -> Probe {
    let located = slot_at(grid, ray, accessor, t);
    count_step();
    let is_empty = (located.slot & (CHILD | OCCUPIED)) == 0u;
    return Probe(is_empty, skipped_t(ray, located, (*accessor).log_dim));
}

// Density at a point in a leaf or a tile. At the edge of a boundary tile, it is the tile's density.
fn density_at(grid: Grid, accessor: Accessor, point: SamplePoint) -> f32 {
    if (accessor.word & CHILD) == 0u {
        return tile_value(grid, accessor.word);
    }
    let brick = brick_of(grid, accessor.head + (accessor.word & LEAF_NUMBER));
    return brick.offset
        + brick.scale * trilinear(brick_corners(grid, brick, brick_slot(point.cell)), point.u);
}

// The same, changed by a custom material.
fn changed_density(grid: Grid, accessor: Accessor, point: SamplePoint) -> f32 {
    let density = density_at(grid, accessor, point);
#ifdef VDB_FOG_MATERIALS
    if has_function(grid) {
        return density * density_factor(grid, point.cell, point.u);
    }
#endif
    return density;
}

#ifdef VDB_BLACKBODY
// Density at a point, and the highest at the corners of its cell.
struct BoundedDensity {
    density: f32,
    highest: f32,
}

// Density at t on a ray; 0 in empty cubes.
fn bounded_density(grid: Grid, ray: SampledRay, accessor: ptr<function, Accessor>, t: f32) -> BoundedDensity {
    let located = slot_at(grid, ray, accessor, t);
    count_step();
    if (located.slot & (CHILD | OCCUPIED)) == 0u {
        return BoundedDensity(0.0, 0.0);
    }
    let word = (*accessor).word;
    if (word & CHILD) == 0u {
        let density = tile_value(grid, word);
        return BoundedDensity(density, density);
    }
    let brick = brick_of(grid, (*accessor).head + (word & LEAF_NUMBER));
    let corners = brick_corners(grid, brick, brick_slot(located.point.cell));
    let pairs = max(corners.low, corners.high);
    let highest = max(max(pairs.x, pairs.y), max(pairs.z, pairs.w));
    return BoundedDensity(
        brick.offset + brick.scale * trilinear(corners, located.point.u),
        brick.offset + brick.scale * highest,
    );
}
#endif

// Largest step length, as a multiple of the first.
const MAX_STRIDE: f32 = 8.0;
// The exponent of T^(-1/3), as a power of 2, per unit of optical depth.
const STRIDE_GROWTH: f32 = 0.48089835;

// Above 2^24, adding 1 to an f32 may not change it, and a loop that does so would never end.
#ifdef VDB_WIDE_GRIDS
// The next f32 after 1. Multiplying a larger f32 by it always changes the f32.
const NEXT_FLOAT: f32 = 1.00000011920928955078125;
#else
// Largest number of steps along a ray in other grids. If that is too few, steps become longer.
const MAX_STEPS: f32 = 8388608.0;   // 2^23
#endif

// The index of the next step, greater than `k` even in f32.
fn next_index(k: f32, next: f32) -> f32 {
#ifdef VDB_WIDE_GRIDS
    return max(next, k * NEXT_FLOAT);
#else
    return next;
#endif
}

// The length of steps on a ray that ends at `t_end`.
fn step_length(t_step: f32, t_end: f32) -> f32 {
#ifdef VDB_WIDE_GRIDS
    return t_step;
#else
    return max(t_step, t_end / MAX_STEPS);
#endif
}

// Factor by which steps are longer at an optical depth. An error in the optical depth of a step changes the
// transmittance T in proportion to T, and grows with the square of the step length. For a given number of
// steps, the error is smallest with lengths proportional to T^(-1/3).
fn stride_at(optical_depth: f32) -> f32 {
    return min(exp2(STRIDE_GROWTH * optical_depth), MAX_STRIDE);
}

// ∫ density dt by ray marching, with density sampled in the middle of each step. The first step is `step`
// voxels long; steps are counted from the origin of the sampled ray. Nothing attenuates the ray before
// `start`. `extinction` is the optical depth per unit of the integral.
fn stepped_length(
    grid: Grid,
    mirrored: MirroredRay,
    start: f32,
    cutoff: f32,
    step: f32,
    extinction: f32,
) -> f32 {
    let part = sampled_part(mirrored);
    let ray = part.ray;
    let t_step = step_length(step / length(mirrored.speed), part.t_last);
    let inverse_step = 1.0 / t_step;
    var accessor = empty_accessor();
    // Saves one multiplication per step over `stride_at` and branches around empty cubes: 5 % faster on a
    // cloud.
    let growth = STRIDE_GROWTH * extinction;
    var sum = 0.0;
    var k = max(ceil(max(start - ray.t_origin, part.t_first) * inverse_step - 0.5), 0.0);
    while k * t_step < part.t_last && sum < cutoff {
        let stride = min(exp2(growth * sum), MAX_STRIDE);
        // The last step ends with the ray.
        let width = min(stride * t_step, part.t_last - k * t_step);
        let located = slot_at(grid, ray, &accessor, k * t_step + 0.5 * width);
        count_step();
        if (located.slot & (CHILD | OCCUPIED)) == 0u {
            let t_out = skipped_t(ray, located, accessor.log_dim);
            k = next_index(k, max(k + 1.0, ceil(t_out * inverse_step - 0.5)));
            continue;
        }
        sum += width * changed_density(grid, accessor, located.point);
        k = next_index(k, k + stride);
    }
    return min(sum, MAX_LENGTH);
}
