// Sends rays through grid 0 and writes what they meet. The rays are given, or those of a picture.

#import bevy_vdb::gpu::types::{Ray, Rays}
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::rays::{ndc_of, ray_through}
#import bevy_vdb::traversal::fog::{optical_length, stepped_length}
#import bevy_vdb::traversal::beam::{beam_of, beam_start_t}
#import bevy_vdb::traversal::hdda::{FAR, Dda, mirrored_ray, enter_at, first_hit, steps}
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::smooth::first_root
#ifdef VDB_SMOOTH_NORMALS
#import bevy_vdb::traversal::normals::smooth_gradient
#endif
#import vdb_probe::single_rays::{ProbeHit, ProbeRay}

struct Setup {
    // Of the picture, in pixels; the rays are its rows.
    size: vec2<u32>,
    count: u32,
}

@group(2) @binding(4) var<storage, read> given: array<ProbeRay>;
@group(2) @binding(5) var<storage, read_write> hits: array<ProbeHit>;
@group(2) @binding(6) var<uniform> setup: Setup;
@group(2) @binding(7) var<storage, read> view: Rays;
@group(2) @binding(8) var<storage, read_write> made: array<ProbeRay>;

// Rays of a dispatch along x: 64 a workgroup, and at most this many workgroups.
const ROW: u32 = 64u * 32768u;

fn number(id: vec3<u32>) -> u32 {
    return id.y * ROW + id.x;
}

#ifdef VDB_PICTURE
fn pixel_of(i: u32) -> vec2<u32> {
    return vec2(i % setup.size.x, i / setup.size.x);
}
#endif

fn ray(i: u32) -> Ray {
#ifdef VDB_PICTURE
    let ray = ray_through(view, ndc_of(pixel_of(i), setup.size), 0.0, FAR);
    made[i] = ProbeRay(ray.cell, ray.t_min, ray.frac, ray.t_max, ray.dir);
    return ray;
#else
    let r = given[i];
    return Ray(r.cell, r.frac, r.dir, r.t_min, r.t_max);
#endif
}

// The rays of a picture begin where those of their tile can, as in the trace.
fn start_t(mirrored: MirroredRay, i: u32) -> f32 {
#ifdef VDB_PICTURE
    return beam_start_t(grids[0], beam_of(grids[0], view, pixel_of(i) / 8u, setup.size, 0.0));
#else
    return mirrored.t_min;
#endif
}

fn enters(mirrored: MirroredRay, i: u32) -> Dda {
    return enter_at(mirrored, start_t(mirrored, i));
}

@compute @workgroup_size(64)
fn probe_voxels(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = number(id);
    if i < setup.count {
        let mirrored = mirrored_ray(grids[0], ray(i));
        let hit = first_hit(grids[0], mirrored, enters(mirrored, i));
        hits[i] = ProbeHit(hit.cell, hit.axis, vec3(0.0), u32(hit.found), hit.t, 0.0, steps);
    }
}

@compute @workgroup_size(64)
fn probe_smooth(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = number(id);
    if i < setup.count {
        let mirrored = mirrored_ray(grids[0], ray(i));
        let hit = first_root(grids[0], mirrored, enters(mirrored, i), false);
        var gradient = hit.gradient;
#ifdef VDB_SMOOTH_NORMALS
        if hit.found {
            gradient = smooth_gradient(grids[0], hit);
        }
#endif
        hits[i] = ProbeHit(hit.cell, hit.axis, gradient, u32(hit.found), hit.t, 0.0, steps);
    }
}

@compute @workgroup_size(64)
fn probe_fog(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = number(id);
    if i < setup.count {
        let mirrored = mirrored_ray(grids[0], ray(i));
#ifdef VDB_STEP
        // In quarters of a voxel.
        let length =
            stepped_length(grids[0], mirrored, start_t(mirrored, i), 3e38, 0.25 * f32(#{VDB_STEP}u), 0.0);
#else
        let length = optical_length(grids[0], mirrored, enters(mirrored, i), 3e38);
#endif
        hits[i] = ProbeHit(vec3(0), 3u, vec3(0.0), 0u, 0.0, length, steps);
    }
}
