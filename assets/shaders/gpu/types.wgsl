// The structs that Rust writes; `src/render/gpu_data.rs` mirrors them field by field, and a test
// compares the offsets.
#define_import_path bevy_vdb::gpu::types

// A packed grid in the pool. Places are numbers of words.
struct Grid {
    top_origin: vec3<i32>,    // local, in lower nodes of 128³ cells
    top_levels: u32,
    occupied_min: vec3<i32>,    // local lattice cells that can stop or dim a ray, both included
    top: u32,
    occupied_max: vec3<i32>,
    lower_nodes: u32,
    heads: u32,
    masks: u32,
    leaf_records: u32,
    records: u32,
    samples: u32,
    palette: u32,
    format: u32,
    brick_words: u32,
    scale: f32,                 // of what is kept of samples; bytes of fog have their own
}

const KIND_SURFACE: u32 = 0u;
const KIND_FOG: u32 = 1u;
const KIND_SMOOTH: u32 = 2u;
// A grid that shines, by its values or as black bodies; it stands in the list of volumes beside that whose
// it is.
const KIND_EMISSION: u32 = 3u;
const KIND_BLACKBODY: u32 = 4u;
// A component of a surface's colour; behind all volumes that rays can meet.
const KIND_COLOR: u32 = 5u;

// The rays of a view in local lattice coordinates of a grid. The one through `ndc` is
//   p(t) = eye_cell + eye_frac + ndc.x·eye_x + ndc.y·eye_y + t·(dir + ndc.x·dir_x + ndc.y·dir_y)
// with t the depth along the view's axis, in world units, the same for every volume.
struct Rays {
    eye_cell: vec3<i32>,
    eye_frac: vec3<f32>,
    eye_x: vec3<f32>,           // not zero in orthographic views only
    eye_y: vec3<f32>,
    dir: vec3<f32>,
    dir_rest: vec3<f32>,        // what the rounding of dir left
    dir_x: vec3<f32>,
    dir_y: vec3<f32>,
}

// One volume as one view sees it.
struct Volume {
    rays: Rays,
    normal_x: vec3<f32>,        // columns of the matrix from index-space gradients to world normals
    grid: u32,
    normal_y: vec3<f32>,
    kind: u32,
    normal_z: vec3<f32>,
    density_scale: f32,         // extinction per unit of density, per world unit
    lattice_x: vec3<f32>,       // columns of the matrix from world directions to the lattice's
    anisotropy: f32,            // of fog, above -1 and below 1
    lattice_y: vec3<f32>,
    perceptual_roughness: f32,
    lattice_z: vec3<f32>,
    metallic: f32,
    base_color: vec3<f32>,      // linear
    reflectance: f32,
    emissive: vec3<f32>,        // linear, cd/m²; of what shines, per world unit and value
    tiles_first: u32,           // of the picture, that show it: 16 bits for the column, 16 for the row
    base: vec3<i32>,            // of local coordinates, modulo the 4,096 cells of the largest nodes
    tiles_last: u32,            // the last column and row; none if these are before the first
    color_grids: u32,           // the first of the three volumes with a surface's colour; or none, 2^32 - 1
    background: f32,            // of a component of a colour: what it is outside of its grid
    temperature_scale: f32,     // of black bodies, kelvin per unit of the values
    temperature_offset: f32,    // kelvin added to that, where there is any value
    box_min: vec3<f32>,         // world space, from the view's eye; where there are many volumes
    flags: u32,                 // bits: throws no shadow, has none thrown on it
    box_max: vec3<f32>,
    fog_step: f32,              // voxels between samples of fog; 0 to integrate it
    node_min: vec3<f32>,         // of a run of volumes (`bvh.wgsl`)
    light_step: f32,            // voxels of fog that are lit as one
    node_max: vec3<f32>,
    shadow_step: f32,           // voxels between samples of fog on the way from a place in fog to a light
}

const NO_CASTER: u32 = 1u;
const NO_RECEIVER: u32 = 2u;

// The most directional lights that a view has in Bevy.
const MAX_SUNS: u32 = 10u;

// A view.
struct View {
    // t = -(x·depth + y) / (z·depth + w), from the value in the depth buffer
    t_from_depth: vec4<f32>,
    // depth = (x·t + y) / (z·t + w)
    depth_from_t: vec4<f32>,
    dir: vec3<f32>,             // world space, per unit of t
    t_near: f32,
    dir_x: vec3<f32>,
    t_far: f32,
    dir_y: vec3<f32>,
    exposure: f32,
    eye: vec3<f32>,             // world space; where the rays begin, as in Rays
    volume_first: u32,          // of this view, in the volumes of all views
    eye_x: vec3<f32>,
    volume_count: u32,
    eye_y: vec3<f32>,
    offscreen_count: u32,        // after those, which the view does not see
    size: vec2<u32>,            // rays, along each axis; but for views of lower resolution, as `picture`
    origin: vec2<u32>,          // of the viewport in the target
    steps_scale: f32,           // steps shown as the hottest colour
    reflections: u32,           // how many times a ray of the view is sent on
    overlays: u32,              // bits: borders of leaves, and of the nodes above and above those
    sun_count: u32,
    slabs: u32,                 // of what overlapping fogs share of a ray
    tile_words: u32,            // of the bits that each tile has for the volumes it can meet
    group_bits: u32,            // log₂ of the volumes that share a bit
    has_tile_starts: u32,          // whether tiles know where rays begin, too
    picture: vec2<u32>,         // pixels of the viewport
    shadow_range: f32,          // world units from a place to what can throw a shadow on it
    reflection_range: f32,      // and from a surface to what is reflected in it
    // Directional lights that shine on volumes otherwise than on meshes: the direction to the light,
    // as Bevy has it, and the factor.
    suns: array<vec4<f32>, MAX_SUNS>,
    // The tangent of half the angle of each, and how many rays a place sends there.
    disks: array<vec4<f32>, MAX_SUNS>,
    random_offset: f32,                  // what the frame adds to random numbers, 0 to 1
    frame: u32,                 // which of those that are put together; 0, if none are
    jitter: vec2<f32>,           // of rays from the middle of what they stand for, in rays, y downwards
    max_frames: u32,           // in a mean of frames
}

// A ray in local lattice coordinates of one grid: p(t) = cell + frac + t·dir.
struct Ray {
    cell: vec3<i32>,
    frac: vec3<f32>,    // a multiple of 2^-24, from 0 up to but not 1
    dir: vec3<f32>,     // the largest component from 2^-30 to 2^30 in size; others meet nothing
    t_min: f32,         // below 0 counts as 0
    t_max: f32,         // what is at exactly t_max is met; before t_min, or no number, nothing is
}
