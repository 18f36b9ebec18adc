// Single rays: what goes in, what comes out; as in `probe.rs`.
#define_import_path vdb_probe::single_rays

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
