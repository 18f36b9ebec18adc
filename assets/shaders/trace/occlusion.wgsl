// Shadows that volumes cast on themselves and on each other.
#define_import_path bevy_vdb::trace::occlusion

#import bevy_vdb::gpu::types::{KIND_FOG, KIND_SMOOTH, KIND_SURFACE, NO_CASTER}
#import bevy_vdb::traversal::hdda::{mirrored_ray, enter, first_hit}
#import bevy_vdb::view::scene::{fog_grid, scene_end, view, volumes}
#import bevy_vdb::trace::scattering::OPAQUE_DEPTH
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

// Optical depth of fog at which rays to lights end. With multiple scattering, the last octave sees at most a
// quarter of the optical depth, or less if fog scatters forwards.
#ifdef VDB_MULTIPLE_SCATTERING
const DARK_DEPTH: f32 = 5.0 * OPAQUE_DEPTH;
#else
const DARK_DEPTH: f32 = OPAQUE_DEPTH;
#endif
// Optical depth of a surface, which no fogs together reach.
const SURFACE_DEPTH: f32 = 1000.0;

// Above this many voxels along the longest edge of a fog's box, steps towards lights become longer in
// proportion.
const SHADOW_EDGE: f32 = 256.0;

// The first volume from index `i` that a segment may hit before `distance`.
fn next_occluder(segment: Segment, i: u32, distance: f32) -> u32 {
#ifdef VDB_MANY
    return next_intersected(segment, i, distance);
#else
    return i;
#endif
}

const SURFACES: u32 = 1u;
const FOGS: u32 = 2u;

// Optical depth between a point and a light in a direction (world space, unit length) at a distance in world
// units, of surfaces, of fogs, or of both; SURFACE_DEPTH behind a surface. Points in fog are
// ray-marched in steps of at least `least_step` voxels, because the errors of many points on a ray average
// out.
fn depth_to_light(
    point: Point,
    to_light: vec3<f32>,
    distance: f32,
    in_fog: bool,
    kinds: u32,
    least_step: f32,
) -> f32 {
    let segment = Segment(point, to_light, false, 0.0);
    let range = min(distance, view.shadow_range);
    var depth = 0.0;
    var i = next_occluder(segment, view.volume_first, range);
    for (; i < scene_end() && depth < DARK_DEPTH; i = next_occluder(segment, i + 1u, range)) {
        if (volumes[i].flags & NO_CASTER) != 0u {
            continue;
        }
#ifdef VDB_EMISSION
        if is_emitter(i) {
            continue;
        }
#endif
        let kind = select(SURFACES, FOGS, volumes[i].kind == KIND_FOG);
        if (kinds & kind) == 0u {
            continue;
        }
        let grid = fog_grid(i);
        let mirrored = mirrored_ray(grid, lattice_ray(segment, i, range));
        let dda = enter(mirrored);
        if !dda.inside {
            continue;
        }
#ifdef VDB_SURFACES
        if volumes[i].kind == KIND_SURFACE && first_hit(grid, mirrored, dda).found {
            depth = SURFACE_DEPTH;
        }
#endif
#ifdef VDB_SMOOTH
        if volumes[i].kind == KIND_SMOOTH && first_root(grid, mirrored, dda).found {
            depth = SURFACE_DEPTH;
        }
#endif
#ifdef VDB_FOGS
        if volumes[i].kind == KIND_FOG {
            let scale = max(volumes[i].density_scale, 1e-30);
            var density_integral = 0.0;
#ifdef VDB_RAMPS
            // Samples would miss thin shells.
            let is_sampled = in_fog && volumes[i].ramp == 0u;
#else
            let is_sampled = in_fog;
#endif
            if is_sampled {
                let step = max(scaled_step(grid, volumes[i].shadow_step, SHADOW_EDGE), least_step);
                density_integral = stepped_length(grid, mirrored, 0.0, DARK_DEPTH / scale, step, 0.0);
            } else {
                density_integral = optical_length(grid, mirrored, dda, DARK_DEPTH / scale);
            }
            depth += scale * min(density_integral, 100.0 / scale);
        }
#endif
    }
    return depth;
}

// Transmittance between a point and a light.
fn transmittance(point: Point, to_light: vec3<f32>, distance: f32, in_fog: bool) -> f32 {
    let depth = depth_to_light(point, to_light, distance, in_fog, SURFACES | FOGS, 0.0);
    return select(exp(-min(depth, DARK_DEPTH)), 0.0, depth >= SURFACE_DEPTH);
}

// Optical depth of all fogs between a point in fog and a light.
fn fog_depth_to_light(point: Point, to_light: vec3<f32>, distance: f32, least_step: f32) -> f32 {
    return depth_to_light(point, to_light, distance, true, FOGS, least_step);
}

// Whether a surface stands between a point and a light.
fn is_occluded(point: Point, to_light: vec3<f32>, distance: f32) -> bool {
#ifdef VDB_SURFACES
    return depth_to_light(point, to_light, distance, true, SURFACES, 0.0) >= SURFACE_DEPTH;
#else ifdef VDB_SMOOTH
    return depth_to_light(point, to_light, distance, true, SURFACES, 0.0) >= SURFACE_DEPTH;
#else
    return false;
#endif
}
