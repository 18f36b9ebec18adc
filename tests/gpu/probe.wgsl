// Walks given rays through grid 0 and writes what they meet.

#import bevy_vdb::types::Ray
#import bevy_vdb::bindings::grids
#import bevy_vdb::fog::optical_length
#import bevy_vdb::hdda::{first_hit, steps}
#import bevy_vdb::smooth::first_root

struct ProbeRay {
    cell: vec3<i32>,
    t_min: f32,
    frac: vec3<f32>,
    t_max: f32,
    dir: vec3<f32>,
    pad: f32,
}

struct ProbeHit {
    cell: vec3<i32>,
    axis: u32,
    t: f32,
    hit: u32,
    optical_length: f32,
    steps: u32,
    gradient: vec3<f32>,
}

@group(0) @binding(4) var<storage, read> rays: array<ProbeRay>;
@group(0) @binding(5) var<storage, read_write> hits: array<ProbeHit>;

fn ray(i: u32) -> Ray {
    let r = rays[i];
    return Ray(r.cell, r.frac, r.dir, r.t_min, r.t_max);
}

@compute @workgroup_size(64)
fn probe_surface(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&rays) {
        let hit = first_hit(grids[0], ray(id.x));
        hits[id.x] = ProbeHit(hit.cell, hit.axis, hit.t, u32(hit.inside), 0.0, steps, vec3(0.0));
    }
}

@compute @workgroup_size(64)
fn probe_fog(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&rays) {
        let length = optical_length(grids[0], ray(id.x), 1e30);
        hits[id.x] = ProbeHit(vec3(0), 0u, 0.0, 0u, length, steps, vec3(0.0));
    }
}

@compute @workgroup_size(64)
fn probe_smooth(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&rays) {
        let hit = first_root(grids[0], ray(id.x), 0.0);
        hits[id.x] =
            ProbeHit(vec3(0), hit.axis, hit.t, u32(hit.found), 0.0, steps, hit.gradient);
    }
}
