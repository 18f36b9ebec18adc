// Light that is scattered repeatedly in fog, by discrete ordinates: on a lattice of cubic cells, radiance in 14
// directions is carried from cell to cell along lines, then scattered, again and again.
//
// Within a cell and its neighbour upwind, the light that is scattered into a direction is linear along the line
// (short characteristics). Scattering in the forward peak counts as no scattering, so the phase function is linear
// in the cosine, and a cell is described by the mean of its radiance times 4π and its flux. Chebyshev iteration from
// coarse to fine lattices converges in a few sweeps (Golub and Varga 1961).

#import bevy_render::maths::PI
#import bevy_vdb::gpu::types::MAX_HALF
#import bevy_vdb::scattered_light::layout::{number_in, octant_word, octant_words}
#import bevy_vdb::trace::scattering::slab

struct Step {
    size: vec3<u32>,        // cells of the lattice
    first: u32,             // its first cell in the buffers
    coarse_size: vec3<u32>, // of the next coarser lattice
    coarse_first: u32,
    channels: u32,
    edge: f32,              // of a cell, in cells of the finest lattice
    relaxation: f32,        // how far a step goes towards what was scattered once more
    first_layer: u32,       // of texels
    // Axes of the lattice in world space.
    axis_x: vec4<f32>,
    axis_y: vec4<f32>,
    axis_z: vec4<f32>,
}

// A cell in one channel.
struct Cell {
    depth: f32,             // optical depth of the finest lattice's edge, without scattering in the peak
    scattering: f32,        // fraction of it that is scattered, per steradian
    anisotropy: f32,        // three times that of the scattering
    pad: f32,
    source: vec4<f32>,      // light from lights, and the sum of its directions
}

@group(0) @binding(0) var<uniform> job: Step;
@group(0) @binding(1) var<storage, read> octants: array<u32>;
@group(0) @binding(2) var<storage, read_write> cells: array<Cell>;
// For each cell, the mean radiance times 4π, and the flux.
@group(0) @binding(3) var<storage, read_write> light: array<vec4<f32>>;
// For each direction and cell.
@group(0) @binding(4) var<storage, read_write> radiance: array<f32>;
@group(0) @binding(5) var scattered: texture_storage_3d<rgba16float, write>;

const DIRECTIONS: u32 = 14u;
// Weights of the directions along axes and along diagonals: Lebedev's quadrature of degree 5.
const AXIS_WEIGHT: f32 = 4.0 * PI / 15.0;
const DIAGONAL_WEIGHT: f32 = 3.0 * PI / 10.0;

// The coordinates of a direction along axes: six along one of them, then eight diagonals. -1, 0 or 1.
fn steps_of(direction: u32) -> vec3<f32> {
    var steps = vec3(0.0);
    if direction < 6u {
        steps[direction / 2u] = select(1.0, -1.0, (direction & 1u) != 0u);
    } else {
        let bits = direction - 6u;
        steps = select(vec3(1.0), vec3(-1.0), vec3(bits & 1u, bits & 2u, bits & 4u) != vec3(0u));
    }
    return steps;
}

fn cell_count() -> u32 {
    return job.size.x * job.size.y * job.size.z;
}

// The number of a cell in one channel; channels follow each other.
fn cell_at(place: vec3<u32>, channel: u32) -> u32 {
    return job.first + channel * cell_count() + number_in(place, job.size);
}

fn coarse_cell_at(place: vec3<u32>, channel: u32) -> u32 {
    let size = job.coarse_size;
    return job.coarse_first + channel * size.x * size.y * size.z + number_in(place, size);
}

// What the octants say of a cell.
@compute @workgroup_size(4, 4, 4)
fn gather(@builtin(global_invocation_id) place: vec3<u32>) {
    if any(place >= job.size) {
        return;
    }
    let octant_count = vec3<i32>(2u * job.size);
    var depths = array<f32, 3>();
    var scattering = array<vec2<f32>, 3>();     // depths of what is not scattered in the peak, and of what is scattered
    var sources = array<vec4<f32>, 3>();
    var weights = 0.0;
    var anisotropy = vec2(0.0);                 // weighted sum, and its weight
    // A hat two cells wide.
    var hat = vec4(1.0, 3.0, 3.0, 1.0);
    for (var i = 0u; i < 64u; i++) {
        let at = vec3(i & 3u, (i >> 2u) & 3u, i >> 4u);
        let octant = 2 * vec3<i32>(place) + vec3<i32>(at) - 1;
        if any(octant < vec3(0)) || any(octant >= octant_count) {
            continue;
        }
        let first = octant_word(vec3<u32>(octant), 2u * job.size, job.channels);
        let own = unpack2x16float(octants[first]);
        let weight = hat[at.x] * hat[at.y] * hat[at.z] * own.x;
        let is_inside = all(at >= vec3(1u)) && all(at <= vec3(2u));
        if weight <= 0.0 {
            continue;
        }
        weights += weight;
        for (var channel = 0u; channel < job.channels; channel++) {
            let word = first + octant_words(0u) + 3u * channel;
            let rest = unpack2x16float(octants[word]);
            if is_inside {
                depths[channel] += rest.x / 8.0;
            }
            scattering[channel] += (weight / own.x) * rest;
            let arriving = vec4(unpack2x16float(octants[word + 1u]), unpack2x16float(octants[word + 2u]));
            sources[channel] += weight * arriving;
            if channel == 0u {
                anisotropy += (weight / own.x) * rest.y * vec2(own.y, 1.0);
            }
        }
    }
    for (var channel = 0u; channel < job.channels; channel++) {
        var cell = Cell();
        cell.depth = depths[channel];
        cell.scattering = scattering[channel].y / max(scattering[channel].x, 1e-20) / (4.0 * PI);
        cell.anisotropy = 3.0 * anisotropy.x / max(anisotropy.y, 1e-20);
        cell.source = sources[channel] / max(weights, 1e-20);
        cells[cell_at(place, channel)] = cell;
    }
}

// A cell of a coarser lattice: the mean of eight, weighted by what they attenuate.
@compute @workgroup_size(4, 4, 4)
fn coarsen(@builtin(global_invocation_id) place: vec3<u32>) {
    if any(place >= job.coarse_size) {
        return;
    }
    for (var channel = 0u; channel < job.channels; channel++) {
        var mean = Cell();
        var weights = 0.0;
        for (var i = 0u; i < 8u; i++) {
            let fine = 2u * place + vec3(i & 1u, (i >> 1u) & 1u, i >> 2u);
            if any(fine >= job.size) {
                continue;
            }
            let cell = cells[cell_at(fine, channel)];
            // Cells without fog hardly count.
            let weight = cell.depth + 1e-12;
            weights += weight;
            mean.depth += 0.125 * cell.depth;
            mean.scattering += weight * cell.scattering;
            mean.anisotropy += weight * cell.anisotropy;
            mean.source += weight * cell.source;
        }
        mean.scattering /= weights;
        mean.anisotropy /= weights;
        mean.source /= weights;
        cells[coarse_cell_at(place, channel)] = mean;
    }
}

// Where a line of cells begins, counted from the corner that light of this direction meets first. `line` counts the
// lines of all faces through which it enters; beyond the last one, the place is outside of the lattice.
fn line_start(direction: u32, line: u32) -> vec3<u32> {
    let size = job.size;
    let layer = size.x * size.y;
    if direction < 6u {
        let axis = direction / 2u;
        let widths = vec3(size.y, size.x, size.x);
        let place = vec2(line % widths[axis], line / widths[axis]);
        return select(
            select(vec3(place, 0u), vec3(place.x, 0u, place.y), axis == 1u),
            vec3(0u, place),
            axis == 0u,
        );
    }
    // Along a diagonal, lines enter through three faces; each line is counted for the first of them.
    if line < layer {
        return vec3(line % size.x, line / size.x, 0u);
    }
    let second = line - layer;
    let side = size.x * (size.z - 1u);
    if second < side {
        return vec3(second % size.x, 0u, 1u + second / size.x);
    }
    let third = second - side;
    let rows = max(size.y, 2u) - 1u;
    return vec3(0u, 1u + third % rows, 1u + third / rows);
}

// Carries radiance along a line of cells, one for each invocation: `x` counts lines, `y` directions, `z` channels.
@compute @workgroup_size(64)
fn sweep(@builtin(global_invocation_id) id: vec3<u32>) {
    let direction = id.y;
    let channel = id.z;
    var place = line_start(direction, id.x);
    let steps = steps_of(direction);
    let distance = length(steps);
    let ordinate = steps / distance;
    let moves = vec3<u32>(abs(steps));
    let stride = distance * job.edge;
    let is_reversed = steps < vec3(0.0);
    let first = ((direction * job.channels) + channel) * cell_count();
    var carried = 0.0;      // in the middle of the cell upwind
    var source_before = 0.0;
    var depth_before = 0.0;
    var is_first = true;
    while all(place < job.size) {
        let at = select(place, job.size - 1u - place, is_reversed);
        let index = cell_at(at, channel);
        let cell = cells[index];
        let total = cell.source + light[index];
        let source = cell.scattering * (total.x + cell.anisotropy * dot(ordinate, total.yzw));
        let before = select(source_before, source, is_first);
        let depth = 0.5 * stride * (cell.depth + depth_before);
        let part = slab(depth);
        let transmittance = 1.0 - part.opacity;
        carried = transmittance * carried + (part.mean - transmittance) * before + (1.0 - part.mean) * source;
        radiance[first + number_in(at, job.size)] = carried;
        source_before = source;
        depth_before = cell.depth;
        is_first = false;
        place += moves;
    }
}

// Adds up the directions of a cell, and takes a step towards the sums.
@compute @workgroup_size(64)
fn relax(@builtin(global_invocation_id) id: vec3<u32>) {
    let count = cell_count();
    let place = id.x;
    let channel = id.y;
    if place >= count {
        return;
    }
    var sum = vec4(0.0);
    for (var direction = 0u; direction < DIRECTIONS; direction++) {
        let own = radiance[(direction * job.channels + channel) * count + place];
        let steps = steps_of(direction);
        let weight = select(DIAGONAL_WEIGHT, AXIS_WEIGHT, direction < 6u);
        sum += (weight * own) * vec4(1.0, normalize(steps));
    }
    let index = job.first + channel * count + place;
    light[index] += job.relaxation * (sum - light[index]);
}

// Starts from the solution of the next coarser lattice, or without light if there is none.
@compute @workgroup_size(4, 4, 4)
fn refine(@builtin(global_invocation_id) place: vec3<u32>) {
    if any(place >= job.size) {
        return;
    }
    let is_coarsest = job.coarse_size.x == 0u;
    let last = vec3<i32>(job.coarse_size) - 1;
    let position = 0.5 * (vec3<f32>(place) + 0.5) - 0.5;
    let low = floor(position);
    let rest = position - low;
    for (var channel = 0u; channel < job.channels; channel++) {
        var sum = vec4(0.0);
        for (var i = 0u; i < 8u && !is_coarsest; i++) {
            let corner = vec3(i & 1u, (i >> 1u) & 1u, i >> 2u);
            let weights = select(1.0 - rest, rest, corner != vec3(0u));
            let at = clamp(vec3<i32>(low) + vec3<i32>(corner), vec3(0), last);
            sum += weights.x * weights.y * weights.z * light[coarse_cell_at(vec3<u32>(at), channel)];
        }
        light[cell_at(place, channel)] = sum;
    }
}

// Stores the solution, with fluxes in world space, and with a border of one texel around each channel, where the
// outermost cells continue.
@compute @workgroup_size(4, 4, 4)
fn store(@builtin(global_invocation_id) id: vec3<u32>) {
    let layers = job.size.z + 2u;
    let channel = id.z / layers;
    if any(id.xy >= job.size.xy + 2u) || channel >= job.channels {
        return;
    }
    let place = clamp(vec3(id.xy, id.z % layers), vec3(1u), job.size) - 1u;
    let own = light[cell_at(place, channel)];
    let flux = own.y * job.axis_x.xyz + own.z * job.axis_y.xyz + own.w * job.axis_z.xyz;
    let texel = vec3(id.xy, job.first_layer + id.z);
    textureStore(scattered, texel, clamp(vec4(own.x, flux), vec4(-MAX_HALF), vec4(MAX_HALF)));
}
