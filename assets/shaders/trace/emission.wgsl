// Emission of grids along a segment.
#define_import_path bevy_vdb::trace::emission

#import bevy_vdb::gpu::types::{Grid, KIND_BLACKBODY, KIND_EMISSION}
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::fog::{SampledRay, optical_length, sample_fog}
#import bevy_vdb::traversal::tree::Accessor
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray, enter_at}
#import bevy_vdb::view::scene::volumes
#import bevy_vdb::trace::segment::{Segment, lattice_ray}
#ifdef VDB_BLACKBODY
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::rebase::{Rebased, rebased_exit, rebased_at}
#import bevy_vdb::traversal::fog::{REBASE_RANGE, BoundedDensity, bounded_density}
#import bevy_vdb::traversal::hdda::{Dda, advance, confirm, local_cell, exit_planes, unmirrored}
#import bevy_vdb::traversal::samples::{FogCell, fog_cell, tile_value, trilinear}
#import bevy_vdb::traversal::tree::{Span, empty_cell, locate, new_accessor, span_constant, span_occupied}

// Black-body colours in even steps of the logarithm of temperature: a colour with a luminance of 1, and the
// logarithm of the luminance. Twin: `BlackbodyTable` in `crates/vdb_core/src/blackbody.rs`.
@group(2) @binding(11) var blackbody_colors: texture_2d<f32>;

// Temperature of the first entry in kelvin, and the logarithm of the ratio of the last to the first.
const MIN_KELVIN: f32 = 500.0;
const LOG_RANGE: f32 = 4.382026634673881;   // ln 80

// Luminance of a black body, cd/m².
fn blackbody(kelvin: f32) -> vec3<f32> {
    let last = textureDimensions(blackbody_colors).x - 1u;
    let steps = clamp(log(max(kelvin, MIN_KELVIN) / MIN_KELVIN) * (f32(last) / LOG_RANGE), 0.0, f32(last));
    let first = min(u32(steps), last - 1u);
    let low = textureLoad(blackbody_colors, vec2(first, 0u), 0);
    let high = textureLoad(blackbody_colors, vec2(first + 1u, 0u), 0);
    let entry = mix(low, high, steps - f32(first));
    // Cool black bodies are outside the gamut: their blue is negative.
    return select(vec3(0.0), max(entry.rgb, vec3(0.0)) * exp(entry.w), kelvin >= MIN_KELVIN);
}

fn blackbody_emission(volume: u32, value: f32) -> vec3<f32> {
    let kelvin = min(volumes[volume].temperature_scale * value, 1e9) + volumes[volume].temperature_offset;
    return select(vec3(0.0), blackbody(kelvin), value > 0.0);
}

// Four-point Gauss–Legendre quadrature on an interval of length 1: distances from the middle, and weights.
const INNER: f32 = 0.16999052;
const OUTER: f32 = 0.43056816;
const INNER_WEIGHT: f32 = 0.32607258;
const OUTER_WEIGHT: f32 = 0.17392742;

// The part of a mirrored ray inside a cell.
struct Chord {
    cell: FogCell,
    first: vec3<f32>,   // within the cell, on the axes of the mirrored ray
    last: vec3<f32>,
}

fn chord_emission(volume: u32, mirrored: MirroredRay, chord: Chord, s: f32) -> vec3<f32> {
    let at = unmirrored(mirrored, saturate(mix(chord.first, chord.last, s)));
    return blackbody_emission(
        volume,
        chord.cell.offset + chord.cell.scale * trilinear(chord.cell.corners, at),
    );
}

// Mean luminance between two parameters, counted from the rebased origin, within the cube of a span. The
// luminance of a black body grows much faster than its temperature. The two points that suffice for density
// would get three quarters of the light wrong in a cell from cold to hot; four points get less than a
// hundredth wrong.
fn mean_emission(
    volume: u32,
    grid: Grid,
    mirrored: MirroredRay,
    rebased: Rebased,
    dda: Dda,
    span: Span,
    t_from: f32,
    t_to: f32,
) -> vec3<f32> {
    if span_constant(span) {
        return blackbody_emission(volume, tile_value(grid, span.word));
    }
    let origin = rebased.frac - vec3<f32>(dda.rel - rebased.cell);
    let chord = Chord(
        fog_cell(grid, span, local_cell(mirrored, dda.rel)),
        origin + t_from * mirrored.speed,
        origin + t_to * mirrored.speed,
    );
    let inner = chord_emission(volume, mirrored, chord, 0.5 - INNER)
        + chord_emission(volume, mirrored, chord, 0.5 + INNER);
    let outer = chord_emission(volume, mirrored, chord, 0.5 - OUTER)
        + chord_emission(volume, mirrored, chord, 0.5 + OUTER);
    return INNER_WEIGHT * inner + OUTER_WEIGHT * outer;
}

// ∫ B dt along a mirrored ray, cell by cell, with the same traversal as `optical_length`.
fn integrated_emission(volume: u32, grid: Grid, mirrored: MirroredRay, entry: Dda) -> vec3<f32> {
    var dda = entry;
    var accessor = new_accessor(local_cell(mirrored, dda.rel));
    var rebased = Rebased(vec3(0u), vec3(0.0), 0.0, FAR);
    var in_run = false;
    var t_from = 0.0;
    var sum = vec3(0.0);
    while dda.inside {
        let current = dda;
        let span = locate(grid, local_cell(mirrored, current.rel), mirrored.octant, &accessor);
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
        sum += (t_end - t_from)
            * mean_emission(volume, grid, mirrored, rebased, current, span, t_from, t_end);
        t_from = t_to;
        in_run = !span_constant(span);
    }
    return sum;
}
#endif

// Whether a volume is an emissive grid.
fn is_emitter(volume: u32) -> bool {
    return volumes[volume].kind == KIND_EMISSION || volumes[volume].kind == KIND_BLACKBODY;
}

// Upper limit of emission, which stays within f32 when multiplied by the exposure.
const MAX_EMISSION: f32 = 1e20;

// ∫ ε ds over an interval of a segment, in cd/m². Nothing emits before `start`.
fn segment_emission(segment: Segment, volume: u32, start: f32, t_min: f32, t_max: f32) -> vec3<f32> {
    var ray = lattice_ray(segment, volume, t_max);
    ray.t_min = max(ray.t_min, t_min);
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, ray);
    let entry = enter_at(mirrored, start);
    let dir_length = length(segment.dir);
#ifdef VDB_BLACKBODY
    if volumes[volume].kind == KIND_BLACKBODY {
        let luminance = min(integrated_emission(volume, grid, mirrored, entry), vec3(MAX_EMISSION));
        return min(volumes[volume].emissive * dir_length * luminance, vec3(MAX_EMISSION));
    }
#endif
    let length_sum = min(optical_length(grid, mirrored, entry, FAR), MAX_EMISSION);
    return min(volumes[volume].emissive * dir_length * length_sum, vec3(MAX_EMISSION));
}

// Samples per step of a ray that is marched through scalar emission: at most a voxel apart, so that none is
// lost of what is one voxel thick.
const SCALAR_SAMPLES: u32 = 2u;

// A step through emission.
struct EmissionStep {
    t_low: f32,     // from the origin of the sampled ray
    t_high: f32,
    t_first: f32,   // where the ray enters the grid's box, and where it leaves it or ends
    t_last: f32,
    visible: f32,   // what an emission of 1 would add to the pixel's value
    shown: f32,     // the part of the pixel's value that emission before this step adds
}

fn max3(v: vec3<f32>) -> f32 {
    return max(max(v.x, v.y), v.z);
}

// Mean of a scalar emission over a step.
fn sampled_scalar(grid: Grid, ray: SampledRay, accessor: ptr<function, Accessor>, step: EmissionStep) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < SCALAR_SAMPLES; i++) {
        let t = mix(step.t_low, step.t_high, (f32(i) + 0.5) / f32(SCALAR_SAMPLES));
        if t >= step.t_first && t < step.t_last {
            sum += clamp(sample_fog(grid, ray, accessor, t).density, 0.0, MAX_EMISSION);
        }
    }
    return sum / f32(SCALAR_SAMPLES);
}

#ifdef VDB_BLACKBODY
// Samples per step of a ray that is marched through a black body, whose luminance grows with about the
// fourteenth power of the temperature.
const BLACKBODY_SAMPLES: u32 = 10u;
// Voxels per sample, at most, in a first pass over a step. These samples suffice if the step would add less
// than a fraction to what the ray has met before, or less than a value to the pixel, even if all of it were
// as hot as the hottest corner of their cells. (Samples that are farther apart would err by a tenth.)
const PROBED_VOXELS: f32 = 1.5;
const MAX_PROBES: u32 = 6u;
const NEGLIGIBLE_FRACTION: f32 = 0.01;
const NEGLIGIBLE_VALUE: f32 = 3e-5;

fn bounded_temperature(
    grid: Grid,
    ray: SampledRay,
    accessor: ptr<function, Accessor>,
    step: EmissionStep,
    t: f32,
) -> BoundedDensity {
    if t < step.t_first || t >= step.t_last {
        return BoundedDensity(0.0, 0.0);
    }
    return bounded_density(grid, ray, accessor, t);
}

// Mean luminance of a black body over a step. `factor` is the emission for a luminance of 1.
fn sampled_blackbody(
    volume: u32,
    grid: Grid,
    ray: SampledRay,
    accessor: ptr<function, Accessor>,
    step: EmissionStep,
    factor: f32,
) -> vec3<f32> {
    let voxels = (step.t_high - step.t_low) * length(ray.dir);
    let probes = u32(clamp(ceil(voxels / PROBED_VOXELS), 1.0, f32(MAX_PROBES + 1u)));
    if probes <= MAX_PROBES {
        var highest = 0.0;
        var probed = vec3(0.0);
        for (var i = 0u; i < probes; i++) {
            let t = mix(step.t_low, step.t_high, (f32(i) + 0.5) / f32(probes));
            let found = bounded_temperature(grid, ray, accessor, step, t);
            highest = max(highest, found.highest);
            probed += blackbody_emission(volume, found.density);
        }
        let largest = step.visible * factor * max3(blackbody_emission(volume, highest));
        if largest < max(NEGLIGIBLE_FRACTION * step.shown, NEGLIGIBLE_VALUE) {
            return probed / f32(probes);
        }
    }
    var sum = vec3(0.0);
    for (var i = 0u; i < BLACKBODY_SAMPLES; i++) {
        let t = mix(step.t_low, step.t_high, (f32(i) + 0.5) / f32(BLACKBODY_SAMPLES));
        if t >= step.t_first && t < step.t_last {
            sum += blackbody_emission(volume, sample_fog(grid, ray, accessor, t).density);
        }
    }
    return sum / f32(BLACKBODY_SAMPLES);
}
#endif

// Mean emission per world unit over a step.
fn sampled_emission(
    volume: u32,
    grid: Grid,
    ray: SampledRay,
    accessor: ptr<function, Accessor>,
    step: EmissionStep,
) -> vec3<f32> {
    let emissive = volumes[volume].emissive;
#ifdef VDB_BLACKBODY
    if volumes[volume].kind == KIND_BLACKBODY {
        let luminance = sampled_blackbody(volume, grid, ray, accessor, step, max3(emissive));
        return min(emissive * luminance, vec3(MAX_EMISSION));
    }
#endif
    return min(emissive * sampled_scalar(grid, ray, accessor, step), vec3(MAX_EMISSION));
}
