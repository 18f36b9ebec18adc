// The samples of the light cache for a sun, from the depths along rays to it.

#import bevy_vdb::light_cache::columns::{RUN, column_at, depth_index, depths, is_in_plane, job, ray_count}
#import bevy_vdb::light_cache::columns::{run_index, shift_at}
#import bevy_vdb::light_cache::store::store_samples

// Adds to the depths of each run what lies before it; the first one is complete.
@compute @workgroup_size(16, 4, 1)
fn join_runs(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.xy;
    let run = id.z + 1u;
    if any(ray >= ray_count()) {
        return;
    }
    var before = 0.0;
    for (var i = 0u; i < run; i++) {
        before += depths[run_index(ray, i)];
    }
    if before <= 0.0 {
        return;
    }
    for (var i = 0u; i < RUN; i++) {
        let plane = run * RUN + i;
        let column = column_at(ray, plane);
        if plane < job.planes && is_in_plane(column) {
            depths[depth_index(plane, vec2<u32>(column))] += before;
        }
    }
}

// Weights of four points in a row for a position between the second and the third. Catmull and Rom 1974, "A
// class of local interpolating splines".
fn cubic_weights(t: f32) -> vec4<f32> {
    let s = 1.0 - t;
    let low = -0.5 * t * s * s;
    let high = -0.5 * s * t * t;
    return vec4(low, s * (1.0 + t - 1.5 * t * t), t * (1.0 + s - 1.5 * s * s), high);
}

fn depth_at_sample(sample: vec3<u32>) -> f32 {
    var at = sample;
    if job.major == 1u {
        at = sample.yzx;
    } else if job.major == 2u {
        at = sample.zxy;
    }
    let plane = select(at.x, job.planes - 1u - at.x, job.is_reversed != 0u);
    let rest = shift_at(plane).rest;
    let weights = cubic_weights(rest.x);
    var rows = cubic_weights(rest.y);
    var depth = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let first = depth_index(plane, at.yz + vec2(0u, i));
        let row = vec4(depths[first], depths[first + 1u], depths[first + 2u], depths[first + 3u]);
        depth += rows[i] * dot(weights, row);
    }
    // Cubic interpolation overshoots.
    return max(depth, 0.0);
}

// Each thread writes two samples along x.
@compute @workgroup_size(4, 4, 4)
fn interpolate(@builtin(global_invocation_id) id: vec3<u32>) {
    let sample = id * vec3(2u, 1u, 1u);
    if any(sample >= job.place.samples) {
        return;
    }
    let first = depth_at_sample(sample);
    var second = 0.0;
    if sample.x + 1u < job.place.samples.x {
        second = depth_at_sample(sample + vec3(1u, 0u, 0u));
    }
    store_samples(job.place, sample, first, second);
}
