// Reflections of opaque meshes, as far as the picture of the meshes shows them: rays are followed across it.
#define_import_path bevy_vdb::trace::mesh_reflections

#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_vdb::view::picture::{depth_of_meshes, t_of_depth}
#import bevy_vdb::view::scene::view

// The opaque meshes in the camera's target, in its linear colours: radiance times exposure.
@group(3) @binding(0) var mesh_picture: texture_2d<f32>;

// What a reflected ray meets.
struct ReflectedMesh {
    share: f32,             // how much of the mesh is shown, 0 to 1; the rest is what there is without it
    t: f32,                 // world units along the ray
    radiance: vec3<f32>,
}

// Rays are compared with the depth buffer once per pixel, but at most this often.
const MAX_SAMPLES: f32 = 64.0;
// Then the place where they pass behind a mesh is bisected.
const BISECTIONS: u32 = 6u;
// How far a ray may be behind a mesh there, relative to its distance from the eye. If it is farther, it has
// passed behind an edge of the mesh, of whose other side nothing is known.
const BEHIND: f32 = 0.01;
// Within this distance of the picture's border, in NDC, the mesh fades.
const BORDER: f32 = 0.2;
// The longest ray, relative to the distance from the eye.
const LONGEST: f32 = 1e5;

fn pixel_of_ndc(ndc: vec2<f32>) -> vec2<u32> {
    let uv = saturate(vec2(0.5, -0.5) * ndc + 0.5);
    return view.origin + min(vec2<u32>(uv * vec2<f32>(view.picture)), view.picture - 1u);
}

// How far a point in NDC is behind the meshes along the view ray through it, and its own t.
#ifdef MULTISAMPLED
fn behind_meshes(scene_depth: texture_depth_multisampled_2d, at: vec3<f32>) -> vec2<f32> {
#else
fn behind_meshes(scene_depth: texture_depth_2d, at: vec3<f32>) -> vec2<f32> {
#endif
    let depth = depth_of_meshes(scene_depth, pixel_of_ndc(at.xy));
    let t = t_of_depth(view.t_from_depth, at.z);
    return vec2(t - t_of_depth(view.t_from_depth, depth), t);
}

// The mesh that a ray from a point meets (world space, `dir` of unit length) within a range. `random`, from 0 to
// 1, is where within its stretches the ray is sampled.
fn reflected_mesh(
#ifdef MULTISAMPLED
    scene_depth: texture_depth_multisampled_2d,
#else
    scene_depth: texture_depth_2d,
#endif
    origin: vec3<f32>,
    dir: vec3<f32>,
    range: f32,
    random: f32,
) -> ReflectedMesh {
    let none = ReflectedMesh(0.0, 0.0, vec3(0.0));
    let clip = bevy::view.clip_from_world * vec4(origin, 1.0);
    let along = bevy::view.clip_from_world * vec4(dir, 0.0);
    var length = min(range, LONGEST * max(abs(clip.w), 1e-20));
    // Towards the eye, until shortly before it.
    if along.w < 0.0 {
        length = min(length, 0.98 * clip.w / -along.w);
    }
    let end = clip + length * along;
    if clip.w <= 0.0 || end.w <= 0.0 {
        return none;
    }
    // Straight lines in space are straight in NDC, and so is the depth along them.
    let first = clip.xyz / clip.w;
    let whole = end.xyz / end.w - first;
    // Until the ray leaves the picture, or the range of depths.
    let exits = (sign(whole) - first) / whole;
    let exit_depth = select(-first.z, 1.0 - first.z, whole.z > 0.0) / whole.z;
    let leaves = vec3(select(vec2(1.0), exits.xy, whole.xy != vec2(0.0)), select(1.0, exit_depth, whole.z != 0.0));
    let part = min(min(min(leaves.x, leaves.y), leaves.z), 1.0);
    if !(part > 0.0) || any(abs(first.xy) > vec2(1.0)) {
        return none;
    }
    let pixels = 0.5 * part * abs(whole.xy) * vec2<f32>(view.picture);
    let samples = clamp(ceil(max(pixels.x, pixels.y)), 1.0, MAX_SAMPLES);
    var low = 0.0;
    var high = 0.0;
    var was_before = true;
    var is_found = false;
    for (var i = 0.0; i < samples && !is_found; i += 1.0) {
        high = part * min((i + 0.5 + random) / samples, 1.0);
        let is_behind = behind_meshes(scene_depth, first + high * whole).x > 0.0;
        if is_behind && was_before {
            var middle_high = high;
            for (var k = 0u; k < BISECTIONS; k++) {
                let middle = 0.5 * (low + middle_high);
                if behind_meshes(scene_depth, first + middle * whole).x > 0.0 {
                    middle_high = middle;
                } else {
                    low = middle;
                }
            }
            let last = behind_meshes(scene_depth, first + middle_high * whole);
            let before = t_of_depth(view.t_from_depth, first.z + low * whole.z);
            is_found = last.x <= BEHIND * last.y + 2.0 * abs(last.y - before);
            if is_found {
                high = middle_high;
            }
        }
        was_before = !is_behind;
        low = select(high, low, is_found);
    }
    if !is_found {
        return none;
    }
    let at = first + high * whole;
    let border = saturate((1.0 - max(abs(at.x), abs(at.y))) / BORDER);
    let radiance = textureLoad(mesh_picture, pixel_of_ndc(at.xy), 0).rgb / max(view.exposure, 1e-30);
    // Where the ray is there: NDC are not linear in space.
    let t = length * high * clip.w / mix(end.w, clip.w, high);
    return ReflectedMesh(border * border * (3.0 - 2.0 * border), t, radiance);
}
