// All media along a segment: their optical depth and radiance.
#define_import_path bevy_vdb::trace::fogs

#import bevy_vdb::gpu::types::KIND_FOG
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::trace::candidates::{next_candidate, start_t, volume_end}
#import bevy_vdb::trace::fog_march::Fog
#import bevy_vdb::trace::segment::{NONE, Segment, lattice_ray}
#import bevy_vdb::trace::slabs::{Met, trace_slabs}
#import bevy_vdb::traversal::hdda::{FAR, box_exit, enter, mirrored_ray}
#import bevy_vdb::view::scene::{view, volumes}
#ifdef VDB_EMISSION
#import bevy_vdb::trace::emission::{is_emitter, segment_emission}
#endif
#ifdef VDB_LIGHT_CACHE
#import bevy_vdb::trace::media::march_media
#import bevy_vdb::trace::medium::{MAX_FOGS, MetMedia}
#ifdef VDB_EMISSION
#import bevy_vdb::trace::medium::MAX_EMITTERS
#endif
#ifdef VDB_UNCACHED_FOGS
#import bevy_vdb::trace::light_cache::has_light_cache
#endif
#endif

// Whether a volume attenuates a ray or emits light along it.
fn is_medium(volume: u32) -> bool {
    let is_fog = volumes[volume].kind == KIND_FOG && volumes[volume].density_scale > 0.0;
#ifdef VDB_EMISSION
    return is_fog || is_emitter(volume);
#else
    return is_fog;
#endif
}

#ifdef VDB_LIGHT_CACHE
fn add_medium(media: ptr<function, MetMedia>, volume: u32) {
#ifdef VDB_EMISSION
    if is_emitter(volume) {
        (*media).emitters[min((*media).emitter_count, MAX_EMITTERS - 1u)] = volume;
        (*media).emitter_count += 1u;
        return;
    }
#endif
    (*media).fogs[min((*media).fog_count, MAX_FOGS - 1u)] = volume;
    (*media).fog_count += 1u;
}

#ifdef VDB_UNCACHED_FOGS
// Whether all media can be marched together.
fn have_slots(media: MetMedia) -> bool {
#ifdef VDB_EMISSION
    return media.fog_count <= MAX_FOGS && media.emitter_count <= MAX_EMITTERS;
#else
    return media.fog_count <= MAX_FOGS;
#endif
}
#endif
#endif

// Whether it must be known before a segment is marched which media it meets. Candidates may miss a segment.
#ifdef VDB_EMISSION
const NEEDS_MET: bool = true;
#else ifdef VDB_UNCACHED_FOGS
const NEEDS_MET: bool = true;
#else ifdef VDB_LIGHT_CACHE
const NEEDS_MET: bool = false;
#else
const NEEDS_MET: bool = true;
#endif

// Adds a medium to those met if the segment meets it. Returns whether it does.
fn add_if_met(met: ptr<function, Met>, segment: Segment, volume: u32, t_max: f32) -> bool {
    let mirrored = mirrored_ray(grids[volumes[volume].grid], lattice_ray(segment, volume, t_max));
    let dda = enter(mirrored);
    if !dda.inside || dda.t >= t_max {
        return false;
    }
    (*met).count += 1u;
    (*met).fog_count += u32(volumes[volume].kind == KIND_FOG);
    (*met).last = volume;
    (*met).t_first = min((*met).t_first, dda.t);
    (*met).t_last = max((*met).t_last, min(box_exit(mirrored), t_max));
    return true;
}

// Radiance and optical depth of all fogs and emission grids along a segment up to `t_max`.
fn trace_fogs(segment: Segment, pixel: vec2<u32>, t_max: f32) -> Fog {
    let first = next_candidate(segment, pixel, view.volume_first, t_max);
    let end = volume_end(segment);
    var met = Met(0u, 0u, first, 0u, FAR, segment.t_min);
#ifdef VDB_LIGHT_CACHE
    var media = MetMedia();
#endif
#ifdef VDB_UNCACHED_FOGS
    var is_cached = true;
#endif
    for (var i = first; i < end; i = next_candidate(segment, pixel, i + 1u, t_max)) {
        if is_medium(i) && (!NEEDS_MET || add_if_met(&met, segment, i, t_max)) {
#ifdef VDB_LIGHT_CACHE
            add_medium(&media, i);
#endif
#ifdef VDB_UNCACHED_FOGS
            is_cached = is_cached && (volumes[i].kind != KIND_FOG || has_light_cache(i));
#endif
        }
    }
#ifdef VDB_LIGHT_CACHE
    let has_none = select(media.fog_count == 0u, met.count == 0u, NEEDS_MET);
#else
    let has_none = met.count == 0u;
#endif
    if has_none {
        return Fog(vec3(0.0), 0.0, FAR, FAR, NONE);
    }
#ifdef VDB_EMISSION
    if met.fog_count == 0u {
        return emission_alone(segment, pixel, met, t_max);
    }
#endif
#ifdef VDB_LIGHT_CACHE
#ifdef VDB_UNCACHED_FOGS
    if !is_cached || !have_slots(media) {
        return trace_slabs(segment, pixel, met, t_max);
    }
#endif
    return march_media(segment, pixel, media, t_max);
#else
    return trace_slabs(segment, pixel, met, t_max);
#endif
}

#ifdef VDB_EMISSION
// Radiance of emission grids along a segment without fog, which nothing attenuates.
fn emission_alone(segment: Segment, pixel: vec2<u32>, met: Met, t_max: f32) -> Fog {
    var fog = Fog(vec3(0.0), 0.0, met.t_first, met.t_first, NONE);
    var radiance_sum = 0.0;
    var t_sum = 0.0;
    let end = volume_end(segment);
    for (var i = met.first; i < end; i = next_candidate(segment, pixel, i + 1u, t_max)) {
        if is_emitter(i) {
            let mirrored = mirrored_ray(grids[volumes[i].grid], lattice_ray(segment, i, t_max));
            let dda = enter(mirrored);
            if dda.inside && dda.t < t_max {
                let start = start_t(segment, i, pixel);
                let emission = segment_emission(segment, i, start, segment.t_min, t_max);
                let t_middle = 0.5 * (dda.t + min(box_exit(mirrored), t_max));
                fog.radiance += emission;
                radiance_sum += dot(emission, vec3(1.0));
                t_sum += dot(emission, vec3(1.0)) * t_middle;
            }
        }
    }
    fog.t_mean = select(met.t_first, t_sum / max(radiance_sum, 1e-30), radiance_sum > 1e-30);
    return fog;
}
#endif
