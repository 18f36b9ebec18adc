// Shadows that volumes throw, on themselves and on each other.
#define_import_path bevy_vdb::trace::occlusion

#import bevy_vdb::gpu::types::{KIND_FOG, KIND_SMOOTH, KIND_SURFACE, NO_CASTER}
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::hdda::{mirrored_ray, enter, first_hit}
#import bevy_vdb::view::scene::{scene_end, view, volumes}
#import bevy_vdb::trace::segment::{Point, Segment, lattice_ray}
#ifdef VDB_MANY
#import bevy_vdb::trace::bvh::next_intersected
#endif
#ifdef VDB_SMOOTH
#import bevy_vdb::traversal::smooth::first_root
#endif
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::is_emitter
#endif
#ifdef VDB_FOGS
#import bevy_vdb::traversal::fog::{optical_length, stepped_length}
#import bevy_vdb::traversal::march::scaled_step
#endif

// Optical depth through which no light is seen: e^-16 is below a 16-bit float's step beside 1. Light that is
// scattered again has an eighth of it to pass, at least.
#ifdef VDB_MULTIPLE_SCATTERING
const OPAQUE_DEPTH: f32 = 80.0;
#else
const OPAQUE_DEPTH: f32 = 16.0;
#endif

// Voxels along the longest edge of a fog's box from which on there are more of them between the densities
// that a ray from a place in fog sums up.
const SHADOW_EDGE: f32 = 256.0;

// The first volume from `i` on that a segment may meet before `distance`.
fn next_occluder(segment: Segment, i: u32, distance: f32) -> u32 {
#ifdef VDB_MANY
    return next_intersected(segment, i, distance);
#else
    return i;
#endif
}

// The part of the light from a direction (world space, unit) that comes to a place from a distance of
// so many world units. A place in fog is one of many along a ray, whose errors even out.
fn transmittance(point: Point, to_light: vec3<f32>, distance: f32, in_fog: bool) -> f32 {
    let segment = Segment(point, to_light, false, 0.0);
    let range = min(distance, view.shadow_range);
    var depth = 0.0;
    var i = next_occluder(segment, view.volume_first, range);
    for (; i < scene_end() && depth < OPAQUE_DEPTH; i = next_occluder(segment, i + 1u, range)) {
        if (volumes[i].flags & NO_CASTER) != 0u {
            continue;
        }
#ifdef VDB_EMISSION
        if is_emitter(i) {
            continue;
        }
#endif
        let grid = grids[volumes[i].grid];
        let mirrored = mirrored_ray(grid, lattice_ray(segment, i, range));
        let dda = enter(mirrored);
        if !dda.inside {
            continue;
        }
#ifdef VDB_SURFACES
        if volumes[i].kind == KIND_SURFACE && first_hit(grid, mirrored, dda).found {
            depth = OPAQUE_DEPTH;
        }
#endif
#ifdef VDB_SMOOTH
        if volumes[i].kind == KIND_SMOOTH && first_root(grid, mirrored, dda).found {
            depth = OPAQUE_DEPTH;
        }
#endif
#ifdef VDB_FOGS
        if volumes[i].kind == KIND_FOG {
            let scale = max(volumes[i].density_scale, 1e-30);
            var density_integral = 0.0;
            if in_fog {
                let step = scaled_step(grid, volumes[i].shadow_step, SHADOW_EDGE);
                density_integral = stepped_length(grid, mirrored, 0.0, OPAQUE_DEPTH / scale, step, 0.0);
            } else {
                density_integral = optical_length(grid, mirrored, dda, OPAQUE_DEPTH / scale);
            }
            depth += scale * min(density_integral, 100.0 / scale);
        }
#endif
    }
    return select(exp(-depth), 0.0, depth >= OPAQUE_DEPTH);
}
