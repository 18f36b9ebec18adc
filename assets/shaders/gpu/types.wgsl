// The structs that Rust writes. `src/render/gpu/types.rs` mirrors them field by field, and a test compares
// names and offsets.
#define_import_path bevy_vdb::gpu::types

// A packed grid in the pool. Locations are indices of words.
struct Grid {
    top_origin: vec3<i32>,      // local, in lower nodes of 128³ cells
    top_levels: u32,
    occupied_min: vec3<i32>,    // local cells that can stop or attenuate a ray, inclusive
    top: u32,
    occupied_max: vec3<i32>,
    lower_nodes: u32,
    heads: u32,
    masks: u32,
    leaf_records: u32,
    records: u32,               // of a smooth surface; in a copy from `fog_grid`, the volume
    samples: u32,
    palette: u32,
    format: u32,
    brick_words: u32,
    scale: f32,                 // of stored samples; 8-bit fog bricks have scales of their own
    // Only in a copy from `fog_grid`: the number of the ramp that values are mapped with or, in the 16 highest
    // bits, that of the custom material, or 0 for none; the value where the ramp's table begins; and entries
    // per unit of value.
    ramp: u32,
    ramp_low: f32,
    ramp_scale: f32,
}

const KIND_SURFACE: u32 = 0u;
const KIND_FOG: u32 = 1u;
const KIND_SMOOTH: u32 = 2u;
// An emissive grid, by its values or as a black body. It is next to the volume that it belongs to in the
// list of volumes.
const KIND_EMISSION: u32 = 3u;
const KIND_BLACKBODY: u32 = 4u;
// A component of a volume's colour. These follow all volumes that rays can hit.
const KIND_COLOR: u32 = 5u;

// The rays of a view in local lattice coordinates of a grid. The ray through `ndc` is
//     p(t) = eye_cell + eye_frac + ndc.x·eye_x + ndc.y·eye_y + t·(dir + ndc.x·dir_x + ndc.y·dir_y)
// where t is the depth along the view axis in world units, the same for every volume.
struct Rays {
    eye_cell: vec3<i32>,
    eye_frac: vec3<f32>,
    eye_x: vec3<f32>,       // zero except in orthographic views
    eye_y: vec3<f32>,
    dir: vec3<f32>,
    dir_rest: vec3<f32>,    // rounding error of dir
    dir_x: vec3<f32>,
    dir_y: vec3<f32>,
}

// A volume as seen by one view.
struct Volume {
    rays: Rays,
    normal_x: vec3<f32>,        // columns of the matrix from index-space gradients to world normals
    grid: u32,
    normal_y: vec3<f32>,
    kind: u32,
    normal_z: vec3<f32>,
    density_scale: f32,         // extinction per unit of density and world unit
    lattice_x: vec3<f32>,       // columns of the matrix from world to lattice directions
    anisotropy: f32,            // of fog, between -1 and 1, exclusive
    lattice_y: vec3<f32>,
    perceptual_roughness: f32,
    lattice_z: vec3<f32>,
    metallic: f32,
    base_color: vec3<f32>,      // linear
    reflectance: f32,
    emissive: vec3<f32>,        // linear, cd/m²; of emissive grids, per world unit and value
    tiles_first: u32,           // first tile that shows it: 16 bits each for column and row
    base: vec3<i32>,            // of local coordinates
    tiles_last: u32,            // last tile that shows it; before the first if there is none
    color_grids: u32,           // the first of three volumes with its colour, or 2^32 - 1 for none
    background: f32,            // of a colour component: the value outside its grid
    temperature_scale: f32,     // of black bodies, kelvin per unit of value
    temperature_offset: f32,    // kelvin added wherever the value is positive
    box_min: vec3<f32>,         // world space, relative to the view's eye; only in scenes with many volumes
    flags: u32,                 // bits: casts no shadows, receives none, smooth normals, page; then see below
    box_max: vec3<f32>,
    fog_step: f32,              // voxels between samples of fog; 0 to integrate it exactly
    node_min: vec3<f32>,        // of a BVH node (`bvh.wgsl`)
    light_step: f32,            // voxels of fog that share one lighting sample
    node_max: vec3<f32>,
    shadow_step: f32,           // voxels between samples of fog on rays from points in fog to lights
    light_origin: vec3<i32>,    // local cell at the first sample of the light cache
    light_scale: f32,           // samples of the light cache per cell along each axis
    light_texel: vec3<f32>,     // centre of the first sun's first sample in the cache's texture, in texels
    light_planes: u32,          // texels from one sun to the next; 0 if it is not in the light cache
    ramp: u32,                  // number of a fog's ramp, from 1; 0 for none
    ramp_low: f32,              // value where the ramp's table begins
    ramp_scale: f32,            // entries of the table per unit of value
    ramp_emission: f32,         // factor for the ramp's emission
    // Depths along the view axis between which this level of detail represents its volume. Secondary rays meet the
    // level at the depth where their view ray ends.
    t_first: f32,
    t_end: f32,
    clip_planes: u32,           // bits: the view's clip planes that cut it
    scattered: u32,             // number of its lattice of scattered light, from 1; 0 if it has none
}

const NO_CASTER: u32 = 1u;
const NO_RECEIVER: u32 = 2u;
const SMOOTH_NORMALS: u32 = 4u;
// One of the pages of a larger surface. A ray that is already inside the solid where it enters the page, because
// the surface of the adjacent page is slightly lower, hits at the border.
const PAGE: u32 = 8u;
// Where the flags have the level of detail and, in the 16 highest bits, the number of the custom material, or
// 0 for none.
const LEVEL_SHIFT: u32 = 8u;
const LEVEL_MASK: u32 = 31u;
const MATERIAL_SHIFT: u32 = 16u;

// The largest number of directional lights in a Bevy view.
const MAX_SUNS: u32 = 10u;

// The largest number of directional lights in the light cache.
const MAX_CACHED_SUNS: u32 = 4u;
// The most point and spot lights in the light cache.
const MAX_CACHED_LAMPS: u32 = 32u;
// The most clip planes: a bit each in a volume.
const MAX_CLIP_PLANES: u32 = 32u;
// The most lights of fires whose highlights are left to reflections.
const MAX_FIRE_LIGHTS: u32 = 32u;

// The largest 16-bit float.
const MAX_HALF: f32 = 65504.0;

// The most lattices of scattered light in a view.
const MAX_SCATTERED_LIGHTS: u32 = 16u;

// A lattice of scattered light.
struct ScatteredLattice {
    // Place in cells, from the position relative to the view's eye: dot products with its coordinates and 1.
    x: vec4<f32>,
    y: vec4<f32>,
    z: vec4<f32>,
    size: vec3<f32>,    // cells along each axis, without the border of texels around them
    first: f32,         // first layer of texels; lattices lie one above the other, and in each its channels
    scale: vec3<f32>,   // cd/m² per stored unit, in each channel
    channels: u32,      // 1 if all light has one colour, otherwise 3
}

struct View {
    // t = -(x·depth + y) / (z·depth + w), where depth is the value in the depth buffer
    t_from_depth: vec4<f32>,
    // depth = (x·t + y) / (z·t + w)
    depth_from_t: vec4<f32>,
    dir: vec3<f32>,         // world space, per unit of t
    t_near: f32,
    dir_x: vec3<f32>,
    t_far: f32,
    dir_y: vec3<f32>,
    exposure: f32,
    eye: vec3<f32>,         // world space; the origin of rays, as in Rays
    volume_first: u32,      // first volume of this view in the volumes of all views
    eye_x: vec3<f32>,
    volume_count: u32,
    eye_y: vec3<f32>,
    offscreen_count: u32,   // volumes outside the view, which follow its own
    size: vec2<u32>,        // rays along each axis; equals `picture` at full resolution
    origin: vec2<u32>,      // of the viewport in the target
    mode_scale: f32,        // number of steps shown as the hottest colour, or value shown in white
    reflections: u32,       // maximum number of reflections of a view ray
    overlays: u32,          // bits: borders of leaves, lower nodes and upper nodes
    sun_count: u32,
    slabs: u32,             // slabs of a ray that overlapping fogs share
    tile_words: u32,        // words per tile of bits for the volumes that it may hit
    group_bits: u32,        // log₂ of the number of volumes that share a bit
    has_tile_starts: u32,   // whether tiles also store where rays start
    picture: vec2<u32>,     // size of the viewport in pixels
    shadow_range: f32,      // maximum distance from a point to an occluder, world units
    reflection_range: f32,  // maximum distance from a surface to a reflected one, world units
    // Directional lights with settings of their own for volumes: direction to the light, as Bevy stores it,
    // and intensity factor.
    suns: array<vec4<f32>, MAX_SUNS>,
    // For each of them: tangent of the angular radius, and number of shadow rays per point.
    disks: array<vec4<f32>, MAX_SUNS>,
    random_offset: f32,     // offset of random numbers in this frame, 0 to 1
    frame: u32,             // number of the accumulated or jittered frame; 0 without either
    jitter: vec2<f32>,      // offset of rays from their centres, in rays, y downwards
    max_frames: u32,        // largest number of frames in a mean
    cached_sun_count: u32,
    edge_samples: u32,      // further rays of a pixel on an edge: 0, 2, 4, 8 or 16
    fire_light_count: u32,
    // Directions to the suns in the light cache, as Bevy stores them.
    cached_suns: array<vec4<f32>, MAX_CACHED_SUNS>,
    light_texel: vec3<f32>, // 1 / size of the light cache's texture in texels
    cached_lamp_count: u32,
    // Indices of the point and spot lights in the light cache, among Bevy's clustered lights.
    cached_lamps: array<vec4<u32>, MAX_CACHED_LAMPS / 4u>,
    // Indices of the lights of fires, among Bevy's clustered lights.
    fire_lights: array<vec4<u32>, MAX_FIRE_LIGHTS / 4u>,
    // Unit normals on the side that is kept, world space, and the distance of the view's eye on that side.
    clip_planes: array<vec4<f32>, MAX_CLIP_PLANES>,
    scattered: array<ScatteredLattice, MAX_SCATTERED_LIGHTS>,
    // From the clip space of this frame to that of the previous one, without jitter.
    then_from_now: mat4x4<f32>,
    reflection_frame: u32,      // as `frame`, for reflections of the first ray of a pixel; counts every frame
    max_history_frames: u32,    // largest number of frames in the mean of a reflection, with this one
}

// Where the opacity map of a fog is, as one light sees it, in the texture of all of them (`shadow_maps/opacity.wgsl`).
struct OpacityMap {
    origin: vec2<u32>,      // the first sample
    size: vec2<u32>,        // in samples, each of which is a ray; 0 if there is none
    first_texel: vec2<f32>, // where in the shadow map the first ray is, in texels
    spacing: vec2<f32>,     // from ray to ray
    t_first: f32,           // of the fog's box
    t_last: f32,
}

// The velocities within a volume, for motion vectors: means over cubes of voxels, at the points of a lattice.
struct Velocities {
    lattice_from_clip: mat4x4<f32>, // from the clip space of the view's rays; points are whole numbers
    // From a mean to the displacement in the clip space of the previous frame, per unit of w in world space.
    clip_from_mean: mat3x4<f32>,
    size: vec3<u32>,                // points along each axis; 0 if nothing moves
    first: u32,                     // first mean
}

// A ray in local lattice coordinates of one grid: p(t) = cell + frac + t·dir.
struct Ray {
    cell: vec3<i32>,
    frac: vec3<f32>,    // a multiple of 2^-24 in [0, 1)
    dir: vec3<f32>,     // the largest component must be 2^-30 to 2^30 in magnitude, or nothing is hit
    t_min: f32,         // negative values count as 0
    t_max: f32,         // inclusive; if less than t_min or NaN, nothing is hit
}

// Where a view's image is in its target, in pixels.
struct Placement {
    origin: vec2<u32>,
    size: vec2<u32>,
}
