// Shadows that volumes cast on themselves and on each other.
#define_import_path bevy_vdb::trace::occlusion

#import bevy_vdb::gpu::types::{Grid, KIND_FOG, KIND_SMOOTH, KIND_SURFACE, NO_CASTER}
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::hdda::{Dda, enter, first_hit, mirrored_ray}
#import bevy_vdb::view::scene::{fog_grid, scene_end, view, volumes}
#import bevy_vdb::trace::scattering::OPAQUE_DEPTH
#import bevy_vdb::trace::segment::{Point, Segment, enters_page, lattice_ray}
#ifdef VDB_MANY
#import bevy_vdb::trace::bvh::next_intersected
#endif
#ifdef VDB_SMOOTH
#ifdef VDB_CLIP
#import bevy_vdb::trace::caps::first_clipped_root
#endif
#import bevy_vdb::traversal::smooth::first_root
#endif
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::is_emitter
#endif
#ifdef VDB_FOGS
#import bevy_vdb::traversal::fog::{optical_length, stepped_length}
#import bevy_vdb::traversal::march::scaled_step
#endif

// Optical depth of fog at which rays to lights end. With multiple scattering, fog that scatters forwards lets some
// light through much larger depths.
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

// Whether a volume casts shadows.
fn casts_shadow(volume: u32) -> bool {
#ifdef VDB_EMISSION
    if is_emitter(volume) {
        return false;
    }
#endif
    return (volumes[volume].flags & NO_CASTER) == 0u;
}

// Whether the ray of a segment meets the surface of a volume; `false` for fogs.
fn meets_surface(segment: Segment, volume: u32, grid: Grid, ray: MirroredRay, dda: Dda) -> bool {
    var is_met = false;
#ifdef VDB_SURFACES
    if volumes[volume].kind == KIND_SURFACE {
        is_met = first_hit(grid, ray, dda).found;
    }
#endif
#ifdef VDB_SMOOTH
    if volumes[volume].kind == KIND_SMOOTH {
#ifdef VDB_CLIP
        let begins_outside = enters_page(volume, dda.axis);
        let clipped = first_clipped_root(segment, volume, grid, ray, dda, begins_outside);
        is_met = clipped.is_cap || clipped.root.found;
#else
        is_met = first_root(grid, ray, dda, enters_page(volume, dda.axis)).found;
#endif
    }
#endif
    return is_met;
}

#ifdef VDB_FOGS
// Optical depth of a fog along a ray. Points in fog are ray-marched in steps of at least `least_step` voxels,
// because the errors of many points on a ray average out.
fn fog_depth(volume: u32, grid: Grid, ray: MirroredRay, dda: Dda, in_fog: bool, least_step: f32) -> f32 {
    let scale = max(volumes[volume].density_scale, 1e-30);
    var density_integral = 0.0;
#ifdef VDB_RAMPS
    // Samples would miss thin shells.
    let is_sampled = in_fog && volumes[volume].ramp == 0u;
#else
    let is_sampled = in_fog;
#endif
    if is_sampled {
        // Light that is stored (the light cache, scattered light) has its own setting, an error, which long steps
        // would exceed.
        let longest = select(volumes[volume].shadow_step, min(volumes[volume].shadow_step, 1.0), least_step > 0.0);
        let step = max(scaled_step(grid, longest, SHADOW_EDGE), least_step);
        density_integral = stepped_length(grid, ray, 0.0, DARK_DEPTH / scale, step, 0.0);
    } else {
        density_integral = optical_length(grid, ray, dda, DARK_DEPTH / scale);
    }
    return scale * min(density_integral, 100.0 / scale);
}
#endif

// Surfaces, fogs, and both have functions of their own, because drivers inline them: code that is not needed
// costs them minutes (`tests/gpu/size.rs`).

// Transmittance between a point and a light in a direction (world space, unit length) at a distance in world
// units.
fn transmittance(point: Point, to_light: vec3<f32>, distance: f32, in_fog: bool) -> f32 {
    let segment = Segment(point, to_light, false, 0.0);
    let range = min(distance, view.shadow_range);
    var depth = 0.0;
    var i = next_occluder(segment, view.volume_first, range);
    for (; i < scene_end() && depth < DARK_DEPTH; i = next_occluder(segment, i + 1u, range)) {
        if casts_shadow(i) {
            let grid = fog_grid(i);
            let ray = mirrored_ray(grid, lattice_ray(segment, i, range));
            let dda = enter(ray);
            if dda.inside {
                if meets_surface(segment, i, grid, ray, dda) {
                    depth = SURFACE_DEPTH;
                }
#ifdef VDB_FOGS
                if volumes[i].kind == KIND_FOG {
                    depth += fog_depth(i, grid, ray, dda, in_fog, 0.0);
                }
#endif
            }
        }
    }
    return select(exp(-min(depth, DARK_DEPTH)), 0.0, depth >= SURFACE_DEPTH);
}

#ifdef VDB_FOGS
// Optical depth of all fogs between a point in fog and a light.
fn fog_depth_to_light(point: Point, to_light: vec3<f32>, distance: f32, least_step: f32) -> f32 {
    let segment = Segment(point, to_light, false, 0.0);
    let range = min(distance, view.shadow_range);
    var depth = 0.0;
    var i = next_occluder(segment, view.volume_first, range);
    for (; i < scene_end() && depth < DARK_DEPTH; i = next_occluder(segment, i + 1u, range)) {
        if casts_shadow(i) && volumes[i].kind == KIND_FOG {
            let grid = fog_grid(i);
            let ray = mirrored_ray(grid, lattice_ray(segment, i, range));
            let dda = enter(ray);
            if dda.inside {
                depth += fog_depth(i, grid, ray, dda, true, least_step);
            }
        }
    }
    return depth;
}
#endif

// Whether a surface stands between a point and a light.
fn is_occluded(point: Point, to_light: vec3<f32>, distance: f32) -> bool {
    let segment = Segment(point, to_light, false, 0.0);
    let range = min(distance, view.shadow_range);
    var is_met = false;
#ifdef VDB_SURFACES
    let has_surfaces = true;
#else ifdef VDB_SMOOTH
    let has_surfaces = true;
#else
    let has_surfaces = false;
#endif
    if has_surfaces {
        var i = next_occluder(segment, view.volume_first, range);
        for (; i < scene_end() && !is_met; i = next_occluder(segment, i + 1u, range)) {
            if casts_shadow(i) && volumes[i].kind != KIND_FOG {
                let grid = fog_grid(i);
                let ray = mirrored_ray(grid, lattice_ray(segment, i, range));
                let dda = enter(ray);
                is_met = dda.inside && meets_surface(segment, i, grid, ray, dda);
            }
        }
    }
    return is_met;
}
