// One thread a pixel: the nearest surface of all volumes, then all fogs in front of it.
// Writes radiance times exposure, premultiplied with coverage, and a depth for the composite.

#import bevy_vdb::types::{View, Volume, KIND_FOG, KIND_SMOOTH, KIND_SURFACE}
#import bevy_vdb::bindings::grids
#import bevy_vdb::rays::{ndc_of, ray_through}
#import bevy_vdb::exact::Course
#import bevy_vdb::hdda::{FAR, Hit, course_of, enter, enter_at, first_hit, plane_t}
#import bevy_vdb::lights::{isotropic, lambert}
#import bevy_vdb::surface::surface_normal
#ifdef SMOOTH
#import bevy_vdb::smooth::first_root
#endif
#ifdef FOGS
#import bevy_vdb::fog::optical_length
#endif
#ifdef COUNT_STEPS
#import bevy_vdb::hdda::steps
#endif

@group(0) @binding(4) var<uniform> view: View;
@group(0) @binding(5) var<storage, read> volumes: array<Volume>;
#ifdef MULTISAMPLED
@group(0) @binding(6) var scene_depth: texture_depth_multisampled_2d;
#else
@group(0) @binding(6) var scene_depth: texture_depth_2d;
#endif
@group(0) @binding(7) var out_color: texture_storage_2d<rgba16float, write>;
// A surface: its depth, 0 to 1. Fog alone: -1 - the depth where it begins. Nothing: -3.
@group(0) @binding(8) var out_depth: texture_storage_2d<r32float, write>;

const NOTHING: f32 = -3.0;

// Optical depth from which on nothing behind is visible: e^-16 is below a 16-bit float's step
// beside 1, by a factor of 4,000.
const OPAQUE: f32 = 16.0;

// The part of a ray that overlapping fogs share is cut into this many slabs; within one, they are
// taken as evenly mixed.
const OVERLAP_SLABS: u32 = 32u;

// What a 16-bit float can hold.
const MAX_COLOR: f32 = 65000.0;

// The t of whatever opaque meshes show at a pixel; with several samples the farthest, because the
// composite tests each sample's own depth again.
fn scene_t(pixel: vec2<u32>) -> f32 {
    let at = pixel + view.origin;
#ifdef MULTISAMPLED
    var depth = 1.0;
    for (var i = 0u; i < textureNumSamples(scene_depth); i++) {
        depth = min(depth, textureLoad(scene_depth, at, i32(i)));
    }
#else
    let depth = textureLoad(scene_depth, at, 0);
#endif
    let m = view.t_from_depth;
    let w = m.z * depth + m.w;
    return select(-(m.x * depth + m.y) / w, FAR, abs(w) < 1e-30);
}

#ifdef BEAMS
// For each volume of the view and each tile of 8×8 pixels, the t before which nothing can stop a ray; FAR
// where nothing can at all.
@group(0) @binding(9) var<storage, read> starts: array<f32>;
#endif

// The t before which nothing of a volume can stop the pixel's ray.
fn start_of(volume: u32, pixel: vec2<u32>) -> f32 {
#ifdef BEAMS
    let tiles = (view.size + 7u) / 8u;
    let row = (volume - view.volume_first) * tiles.y + pixel.y / 8u;
    return starts[row * tiles.x + pixel.x / 8u];
#else
    return view.t_near;
#endif
}

// The course of the view's ray through a volume.
fn volume_course(volume: Volume, ndc: vec2<f32>, t_min: f32, t_max: f32) -> Course {
    return course_of(grids[volume.grid], ray_through(volume.rays, ndc, t_min, t_max));
}

fn volume_end() -> u32 {
    return view.volume_first + view.volume_count;
}

fn depth_at(t: f32) -> f32 {
    let m = view.depth_from_t;
    return saturate((m.x * t + m.y) / (m.z * t + m.w));
}

#ifdef FOGS
struct Fog {
    radiance: vec3<f32>,
    optical_depth: f32,
    t_first: f32,
}

// Optical depth of one fog over a part of the ray, which nothing stops before `start`. `length` is world
// units per unit of t.
fn optical_depth(volume: Volume, ndc: vec2<f32>, start: f32, t_min: f32, t_max: f32, length: f32) -> f32 {
    let scale = volume.density_scale * length;
    let course = volume_course(volume, ndc, t_min, t_max);
    let thin = max(scale, 1e-30);
    let fog = optical_length(grids[volume.grid], course, enter_at(course, start), OPAQUE / thin);
    // At most 100, and not by way of a product that f32 does not hold.
    return scale * min(fog, 100.0 / thin);
}

// What a fog sends on per unit of optical depth.
fn source(volume: Volume) -> vec3<f32> {
    return volume.emissive + isotropic(view, volume.base_color);
}

// All fogs in front of `t_max`. Radiance of one fog with an even source S and optical depth τ is
// S·(1 - e^-τ), exactly; where several overlap, the shared part is cut into slabs.
fn trace_fogs(pixel: vec2<u32>, ndc: vec2<f32>, t_max: f32, length: f32) -> Fog {
    var met = 0u;
    var last_met = 0u;
    var t_first = FAR;
    var t_last = view.t_near;
    for (var i = view.volume_first; i < volume_end(); i++) {
        if volumes[i].kind != KIND_FOG || start_of(i, pixel) == FAR {
            continue;
        }
        let course = volume_course(volumes[i], ndc, view.t_near, t_max);
        let walk = enter(course);
        if walk.inside && walk.t < t_max {
            met += 1u;
            last_met = i;
            let exits = plane_t(course, course.last + 1u);
            t_first = min(t_first, walk.t);
            t_last = max(t_last, min(min(min(exits.x, exits.y), exits.z), t_max));
        }
    }
    var fog = Fog(vec3(0.0), 0.0, t_first);
    if met == 1u {
        let start = start_of(last_met, pixel);
        fog.optical_depth =
            optical_depth(volumes[last_met], ndc, start, view.t_near, t_max, length);
        fog.radiance = source(volumes[last_met]) * (1.0 - exp(-fog.optical_depth));
    } else if met > 1u {
        for (var slab = 0u; slab < OVERLAP_SLABS; slab++) {
            let t_low = mix(t_first, t_last, f32(slab) / f32(OVERLAP_SLABS));
            let t_high = mix(t_first, t_last, f32(slab + 1u) / f32(OVERLAP_SLABS));
            var depth = 0.0;
            var weighted = vec3(0.0);
            for (var i = view.volume_first; i < volume_end(); i++) {
                if volumes[i].kind == KIND_FOG {
                    let part = optical_depth(volumes[i], ndc, t_low, t_low, t_high, length);
                    depth += part;
                    weighted += part * source(volumes[i]);
                }
            }
            let mean_source = weighted / max(depth, 1e-30);
            fog.radiance += exp(-fog.optical_depth) * (1.0 - exp(-depth)) * mean_source;
            fog.optical_depth += depth;
            if fog.optical_depth > OPAQUE {
                break;
            }
        }
    }
    return fog;
}
#endif

#ifdef COUNT_STEPS
// Light blue to red.
fn heat(x: f32) -> vec3<f32> {
    return mix(vec3(0.55, 0.8, 1.0), vec3(1.0, 0.0, 0.0), saturate(x));
}
#endif

@compute @workgroup_size(8, 8, 1)
fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= view.size) {
        return;
    }
    let ndc = ndc_of(pixel, view.size);
    let world_dir = view.dir + ndc.x * view.dir_x + ndc.y * view.dir_y;

    var t_max = min(scene_t(pixel), view.t_far);
    var color = vec3(0.0);
    var coverage = 0.0;
    var depth = NOTHING;

    var nearest = volume_end();
    var normal = vec3(0.0);
#ifdef SURFACES
    var hit: Hit;
    for (var i = view.volume_first; i < volume_end(); i++) {
        let start = start_of(i, pixel);
        if volumes[i].kind == KIND_SURFACE && start < t_max {
            let course = volume_course(volumes[i], ndc, view.t_near, t_max);
            let found = first_hit(grids[volumes[i].grid], course, enter_at(course, start));
            if found.found {
                nearest = i;
                hit = found;
                t_max = found.t;
            }
        }
    }
    if nearest < volume_end() {
        let volume = volumes[nearest];
        let course = volume_course(volume, ndc, view.t_near, t_max);
        // Of a voxel, the face.
        normal = surface_normal(volume, course, hit.axis, vec3(0.0));
    }
#endif
#ifdef SMOOTH
    for (var i = view.volume_first; i < volume_end(); i++) {
        let volume = volumes[i];
        let start = start_of(i, pixel);
        if volume.kind == KIND_SMOOTH && start < t_max {
            let course = volume_course(volume, ndc, view.t_near, t_max);
            let enters = enter_at(course, start);
            let found = first_root(grids[volume.grid], course, enters);
            if found.found {
                nearest = i;
                t_max = found.t;
                normal = surface_normal(volume, course, found.axis, found.gradient);
            }
        }
    }
#endif
    if nearest < volume_end() {
        let volume = volumes[nearest];
        depth = depth_at(t_max);
        coverage = 1.0;
#ifdef SHOW_NORMALS
        color = 0.5 + 0.5 * normal;
#else ifdef SHOW_DEPTH
        color = vec3(depth);
#else
        color = view.exposure * (volume.emissive + lambert(view, volume.base_color, normal));
#endif
    }

#ifdef FOGS
    let fog = trace_fogs(pixel, ndc, t_max, length(world_dir));
    if fog.optical_depth > 0.0 {
        let transmittance = exp(-fog.optical_depth);
        color = view.exposure * fog.radiance + transmittance * color;
        coverage = 1.0 - transmittance * (1.0 - coverage);
        depth = select(depth, -1.0 - depth_at(fog.t_first), depth < 0.0);
    }
#endif

#ifdef COUNT_STEPS
    if steps > 0u {
        color = heat(f32(steps) / view.steps_scale);
        coverage = 1.0;
        depth = select(depth, -1.0 - depth_at(view.t_near), depth < 0.0);
    }
#endif
    textureStore(out_color, pixel, vec4(min(color, vec3(MAX_COLOR)), coverage));
    textureStore(out_depth, pixel, vec4(depth, 0.0, 0.0, 0.0));
}
