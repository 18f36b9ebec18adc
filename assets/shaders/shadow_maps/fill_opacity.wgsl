// Fills the opacity maps of the fogs in one view of a light: an invocation for each ray.

#import bevy_vdb::gpu::types::Ray
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray, enter, local_cell}
#import bevy_vdb::traversal::rays::ndc_at
#import bevy_vdb::traversal::march::{begin_march, next_interval, scaled_step}
#import bevy_vdb::traversal::tree::new_accessor
#import bevy_vdb::view::scene::{fog_grid, view, volumes}
#import bevy_vdb::trace::segment::{lattice_ray, view_segment}
#import bevy_vdb::shadow_maps::opacity::{SLICES, opacity_maps}

@group(0) @binding(1) var opacity: texture_storage_2d_array<rgba16float, write>;

// Voxels between samples of fog, and the longest edge of its box, in voxels, above which steps become
// longer. All cameras share these maps, so their quality settings do not apply.
const STEP: f32 = 1.0;
const EDGE: f32 = 256.0;

// An optical depth that stops the light of every texel: more than -log(LEAST_THRESHOLD) of `cast_fog.wgsl`.
const OPAQUE: f32 = 6.25;

// The t where a ray enters and where it leaves a box of cells. They meet half-way where it passes by, so that both
// change gradually from ray to ray.
fn ends_in_box(ray: Ray, cell_min: vec3<i32>, cell_max: vec3<i32>) -> vec2<f32> {
    let inverse = 1.0 / select(ray.dir, vec3(1e-20), abs(ray.dir) < vec3(1e-20));
    let a = (vec3<f32>(cell_min - ray.cell) - ray.frac) * inverse;
    let b = (vec3<f32>(cell_max - ray.cell) + 1.0 - ray.frac) * inverse;
    let enters = min(a, b);
    let leaves = max(a, b);
    let ends = vec2(max(max(enters.x, enters.y), enters.z), min(min(leaves.x, leaves.y), leaves.z));
    return select(ends, vec2(0.5 * (ends.x + ends.y)), ends.x > ends.y);
}

@compute @workgroup_size(8, 8)
fn fill(@builtin(global_invocation_id) id: vec3<u32>) {
    let volume = view.volume_first + id.z;
    let map = opacity_maps[volume];
    if any(id.xy >= map.size) {
        return;
    }
    let to = map.origin + id.xy;
    let segment = view_segment(ndc_at(map.first_texel + vec2<f32>(id.xy) * map.spacing, view.size));
    let grid = fog_grid(volume);
    let ray = lattice_ray(segment, volume, map.t_last);
    let ends = ends_in_box(ray, grid.occupied_min, grid.occupied_max);
    let places = saturate((ends - map.t_first) / (map.t_last - map.t_first));
    // As two 16-bit floats each, because a box may be thousands of voxels long.
    let rounded = vec2(unpack2x16float(pack2x16float(places)));
    textureStore(opacity, to, 0, vec4(rounded, places - rounded));
    let slices_first = mix(map.t_first, map.t_last, places.x);
    let slice = (mix(map.t_first, map.t_last, places.y) - slices_first) / f32(SLICES);

    let mirrored = mirrored_ray(grid, ray);
    var march = begin_march(mirrored, enter(mirrored), scaled_step(grid, STEP, EDGE));
    var accessor = new_accessor(local_cell(mirrored, march.dda.rel));
    let scale = volumes[volume].density_scale * length(segment.dir);
    var reached = 0u;
    var depth = 0.0;
    var four = vec4(0.0);
    while reached < SLICES {
        var gain = 0.0;
        var t_first = FAR;
        var t_last = FAR;
        if march.dda.inside && depth < OPAQUE {
            let interval = next_interval(grid, mirrored, &march, &accessor, 1e30);
            gain = min(scale * interval.density_integral, OPAQUE);
            t_first = interval.t_first;
            t_last = 2.0 * interval.t_mean - t_first;
        }
        // The slices that end before the interval does, whose density counts as even. The last slice ends with the
        // ray.
        while reached < SLICES {
            let t = select(slices_first + f32(reached + 1u) * slice, FAR, reached + 1u == SLICES);
            if t > t_last {
                break;
            }
            let part = saturate((t - t_first) / max(t_last - t_first, 1e-30));
            four[reached & 3u] = min(depth + part * gain, OPAQUE);
            reached += 1u;
            if (reached & 3u) == 0u {
                textureStore(opacity, to, reached / 4u, four);
            }
        }
        depth += gain;
    }
}
