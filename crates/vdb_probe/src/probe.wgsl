// Sends rays through grid 0 and writes what they meet. The rays are given, or those of a picture.

#import bevy_vdb::types::{Ray, Rays}
#import bevy_vdb::bindings::grids
#import bevy_vdb::rays::{ndc_of, ray_through}
#import bevy_vdb::fog::optical_length
#import bevy_vdb::hdda::{course_of, enter, first_hit, steps}
#import bevy_vdb::smooth::first_root

struct ProbeRay {
    cell: vec3<i32>,
    t_min: f32,
    frac: vec3<f32>,
    t_max: f32,
    dir: vec3<f32>,
}

struct ProbeHit {
    cell: vec3<i32>,
    axis: u32,
    gradient: vec3<f32>,
    hit: u32,
    t: f32,
    optical_length: f32,
    steps: u32,
}

struct Setup {
    iso: f32,
    t_min: f32,
    t_max: f32,
    count: u32,
    // Of the picture, in pixels; the rays are its rows, from the first one on.
    size: vec2<u32>,
    first: u32,
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

fn ray(i: u32) -> Ray {
#ifdef PICTURE
    let pixel = i + setup.first;
    let ndc = ndc_of(vec2(pixel % setup.size.x, pixel / setup.size.x), setup.size);
    let ray = ray_through(view, ndc, setup.t_min, setup.t_max);
    made[i] = ProbeRay(ray.cell, ray.t_min, ray.frac, ray.t_max, ray.dir);
    return ray;
#else
    let r = given[i];
    return Ray(r.cell, r.frac, r.dir, r.t_min, r.t_max);
#endif
}

@compute @workgroup_size(64)
fn probe_voxels(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = number(id);
    if i < setup.count {
        let course = course_of(grids[0], ray(i));
        let hit = first_hit(grids[0], course, enter(course));
        hits[i] = ProbeHit(hit.cell, hit.axis, vec3(0.0), u32(hit.found), hit.t, 0.0, steps);
    }
}

@compute @workgroup_size(64)
fn probe_smooth(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = number(id);
    if i < setup.count {
        let course = course_of(grids[0], ray(i));
        let hit = first_root(grids[0], course, enter(course), setup.iso);
        hits[i] = ProbeHit(vec3(0), hit.axis, hit.gradient, u32(hit.found), hit.t, 0.0, steps);
    }
}

@compute @workgroup_size(64)
fn probe_fog(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = number(id);
    if i < setup.count {
        let course = course_of(grids[0], ray(i));
        let length = optical_length(grids[0], course, enter(course), 3e38);
        hits[i] = ProbeHit(vec3(0), 3u, vec3(0.0), 0u, 0.0, length, steps);
    }
}
