// Fogs and emission along a segment, without the light cache. Where several overlap, the ray is divided into
// slabs.
#define_import_path bevy_vdb::trace::slabs

#import bevy_vdb::gpu::types::KIND_FOG
#import bevy_vdb::trace::candidates::{volume_end, next_candidate, start_t}
#import bevy_vdb::traversal::fog::{optical_length, stepped_length}
#import bevy_vdb::traversal::hdda::{enter_at, mirrored_ray}
#import bevy_vdb::view::scene::{fog_grid, view, volumes}
#import bevy_vdb::trace::segment::{NONE, Segment, lattice_ray}
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::{segment_emission, is_emitter}
#endif
#ifdef VDB_EMITS
#import bevy_vdb::trace::scattering::mean_transmittance
#endif
#import bevy_vdb::trace::fog_march::{Fog, REFLECTED_STEP_FACTOR}
#import bevy_vdb::trace::scattering::OPAQUE_DEPTH
#ifdef VDB_LIT
#import bevy_vdb::view::scene::frame_random
#import bevy_vdb::trace::color::albedo_along
#import bevy_vdb::trace::fog_march::{in_scattered_at, light_around}
#import bevy_vdb::trace::lights::environment_light
#import bevy_vdb::trace::scattering::{InScattered, ScatteringSums, add_environment}
#import bevy_vdb::trace::scattering::{all_visible, pass_stretch, scattered_radiance}
#ifdef VDB_SCATTERED
#import bevy_vdb::trace::scattering::{Tint, add_tints, forward_depth, tint}
#endif
#ifndef VDB_EVEN_LIGHT
#import bevy_vdb::trace::fog_march::march_fog
#endif
#ifdef VDB_RAMPS
#import bevy_vdb::trace::ramp_light::{march_ramp, ramp_between, visible_albedo}
#endif
#endif

// Optical depth of one fog over an interval of a segment. Nothing stops the ray before `start`.
fn fog_depth(
    segment: Segment,
    volume: u32,
    start: f32,
    t_min: f32,
    t_max: f32,
    is_whole: bool,
) -> f32 {
    let scale = volumes[volume].density_scale * length(segment.dir);
    var ray = lattice_ray(segment, volume, t_max);
    ray.t_min = max(ray.t_min, t_min);
    let grid = fog_grid(volume);
    let mirrored = mirrored_ray(grid, ray);
    let safe_scale = max(scale, 1e-30);
#ifdef VDB_FOG_STEPS
    // An interval may be shorter than a step, so only whole rays are ray-marched.
    var density_integral = 0.0;
    let step = volumes[volume].fog_step;
#ifdef VDB_RAMPS
    let is_sampled = is_whole && step > 0.0 && volumes[volume].ramp == 0u;
#else
    let is_sampled = is_whole && step > 0.0;
#endif
    if is_sampled {
        density_integral = stepped_length(grid, mirrored, start, OPAQUE_DEPTH / safe_scale, step, scale);
    } else {
        density_integral =
            optical_length(grid, mirrored, enter_at(mirrored, start), OPAQUE_DEPTH / safe_scale);
    }
#else
    let density_integral =
        optical_length(grid, mirrored, enter_at(mirrored, start), OPAQUE_DEPTH / safe_scale);
#endif
    // At most 100. The limit is applied before the product, which might overflow.
    return scale * min(density_integral, 100.0 / safe_scale);
}

#ifdef VDB_LIT
// Whether two fogs have the same phase function and, unless it varies, the same albedo.
fn scatter_alike(a: u32, b: u32) -> bool {
    return volumes[a].anisotropy == volumes[b].anisotropy
        && all(volumes[a].base_color == volumes[b].base_color)
        && volumes[a].scattered == volumes[b].scattered;
}
#endif

// The media that a segment meets.
struct Met {
    count: u32,
    fog_count: u32,
    first: u32,         // candidate from which the others are found
    last: u32,          // the last one met
    t_first: f32,       // where the first one begins
    t_last: f32,        // where the last one ends
}

// Radiance and optical depth of all media up to `t_max`. A homogeneous fog with source S and optical depth τ
// emits exactly S·(1 - e^-τ). Where the lighting varies, the segment is divided into intervals; where
// several fogs overlap, into slabs. Emission E within a slab is assumed to be evenly mixed with its fogs:
// E·(1 - e^-τ)/τ of it leaves the slab.
fn trace_slabs(segment: Segment, pixel: vec2<u32>, met: Met, t_max: f32) -> Fog {
    let is_whole = met.count == 1u;
    let first = met.first;
    let end = volume_end(segment);
    var fog = Fog(vec3(0.0), 0.0, met.t_first, met.t_first, NONE);
#ifndef VDB_EVEN_LIGHT
#ifdef VDB_LIT
    if is_whole && volumes[met.last].kind == KIND_FOG {
#ifdef VDB_RAMPS
        if volumes[met.last].ramp != 0u {
            return march_ramp(segment, met.last, pixel, met.t_first, t_max);
        }
#endif
        return march_fog(segment, met.last, pixel, met.t_first, t_max);
    }
#endif
#endif
    // Within one slab, fogs are assumed to be evenly mixed and evenly lit.
    let shared_slabs = select(max(view.slabs / REFLECTED_STEP_FACTOR, 1u), view.slabs, segment.is_view);
    let slabs = select(shared_slabs, 1u, is_whole);
#ifdef VDB_LIT
    let environment = environment_light(normalize(segment.dir));
    var sums = ScatteringSums();
    var passed = all_visible();
#endif
    var t_sum = 0.0;
#ifdef VDB_EMITS
    var radiance_sum = 0.0;
    var t_radiance_sum = 0.0;
#endif
    var largest_weight = 0.0;
    for (var slab = 0u; slab < slabs && fog.optical_depth <= OPAQUE_DEPTH; slab++) {
        var t_low = mix(met.t_first, met.t_last, f32(slab) / f32(slabs));
        var t_high = mix(met.t_first, met.t_last, f32(slab + 1u) / f32(slabs));
        var start = t_low;
        if is_whole {
            t_low = segment.t_min;
            t_high = t_max;
            start = start_t(segment, met.last, pixel);
        }
        var depth = 0.0;
        var thickest = NONE;
        var thickest_depth = 0.0;
        var source = vec3(0.0);
#ifdef VDB_LIT
        var light = InScattered();
        var lit = NONE;             // the fog whose light it is
        // Sums over the fogs of the slab, weighted by their optical depths.
        var from_lights = InScattered();
        var around = ScatteringSums();
#ifdef VDB_SCATTERED
        var forward = Tint();
#endif
#endif
#ifdef VDB_EMITS
        var emission = vec3(0.0);
#endif
        for (var i = first; i < end; i = next_candidate(segment, pixel, i + 1u, t_max)) {
#ifdef VDB_EMISSION
            if is_emitter(i) && (!is_whole || i == met.last) {
                emission += segment_emission(segment, i, start, t_low, t_high);
            }
#endif
            if volumes[i].kind == KIND_FOG && (!is_whole || i == met.last) {
                var volume_depth = 0.0;
                var ramp_albedo = vec3(1.0);
#ifdef VDB_RAMPS
#ifdef VDB_LIT
                if volumes[i].ramp != 0u {
                    let own = ramp_between(segment, i, start, t_low, t_high);
                    volume_depth = min(own.optical_depth, 100.0);
                    ramp_albedo = visible_albedo(own);
                    // What leaves the fog alone; below, it is evenly mixed with the others.
                    emission += own.emitted / mean_transmittance(volume_depth);
                } else {
                    volume_depth = fog_depth(segment, i, start, t_low, t_high, is_whole);
                }
#else
                volume_depth = fog_depth(segment, i, start, t_low, t_high, is_whole);
#endif
#else
                volume_depth = fog_depth(segment, i, start, t_low, t_high, is_whole);
#endif
                if volume_depth > 0.0 {
                    thickest = select(thickest, i, volume_depth > thickest_depth);
                    thickest_depth = max(thickest_depth, volume_depth);
                    depth += volume_depth;
#ifdef VDB_LIT
                    let t_middle = 0.5 * (t_low + t_high);
                    let albedo = ramp_albedo * albedo_along(segment, t_middle, i);
                    let anisotropy = volumes[i].anisotropy;
                    // Fogs that scatter alike share their rays to the lights.
                    if lit == NONE || !scatter_alike(i, lit) {
                        let jitter = fract(0.5 + frame_random(0.41421356)) - 0.5;
                        let width = t_high - t_low;
                        light = in_scattered_at(segment, pixel, t_middle + jitter * width, width, i, albedo, passed);
                        lit = i;
                    }
                    source += volume_depth * volumes[i].emissive;
                    from_lights.whole += volume_depth * albedo * light.whole;
#ifdef VDB_SCATTERED
                    from_lights.rest += volume_depth * albedo * light.rest;
                    forward = add_tints(forward, forward_depth(volume_depth, tint(albedo), anisotropy));
#endif
                    add_environment(&around, volume_depth, albedo, light_around(environment, anisotropy), anisotropy);
#endif
                }
            }
        }
#ifdef VDB_EMITS
        let radiance_before = fog.radiance;
        fog.radiance += exp(-fog.optical_depth) * mean_transmittance(depth) * emission;
#endif
        if depth > 0.0 {
            let transmittance = exp(-fog.optical_depth);
            let weight = transmittance * (1.0 - exp(-depth));
            fog.radiance += weight * (source / max(depth, 1e-30));
#ifdef VDB_LIT
#ifdef VDB_SCATTERED
            let visible = pass_stretch(&passed, depth, forward);
            sums.radiance += visible.rest.value * from_lights.rest;
#else
            let visible = pass_stretch(&passed, depth);
#endif
            sums.radiance += visible.whole * (from_lights.whole + around.radiance);
#ifdef VDB_MULTIPLE_SCATTERING
            sums.environment += visible.whole * around.environment;
            sums.albedo += visible.whole * around.albedo;
            sums.anisotropy += visible.whole * around.anisotropy;
            sums.weight += visible.whole * around.weight;
#endif
#endif
            t_sum += weight * 0.5 * (t_low + t_high);
            fog.motion_volume = select(fog.motion_volume, thickest, weight > largest_weight);
            largest_weight = max(largest_weight, weight);
            fog.optical_depth += depth;
        }
#ifdef VDB_EMITS
        let added = dot(fog.radiance - radiance_before, vec3(1.0));
        radiance_sum += added;
        t_radiance_sum += added * 0.5 * (max(t_low, met.t_first) + min(t_high, met.t_last));
#endif
    }
#ifdef VDB_LIT
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
#endif
    fog.t_mean = t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
#ifdef VDB_EMITS
    // Emission need not attenuate anything, so weight t by radiance.
    fog.t_mean = select(fog.t_mean, t_radiance_sum / max(radiance_sum, 1e-30), radiance_sum > 1e-30);
#endif
    return fog;
}
