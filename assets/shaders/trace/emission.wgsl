// Light that grids send of their own, seen along a segment.
#define_import_path bevy_vdb::trace::emission

#import bevy_vdb::gpu::types::{Grid, KIND_BLACKBODY, KIND_EMISSION}
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::fog::optical_length
#import bevy_vdb::traversal::hdda::{FAR, course_of, enter_at}
#import bevy_vdb::view::scene::volumes
#import bevy_vdb::trace::segment::{Segment, ray_of}
#ifdef VDB_BLACKBODY
#import bevy_vdb::traversal::exact::Course
#import bevy_vdb::traversal::rebase::{Anchor, anchor_exit, anchored}
#import bevy_vdb::traversal::fog::ANCHOR_RANGE
#import bevy_vdb::traversal::hdda::{Walk, advance, confirm, local_cell, planes_behind, unturned}
#import bevy_vdb::traversal::samples::{FogCell, fog_cell, tile_value, trilinear}
#import bevy_vdb::traversal::tree::{Span, empty_cell, locate, nowhere, span_constant, span_occupied}

// By even steps of the logarithm of the temperature: the colour for a luminance of 1, and the logarithm of
// the luminance. Twin: `BlackbodyTable` in `crates/vdb_core/src/blackbody.rs`.
@group(2) @binding(11) var blackbody_colors: texture_2d<f32>;

// Kelvin of its first entry, and the logarithm of how much hotter the last one is.
const COLDEST: f32 = 500.0;
const LOG_RANGE: f32 = 4.382026634673881;   // ln 80

// The luminance of a black body, cd/m².
fn blackbody(kelvin: f32) -> vec3<f32> {
    let last = textureDimensions(blackbody_colors).x - 1u;
    let steps = clamp(log(max(kelvin, COLDEST) / COLDEST) * (f32(last) / LOG_RANGE), 0.0, f32(last));
    let first = min(u32(steps), last - 1u);
    let low = textureLoad(blackbody_colors, vec2(first, 0u), 0);
    let high = textureLoad(blackbody_colors, vec2(first + 1u, 0u), 0);
    let entry = mix(low, high, steps - f32(first));
    // Cool ones have less blue than there can be.
    return select(vec3(0.0), max(entry.rgb, vec3(0.0)) * exp(entry.w), kelvin >= COLDEST);
}

fn heat(volume: u32, value: f32) -> vec3<f32> {
    let kelvin = min(volumes[volume].temperature_scale * value, 1e9) + volumes[volume].temperature_offset;
    return select(vec3(0.0), blackbody(kelvin), value > 0.0);
}

// Gauss and Legendre's four points on an interval of length 1: away from its middle, and their weights.
const INNER: f32 = 0.16999052;
const OUTER: f32 = 0.43056816;
const INNER_WEIGHT: f32 = 0.32607258;
const OUTER_WEIGHT: f32 = 0.17392742;

// A part of a course within a cell.
struct Chord {
    cell: FogCell,
    first: vec3<f32>,   // in the cell, on the course's axes
    last: vec3<f32>,
}

fn heat_on(volume: u32, course: Course, chord: Chord, share: f32) -> vec3<f32> {
    let at = unturned(course, saturate(mix(chord.first, chord.last, share)));
    return heat(volume, chord.cell.offset + chord.cell.scale * trilinear(chord.cell.corners, at));
}

// The mean luminance of what glows between two parameters from the anchor on, within the cube of a span. The
// light of a black body goes up by far more than its temperature: of two points, as a density has them,
// a cell from cold to hot would get three quarters of its light wrong, of four, less than a hundredth.
fn mean_heat(
    volume: u32,
    grid: Grid,
    course: Course,
    near: Anchor,
    walk: Walk,
    span: Span,
    t_from: f32,
    t_to: f32,
) -> vec3<f32> {
    if span_constant(span) {
        return heat(volume, tile_value(grid, span.word));
    }
    let origin = near.frac - vec3<f32>(walk.rel - near.cell);
    let chord = Chord(
        fog_cell(grid, span, local_cell(course, walk.rel)),
        origin + t_from * course.speed,
        origin + t_to * course.speed,
    );
    let inner = heat_on(volume, course, chord, 0.5 - INNER) + heat_on(volume, course, chord, 0.5 + INNER);
    let outer = heat_on(volume, course, chord, 0.5 - OUTER) + heat_on(volume, course, chord, 0.5 + OUTER);
    return INNER_WEIGHT * inner + OUTER_WEIGHT * outer;
}

// ∫ B dt along a course, cell by cell as `optical_length` walks.
fn heat_length(volume: u32, grid: Grid, course: Course, enters: Walk) -> vec3<f32> {
    var walk = enters;
    var place = nowhere(local_cell(course, walk.rel));
    var near = Anchor(vec3(0u), vec3(0.0), 0.0, FAR);
    var in_run = false;
    var t_from = 0.0;
    var sum = vec3(0.0);
    while walk.inside {
        let here = walk;
        let span = locate(grid, local_cell(course, here.rel), course.octant, &place);
        if !span_occupied(span) {
            walk = advance(course, here, span);
            in_run = false;
            continue;
        }
        if !in_run || any(here.rel - near.cell > vec3(ANCHOR_RANGE)) {
            let own = confirm(course, here);
            if !own.inside {
                walk = advance(course, here, empty_cell());
                continue;
            }
            near = anchored(course, own.rel, own.axis, own.t);
            t_from = 0.0;
        }
        walk = advance(course, here, span);
        let plane = planes_behind(course, here.rel, span);
        let t_to = max(anchor_exit(near, course, plane, walk.axis), t_from);
        let t_end = min(t_to, near.end);
        sum += (t_end - t_from) * mean_heat(volume, grid, course, near, here, span, t_from, t_end);
        t_from = t_to;
        in_run = !span_constant(span);
    }
    return sum;
}
#endif

// Whether a volume is a grid that shines.
fn is_emitter(volume: u32) -> bool {
    return volumes[volume].kind == KIND_EMISSION || volumes[volume].kind == KIND_BLACKBODY;
}

// No light is more than this: with exposure it is within f32.
const MOST_LIGHT: f32 = 1e20;

// ∫ ε ds over a part of a segment, which nothing shines on before `start`: cd/m².
fn emitted(segment: Segment, volume: u32, start: f32, t_min: f32, t_max: f32) -> vec3<f32> {
    var ray = ray_of(segment, volume, t_max);
    ray.t_min = t_min;
    let grid = grids[volumes[volume].grid];
    let course = course_of(grid, ray);
    let enters = enter_at(course, start);
    let unit = length(segment.dir);
#ifdef VDB_BLACKBODY
    if volumes[volume].kind == KIND_BLACKBODY {
        let light = min(heat_length(volume, grid, course, enters), vec3(MOST_LIGHT));
        return min(volumes[volume].emissive * unit * light, vec3(MOST_LIGHT));
    }
#endif
    let values = min(optical_length(grid, course, enters, FAR), MOST_LIGHT);
    return min(volumes[volume].emissive * unit * values, vec3(MOST_LIGHT));
}

// The part of light sent evenly within fog of an optical depth that leaves it: (1 - e^-τ) / τ.
fn escaping(depth: f32) -> f32 {
    let thick = (1.0 - exp(-depth)) / max(depth, 1e-2);
    return select(thick, 1.0 - depth * (0.5 - depth / 6.0), depth < 1e-2);
}
