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
#import bevy_vdb::trace::lights::{EnvironmentLight, environment_light}
#import bevy_vdb::trace::scattering::{InScattered, ScatteringSums, Visible, add_environment}
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

// Optical depth of one fog over a slab.
fn fog_depth(segment: Segment, volume: u32, slab: Slab) -> f32 {
    let scale = volumes[volume].density_scale * length(segment.dir);
    var ray = lattice_ray(segment, volume, slab.t_high);
    ray.t_min = max(ray.t_min, slab.t_low);
    let grid = fog_grid(volume);
    let mirrored = mirrored_ray(grid, ray);
    let safe_scale = max(scale, 1e-30);
#ifdef VDB_FOG_STEPS
    // An interval may be shorter than a step, so only whole rays are ray-marched.
    var density_integral = 0.0;
    let step = volumes[volume].fog_step;
#ifdef VDB_RAMPS
    let is_sampled = slab.is_whole && step > 0.0 && volumes[volume].ramp == 0u;
#else
    let is_sampled = slab.is_whole && step > 0.0;
#endif
    if is_sampled {
        density_integral = stepped_length(grid, mirrored, slab.start, OPAQUE_DEPTH / safe_scale, step, scale);
    } else {
        density_integral =
            optical_length(grid, mirrored, enter_at(mirrored, slab.start), OPAQUE_DEPTH / safe_scale);
    }
#else
    let density_integral =
        optical_length(grid, mirrored, enter_at(mirrored, slab.start), OPAQUE_DEPTH / safe_scale);
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

// A part of a segment within which fogs are assumed to be evenly mixed and evenly lit.
struct Slab {
    start: f32,         // there is nothing before this t
    t_low: f32,
    t_high: f32,
    is_whole: bool,     // whether it is all of a single medium
}

// Sums over the media of a slab.
struct SlabSums {
    depth: f32,
    thickest: u32,              // the fog with the largest optical depth, and that depth
    thickest_depth: f32,
#ifdef VDB_EMITS
    emission: vec3<f32>,
#endif
#ifdef VDB_LIT
    source: vec3<f32>,          // weighted by optical depth, as all sums of light
    light: InScattered,
    lit: u32,                   // the fog whose light it is
    from_lights: InScattered,
    around: ScatteringSums,
#ifdef VDB_SCATTERED
    forward: Tint,
#endif
#endif
}

// The slab with this index, of `count`.
fn slab_at(segment: Segment, pixel: vec2<u32>, met: Met, index: u32, count: u32, t_max: f32) -> Slab {
    if met.count == 1u {
        return Slab(start_t(segment, met.last, pixel), segment.t_min, t_max, true);
    }
    let t_low = mix(met.t_first, met.t_last, f32(index) / f32(count));
    let t_high = mix(met.t_first, met.t_last, f32(index + 1u) / f32(count));
    return Slab(t_low, t_low, t_high, false);
}

#ifdef VDB_LIT
// Adds a fog to the sums of a slab. `passed` is what the slabs before it let through.
fn add_fog(
    sums: ptr<function, SlabSums>,
    segment: Segment,
    pixel: vec2<u32>,
    volume: u32,
    slab: Slab,
    passed: Visible,
    environment: EnvironmentLight,
) {
    var depth = 0.0;
    var ramp_albedo = vec3(1.0);
#ifdef VDB_RAMPS
    if volumes[volume].ramp != 0u {
        let own = ramp_between(segment, volume, slab.start, slab.t_low, slab.t_high);
        depth = min(own.optical_depth, 100.0);
        ramp_albedo = visible_albedo(own);
        // What leaves the fog alone; it is then evenly mixed with the others.
        (*sums).emission += own.emitted / mean_transmittance(depth);
    } else {
        depth = fog_depth(segment, volume, slab);
    }
#else
    depth = fog_depth(segment, volume, slab);
#endif
    if depth > 0.0 {
        add_depth(sums, volume, depth);
        let t_middle = 0.5 * (slab.t_low + slab.t_high);
        let albedo = ramp_albedo * albedo_along(segment, t_middle, volume);
        let anisotropy = volumes[volume].anisotropy;
        // Fogs that scatter alike share their rays to the lights.
        if (*sums).lit == NONE || !scatter_alike(volume, (*sums).lit) {
            let jitter = fract(0.5 + frame_random(0.41421356)) - 0.5;
            let width = slab.t_high - slab.t_low;
            (*sums).light =
                in_scattered_at(segment, pixel, t_middle + jitter * width, width, volume, albedo, passed);
            (*sums).lit = volume;
        }
        (*sums).source += depth * volumes[volume].emissive;
        (*sums).from_lights.whole += depth * albedo * (*sums).light.whole;
#ifdef VDB_SCATTERED
        (*sums).from_lights.rest += depth * albedo * (*sums).light.rest;
        (*sums).forward = add_tints((*sums).forward, forward_depth(depth, tint(albedo), anisotropy));
#endif
        var around = (*sums).around;
        add_environment(&around, depth, albedo, light_around(environment, anisotropy), anisotropy);
        (*sums).around = around;
    }
}
#else
fn add_fog(sums: ptr<function, SlabSums>, segment: Segment, volume: u32, slab: Slab) {
    let depth = fog_depth(segment, volume, slab);
    if depth > 0.0 {
        add_depth(sums, volume, depth);
    }
}
#endif

// Adds the optical depth of a fog.
fn add_depth(sums: ptr<function, SlabSums>, volume: u32, depth: f32) {
    (*sums).thickest = select((*sums).thickest, volume, depth > (*sums).thickest_depth);
    (*sums).thickest_depth = max((*sums).thickest_depth, depth);
    (*sums).depth += depth;
}

// Radiance and optical depth of all media up to `t_max`. A homogeneous fog with source S and optical depth τ
// emits exactly S·(1 - e^-τ). Where the lighting varies, the segment is divided into intervals; where
// several fogs overlap, into slabs. Emission E within a slab is assumed to be evenly mixed with its fogs:
// E·(1 - e^-τ)/τ of it leaves the slab.
fn trace_slabs(segment: Segment, pixel: vec2<u32>, met: Met, t_max: f32) -> Fog {
    let is_whole = met.count == 1u;
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
    for (var index = 0u; index < slabs && fog.optical_depth <= OPAQUE_DEPTH; index++) {
        let slab = slab_at(segment, pixel, met, index, slabs, t_max);
        var slab_sums = SlabSums();
        slab_sums.thickest = NONE;
#ifdef VDB_LIT
        slab_sums.lit = NONE;
#endif
        for (var i = met.first; i < end; i = next_candidate(segment, pixel, i + 1u, t_max)) {
            let is_met = !is_whole || i == met.last;
#ifdef VDB_EMISSION
            if is_met && is_emitter(i) {
                slab_sums.emission += segment_emission(segment, i, slab.start, slab.t_low, slab.t_high);
            }
#endif
            if is_met && volumes[i].kind == KIND_FOG {
#ifdef VDB_LIT
                add_fog(&slab_sums, segment, pixel, i, slab, passed, environment);
#else
                add_fog(&slab_sums, segment, i, slab);
#endif
            }
        }
        let t_middle = 0.5 * (slab.t_low + slab.t_high);
#ifdef VDB_EMITS
        let radiance_before = fog.radiance;
        fog.radiance += exp(-fog.optical_depth) * mean_transmittance(slab_sums.depth) * slab_sums.emission;
#endif
        if slab_sums.depth > 0.0 {
            let transmittance = exp(-fog.optical_depth);
            let weight = transmittance * (1.0 - exp(-slab_sums.depth));
#ifdef VDB_LIT
            fog.radiance += weight * (slab_sums.source / max(slab_sums.depth, 1e-30));
            add_slab(&sums, &passed, slab_sums);
#endif
            t_sum += weight * t_middle;
            fog.motion_volume = select(fog.motion_volume, slab_sums.thickest, weight > largest_weight);
            largest_weight = max(largest_weight, weight);
            fog.optical_depth += slab_sums.depth;
        }
#ifdef VDB_EMITS
        let added = dot(fog.radiance - radiance_before, vec3(1.0));
        radiance_sum += added;
        t_radiance_sum += added * 0.5 * (max(slab.t_low, met.t_first) + min(slab.t_high, met.t_last));
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

#ifdef VDB_LIT
// Adds what is visible of the light of a slab.
fn add_slab(sums: ptr<function, ScatteringSums>, passed: ptr<function, Visible>, slab: SlabSums) {
#ifdef VDB_SCATTERED
    let visible = pass_stretch(passed, slab.depth, slab.forward);
    (*sums).radiance += visible.rest.value * slab.from_lights.rest;
#else
    let visible = pass_stretch(passed, slab.depth);
#endif
    (*sums).radiance += visible.whole * (slab.from_lights.whole + slab.around.radiance);
#ifdef VDB_MULTIPLE_SCATTERING
    (*sums).environment += visible.whole * slab.around.environment;
    (*sums).albedo += visible.whole * slab.around.albedo;
    (*sums).anisotropy += visible.whole * slab.around.anisotropy;
    (*sums).weight += visible.whole * slab.around.weight;
#endif
}
#endif
