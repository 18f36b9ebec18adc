// All fogs and emission grids along a segment, marched together, with light from the light cache.
//
// Each medium advances in its own steps and is treated as homogeneous within a step. Between consecutive step
// ends, the total extinction is then constant, and the integral of transmittance has a closed form. Overlap
// therefore adds no error; only density and light are sampled, at the midpoint of each step.
#define_import_path bevy_vdb::trace::media

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::gpu::types::KIND_FOG
#import bevy_vdb::trace::candidates::start_t
#import bevy_vdb::trace::fog_march::{Fog, MIN_STEP, OPAQUE_DEPTH, light_interval}
#import bevy_vdb::trace::lights::environment_light
#import bevy_vdb::trace::scattering::{ScatteringSums, add_sample, mean_transmittance, scattered_radiance}
#import bevy_vdb::trace::segment::{NONE, Segment, lattice_ray}
#import bevy_vdb::trace::shared_light::{begin_interval, begin_light, light_at_sample, set_anisotropy}
#import bevy_vdb::traversal::fog::{SamplePoint, Step, Steps, begin_steps, next_step, stride_at}
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray}
#import bevy_vdb::traversal::tree::{Accessor, new_accessor}
#import bevy_vdb::view::scene::volumes
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::segment_emission
#endif

// The most media that are marched together.
const MAX_MEDIA: u32 = #{VDB_MEDIA}u;
// The largest optical depth of a step, so that products stay within f32.
const MAX_STEP_DEPTH: f32 = 100.0;

// A medium along a segment. Every t is relative to where the first medium begins.
struct Medium {
    volume: u32,
    steps: Steps,
    accessor: Accessor,
    t_origin: f32,          // of `steps`
    step: Step,             // the current one, or the next one if it begins further on
    visible_start: f32,     // ∫ transmittance dt from the first medium to the step
    weight: f32,            // contribution to the pixel's coverage
}

// Voxels of a step through an emission grid.
const EMISSION_STEP: f32 = 2.0;

fn begin_medium(segment: Segment, pixel: vec2<u32>, volume: u32, t_first: f32, t_max: f32) -> Medium {
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, t_max));
    let fog_step = max(volumes[volume].fog_step, MIN_STEP);
    let step = select(EMISSION_STEP, fog_step, volumes[volume].kind == KIND_FOG);
    let steps = begin_steps(mirrored, start_t(segment, volume, pixel), step);
    let none = Step(0.0, 0.0, 0.0, SamplePoint(vec3(0), vec3(0.0)));
    let accessor = new_accessor(steps.ray.cell);
    return Medium(volume, steps, accessor, steps.t_origin - t_first, none, 0.0, 0.0);
}

// Advances a medium to its next non-empty step, or to a step of width 0 at the end of the ray.
fn find_step(medium: ptr<function, Medium>, optical_depth: f32) {
    let grid = grids[volumes[(*medium).volume].grid];
    let is_fog = volumes[(*medium).volume].kind == KIND_FOG;
    var steps = (*medium).steps;
    var accessor = (*medium).accessor;
    var step: Step;
    loop {
        // Emission may fill only a small part of a step, so a sample of 0 does not skip it, and steps do not
        // grow.
        step = next_step(grid, &steps, &accessor, select(1.0, stride_at(optical_depth), is_fog));
        if step.width <= 0.0 || step.density > 0.0 || !is_fog {
            break;
        }
    }
    (*medium).steps.k = steps.k;
    (*medium).accessor = accessor;
    (*medium).step = step;
}

// Radiance and optical depth of the media along a segment up to `t_max`. `met` holds the indices of `count`
// volumes; the nearest begins at `t_first`.
fn march_media(
    segment: Segment,
    pixel: vec2<u32>,
    met: array<u32, MAX_MEDIA>,
    count: u32,
    t_first: f32,
    t_max: f32,
) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, t_first, t_first, NONE);
    let dir = normalize(segment.dir);
    let dir_length = length(segment.dir);
    let environment = environment_light(dir);
    // A variable, so that it can be indexed dynamically.
    var list = met;
    var media = array<Medium, MAX_MEDIA>();
    // Of each medium: where its step ends, or begins if that is still ahead; FAR if there is none.
    var t_events = array<f32, MAX_MEDIA>();
    // Of each medium: optical depth per unit of t; 0 outside steps.
    var extinctions = array<f32, MAX_MEDIA>();
    var t_interval = FAR;
    for (var i = 0u; i < MAX_MEDIA; i++) {
        t_events[i] = FAR;
        if i < count {
            let volume = list[i];
            media[i] = begin_medium(segment, pixel, volume, t_first, t_max);
            if volumes[volume].kind == KIND_FOG {
                let voxels = light_interval(segment, volume);
                t_interval = min(t_interval, voxels / length(media[i].steps.ray.dir));
            }
        }
    }
    // An anisotropy that no fog has, so that the first fog sets its own.
    var shared_light = begin_light(dir, environment, 2.0);
    var sums = ScatteringSums();
    var t_sum = 0.0;
#ifdef VDB_EMISSION
    var radiance_sum = 0.0;
    var t_radiance_sum = 0.0;
#endif
    var t_now = 0.0;
    var visible = 0.0;      // ∫ transmittance dt where there is a medium
    var active_bits = 0u;   // of the media in a step
    // The medium whose next step has to be found: each in turn, then the one whose step has ended.
    var m = 0u;
    var begun = 1u;
    var is_done = false;
    // Ends by its condition only: llvmpipe drops invocations of a group whose neighbours leave nested loops by
    // `break` or `continue`.
    while !is_done {
        if fog.optical_depth <= OPAQUE_DEPTH {
            var medium = media[m];
            find_step(&medium, fog.optical_depth);
            let t_begin = medium.t_origin + medium.step.t - 0.5 * medium.step.width;
            let t_event = select(FAR, t_begin, medium.step.width > 0.0);
            for (var i = 0u; i < MAX_MEDIA; i++) {
                t_events[i] = select(t_events[i], t_event, i == m);
            }
            media[m].steps.k = medium.steps.k;
            media[m].accessor = medium.accessor;
            media[m].step = medium.step;
        }
        // Once the first step of every medium is known, advances to the end of the next step.
        let is_known = begun >= count;
        m = select(begun, m, is_known);
        begun = min(begun + 1u, count);
        var own_extinction = 0.0;
        var is_moving = is_known;
        while is_moving {
            // Loops of constant length keep the arrays in registers.
            m = 0u;
            var t_event = t_events[0];
            own_extinction = extinctions[0];
            var extinction = extinctions[0];
            for (var i = 1u; i < MAX_MEDIA; i++) {
                let is_earlier = t_events[i] < t_event;
                m = select(m, i, is_earlier);
                t_event = min(t_event, t_events[i]);
                own_extinction = select(own_extinction, extinctions[i], is_earlier);
                extinction += extinctions[i];
            }
            is_done = t_event >= FAR;
            let width = select(max(t_event - t_now, 0.0), 0.0, is_done);
            t_now += width;
            if active_bits != 0u {
                let depth = extinction * width;
                visible += exp(-fog.optical_depth) * width * mean_transmittance(depth);
                fog.optical_depth += depth;
            }
            let is_end = (active_bits & (1u << m)) != 0u;
            active_bits ^= 1u << m;
            let step = media[m].step;
            let volume = media[m].volume;
            media[m].visible_start = select(visible, media[m].visible_start, is_end);
            let is_fog = volumes[volume].kind == KIND_FOG;
            let scale = select(0.0, volumes[volume].density_scale * dir_length, is_fog);
            let max_density = MAX_STEP_DEPTH / max(scale * step.width, 1e-30);
            let begun_extinction = scale * min(step.density, max_density);
            let t_end = media[m].t_origin + step.t + 0.5 * step.width;
            for (var i = 0u; i < MAX_MEDIA; i++) {
                t_events[i] = select(t_events[i], select(t_end, FAR, is_end), i == m);
                extinctions[i] = select(extinctions[i], select(begun_extinction, 0.0, is_end), i == m);
            }
            is_moving = !is_end && !is_done;
        }
        let volume = media[m].volume;
        let step = media[m].step;
        let visible_width = visible - media[m].visible_start;
        let t_middle = media[m].t_origin + step.t;
        let has_ended = is_known && !is_done;
        if has_ended && volumes[volume].kind == KIND_FOG {
            let weight = own_extinction * visible_width;
            if shared_light.light.anisotropy != volumes[volume].anisotropy {
                set_anisotropy(&shared_light, dir, environment, volumes[volume].anisotropy);
            }
            let t = clamp(t_first + t_middle, t_first, t_max);
            if t >= shared_light.t_next {
                begin_interval(&shared_light, segment, pixel, t, t_interval, t_max, environment);
            }
            let light = light_at_sample(shared_light, volume, step.point);
            fog.radiance += weight * volumes[volume].emissive;
            add_sample(&sums, weight, volumes[volume].base_color, light);
            t_sum += weight * t_middle;
            media[m].weight += weight;
#ifdef VDB_EMISSION
            let added = weight * dot(volumes[volume].emissive, vec3(1.0));
            radiance_sum += added;
            t_radiance_sum += added * t_middle;
#endif
        }
#ifdef VDB_EMISSION
        else if has_ended {
            // Emission may vary too quickly for one sample per step, so it is integrated exactly and multiplied
            // by the mean transmittance over the step.
            let t_begin = max(t_first + t_middle - 0.5 * step.width, segment.t_min);
            let t_end = min(t_first + t_middle + 0.5 * step.width, t_max);
            let emission = segment_emission(segment, volume, t_begin, t_begin, t_end);
            let added = (visible_width / max(step.width, 1e-30)) * emission;
            fog.radiance += added;
            radiance_sum += dot(added, vec3(1.0));
            t_radiance_sum += dot(added, vec3(1.0)) * t_middle;
        }
#endif
    }
    var largest_weight = 0.0;
    for (var i = 0u; i < MAX_MEDIA; i++) {
        let is_largest = i < count && media[i].weight > largest_weight;
        fog.motion_volume = select(fog.motion_volume, media[i].volume, is_largest);
        largest_weight = max(largest_weight, media[i].weight);
    }
    fog.radiance += scattered_radiance(sums, fog.optical_depth);
    fog.t_mean = t_first + t_sum / max(1.0 - exp(-fog.optical_depth), 1e-30);
#ifdef VDB_EMISSION
    // Emission need not attenuate anything, so weight t by radiance.
    let t_radiance = t_first + t_radiance_sum / max(radiance_sum, 1e-30);
    fog.t_mean = select(fog.t_mean, t_radiance, radiance_sum > 1e-30);
#endif
    return fog;
}
