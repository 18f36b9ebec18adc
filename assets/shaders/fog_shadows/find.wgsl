// Finds the grain that fog in shadow maps leaves on meshes, in two dispatches: what light should arrive at each
// pixel, then how much Bevy's shader let arrive there. One thread per pixel.
//
// Group 0 holds the shadow maps without fog in the first dispatch, and those with fog in the second, which Bevy's
// own functions filter as they do where a mesh is shaded.

#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_render::view::position_ndc_to_world
#import bevy_vdb::gpu::types::Placement
#import bevy_vdb::trace::light_list::{ShadingPoint, casts_shadows, lights_at, local_light, to_light, view_z}
#import bevy_vdb::trace::mesh_shadows::sun_past_meshes
#import bevy_vdb::view::picture::luminance_of
#ifdef VDB_LOCAL_LIGHTS
#import bevy_vdb::trace::illuminance::lamp_illuminance
#import bevy_vdb::trace::mesh_shadows::lamp_past_meshes
#endif
#ifdef VDB_WITH_FOG
#import bevy_vdb::fog_shadows::grain::{Grain, NO_GRAIN, encoded_grain}
#else
#import bevy_vdb::fog_shadows::maps::sun_past_fog
#ifdef VDB_LOCAL_LIGHTS
#import bevy_vdb::fog_shadows::maps::lamp_past_fog
#endif
#endif

#ifdef MULTISAMPLED
@group(2) @binding(0) var scene_depth: texture_depth_multisampled_2d;
#else
@group(2) @binding(0) var scene_depth: texture_depth_2d;
#endif
@group(2) @binding(1) var<uniform> placement: Placement;
// Light is relative to what would arrive without shadows from all lights that cast them.
#ifdef VDB_WITH_FOG
// See `encoded_grain`.
@group(2) @binding(2) var found: texture_storage_2d<rg32uint, write>;
// What the first dispatch has found.
@group(2) @binding(3) var expected: texture_2d<f32>;
#else
// The light that should arrive; negative where fog takes none.
@group(2) @binding(2) var found: texture_storage_2d<r32float, write>;
#endif

fn store_nothing(pixel: vec2<u32>) {
#ifdef VDB_WITH_FOG
    textureStore(found, pixel, vec4(NO_GRAIN, 0u, 0u));
#else
    textureStore(found, pixel, vec4(-1.0));
#endif
}

#ifdef MULTISAMPLED
// Depth of the mesh at a pixel: the mean of its samples, whose places average to the middle of the pixel, where
// Bevy shades the mesh. 0 where a sample shows no mesh.
fn depth_at(pixel: vec2<u32>) -> f32 {
    let samples = textureNumSamples(scene_depth);
    var sum = 0.0;
    var least = 1.0;
    for (var i = 0u; i < samples; i++) {
        let depth = textureLoad(scene_depth, pixel, i32(i));
        sum += depth;
        least = min(least, depth);
    }
    return select(0.0, sum / f32(samples), least > 0.0);
}
#else
// Depth of the mesh at a pixel.
fn depth_at(pixel: vec2<u32>) -> f32 {
    return textureLoad(scene_depth, pixel, 0);
}
#endif

// The position of a pixel's mesh in world space, and 1; 0 if there is no mesh or no such pixel.
fn position_at(pixel: vec2<i32>) -> vec4<f32> {
    if any(pixel < vec2(0)) || any(pixel >= vec2<i32>(placement.size)) {
        return vec4(0.0);
    }
    let depth = depth_at(placement.origin + vec2<u32>(pixel));
    if depth <= 0.0 {
        return vec4(0.0);
    }
    let uv = (vec2<f32>(pixel) + 0.5) / vec2<f32>(placement.size);
    let ndc = vec3(2.0 * uv.x - 1.0, 1.0 - 2.0 * uv.y, depth);
    return vec4(position_ndc_to_world(ndc, bevy::view.world_from_clip), 1.0);
}

// The difference of positions between a pixel and one of its neighbours along an axis: the nearer one, which is
// likely to be of the same mesh. 0 if neither shows one.
fn step_along(pixel: vec2<i32>, axis: vec2<i32>, middle: vec3<f32>) -> vec3<f32> {
    let after = position_at(pixel + axis);
    let before = position_at(pixel - axis);
    let ahead = after.xyz - middle;
    let behind = middle - before.xyz;
    if after.w > 0.0 && (before.w == 0.0 || dot(ahead, ahead) <= dot(behind, behind)) {
        return ahead;
    }
    return select(vec3(0.0), behind, before.w > 0.0);
}

// The normal of the mesh at a pixel, towards the camera; 0 if it is not known.
fn normal_at(pixel: vec2<i32>, position: vec3<f32>) -> vec3<f32> {
    let x = step_along(pixel, vec2(1, 0), position);
    let y = step_along(pixel, vec2(0, 1), position);
    // To the right and down, as seen by the camera.
    let normal = cross(y, x);
    return normal * inverseSqrt(max(dot(normal, normal), 1e-30));
}

@compute @workgroup_size(8, 8, 1)
fn find(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy;
    if any(pixel >= placement.size) {
        return;
    }
#ifdef VDB_WITH_FOG
    let wanted = textureLoad(expected, pixel, 0).x;
    let is_shaded = wanted >= 0.0;
#else
    let is_shaded = true;
#endif
    let here = position_at(vec2<i32>(pixel));
    // An orthographic camera may also see what is behind it.
    let distance = -view_z(here.xyz);
    if !is_shaded || here.w == 0.0 || distance <= 0.0 {
        store_nothing(pixel);
        return;
    }
    let normal = normal_at(vec2<i32>(pixel), here.xyz);
    let coord = vec2<f32>(placement.origin + pixel) + 0.5;
    let at = ShadingPoint(here.xyz, normal, coord, true);
    let lights = lights_at(at);
    var whole = 0.0;
    var arrives = 0.0;
    var takes = false;
    for (var i = 0u; i < lights.end; i++) {
        let light_vector = to_light(at, lights, i);
        let cosine = dot(normal, light_vector) * inverseSqrt(max(dot(light_vector, light_vector), 1e-30));
        if !casts_shadows(lights, i) || cosine <= 0.0 {
            continue;
        }
        var illuminance = 0.0;
        var visible = 1.0;
        var past_fog = 1.0;
        if i < lights.suns {
            illuminance = luminance_of(bevy::lights.directional_lights[i].color.rgb);
            visible = sun_past_meshes(at, i);
#ifndef VDB_WITH_FOG
            past_fog = sun_past_fog(at, i);
#endif
        } else {
#ifdef VDB_LOCAL_LIGHTS
            let lamp = local_light(lights, i);
            let data = bevy::clustered_lights.data[lamp];
            illuminance = luminance_of(lamp_illuminance(data, light_vector, vec3(0.0), 0.0));
            visible = lamp_past_meshes(at, lamp);
#ifndef VDB_WITH_FOG
            past_fog = lamp_past_fog(at, lamp);
#endif
#endif
        }
        whole += illuminance * cosine;
        arrives += illuminance * cosine * visible * past_fog;
        takes |= past_fog < 1.0;
    }
    arrives /= max(whole, 1e-30);
#ifdef VDB_WITH_FOG
    let grain = Grain(arrives - wanted, arrives, distance);
    textureStore(found, pixel, vec4(encoded_grain(grain), 0u, 0u));
#else
    textureStore(found, pixel, vec4(select(-1.0, arrives, takes)));
#endif
}
