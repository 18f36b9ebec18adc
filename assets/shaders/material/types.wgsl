// What the functions of custom materials get and return. The structs of their parameters follow, as
// `src/render/gpu/materials/modules.rs` derives them from the app's components.
#define_import_path bevy_vdb::material

// Where a ray hits a surface.
struct VdbHit {
    world_position: vec3<f32>,
    distance: f32,                  // from the start of the ray, world units
    local_position: vec3<f32>,      // in the space of the volume's entity, which its Transform places
    index_position: vec3<f32>,      // in index space: sample ijk is at (i, j, k)
    geometric_normal: vec3<f32>,    // of the surface that rays hit: world space, unit length, outwards
    to_viewer: vec3<f32>,           // world space, unit length
}

// A point in fog.
struct VdbFogPoint {
    local_position: vec3<f32>,      // in the space of the volume's entity, which its Transform places
    index_position: vec3<f32>,      // in index space: sample ijk is at (i, j, k)
}

// The factors for a fog's density and albedo at a point.
struct VdbFog {
    density: f32,                   // 0 to 1
    color: vec3<f32>,               // linear, 0 to 1
}

// The material of a surface at a hit: `VdbMaterial` and `VdbColorGrid`, or what a function makes of it.
struct VdbSurface {
    base_color: vec3<f32>,          // linear, 0 or more
    perceptual_roughness: f32,      // 0 to 1
    normal: vec3<f32>,              // for shading: world space, on the side of the viewer
    metallic: f32,                  // 0 to 1
    emissive: vec3<f32>,            // linear, cd/m², 0 or more
    reflectance: f32,               // 0 to 1
}
