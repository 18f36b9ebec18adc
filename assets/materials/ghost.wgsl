// A fog that comes apart from below, in wisps that turn as they go. For the example `materials`.

#import bevy_vdb::material::{Ghost, VdbFog, VdbFogPoint}

fn hash(cell: vec3<f32>) -> f32 {
    var v = bitcast<vec3<u32>>(vec3<i32>(cell)) * 1664525u + 1013904223u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    return f32((v.x ^ (v.x >> 16u)) & 0xffffu) / 65535.0;
}

// Noise from 0 to 1: numbers at the corners of cubes, interpolated smoothly.
fn noise(p: vec3<f32>) -> f32 {
    let cell = floor(p);
    let f = p - cell;
    let u = f * f * (3.0 - 2.0 * f);
    let x = vec2(0.0, 1.0);
    let low = mix(
        mix(hash(cell), hash(cell + x.yxx), u.x),
        mix(hash(cell + x.xyx), hash(cell + x.yyx), u.x),
        u.y,
    );
    let high = mix(
        mix(hash(cell + x.xxy), hash(cell + x.yxy), u.x),
        mix(hash(cell + x.xyy), hash(cell + vec3(1.0)), u.x),
        u.y,
    );
    return mix(low, high, u.z);
}

fn fog(at: VdbFogPoint, built_in: VdbFog, ghost: Ghost) -> VdbFog {
    let p = at.local_position;
    let drift = vec3(0.0, 0.35 * ghost.time, 0.1 * ghost.time);
    let wisps = 0.6 * noise(p * vec3(5.0, 3.0, 5.0) - drift) + 0.4 * noise(p * 11.0 - 2.0 * drift);
    // 0 where nothing is left and 1 where all is: what is low goes first.
    let left = smoothstep(-0.12, 0.18, wisps + p.y / ghost.height - 2.0 * ghost.dissolved + 0.2);
    return VdbFog(left * mix(0.35, 1.0, wisps), mix(ghost.edge_color.rgb, vec3(1.0), left));
}
