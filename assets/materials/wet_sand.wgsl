// Sand on a shore: dry and pale above, dark and glossy where it is wet, and below the water line under a film of
// water that mirrors the sky. For the example `materials`.

#import bevy_vdb::material::{VdbHit, VdbSurface, WetSand}

// A number from 0 to 1 for each cell of a lattice (Jarzynski and Olano 2020, "Hash functions for GPU rendering").
fn hash(cell: vec3<i32>) -> f32 {
    var v = bitcast<vec3<u32>>(cell) * 1664525u + 1013904223u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    return f32((v.x ^ (v.x >> 16u)) & 0xffffu) / 65535.0;
}

fn surface(hit: VdbHit, built_in: VdbSurface, sand: WetSand) -> VdbSurface {
    var changed = built_in;
    let at = hit.local_position;
    // Grains, which fade where pixels are larger.
    let grain = hash(vec3<i32>(floor(at * 160.0))) - 0.5;
    changed.base_color *= 1.0 + 0.5 * grain * saturate(1.0 - hit.distance / 14.0);
    // The edge of what the last wave has left.
    let tide = sand.water_line + 0.05 * sin(2.3 * at.x + 0.7 * sin(1.9 * at.z)) * sin(0.8 * at.z + 1.0);
    let wet = 1.0 - smoothstep(0.02, 0.16, at.y - tide);
    changed.base_color *= mix(vec3(1.0), sand.wet_color.rgb, wet);
    changed.perceptual_roughness = mix(built_in.perceptual_roughness, 0.3, wet);
    let depth = sand.water_line - at.y;
    if depth > 0.0 && hit.geometric_normal.y > 0.3 {
        // Beer and Lambert, for light that goes down and up again.
        let clear = exp(-depth * sand.absorption);
        changed.base_color *= clear;
        changed.base_color += sand.water_color.rgb * (1.0 - clear);
        let film = smoothstep(0.0, 0.02, depth);
        let ripple = sand.ripples
            * vec3(cos(9.0 * at.x + 4.0 * at.z + sand.time), 0.0, cos(5.0 * at.x - 11.0 * at.z + 1.3 * sand.time));
        changed.normal = mix(built_in.normal, normalize(vec3(0.0, 1.0, 0.0) + ripple), film);
        changed.perceptual_roughness = mix(changed.perceptual_roughness, 0.03, film);
    }
    return changed;
}
