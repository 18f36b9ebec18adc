//! The structs of `assets/shaders/types.wgsl`, field by field. WGSL aligns a `vec3` to 16 bytes, so
//! each is followed by a scalar; a test compares the offsets with those that naga computes.

use bytemuck::{Pod, Zeroable};

/// A packed grid in the pools; offsets in elements from the start of each pool.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Grid {
    pub crown_origin: [i32; 3],
    pub crown_levels: u32,
    pub occupied_min: [i32; 3],
    pub nodes: u32,
    pub occupied_max: [i32; 3],
    pub uppers: u32,
    pub lowers: u32,
    pub masks: u32,
    pub values: u32,
    pub palette: u32,
}

pub(crate) const KIND_SURFACE: u32 = 0;
pub(crate) const KIND_FOG: u32 = 1;

/// One volume as one view sees it.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Volume {
    pub eye_cell: [i32; 3],
    pub grid: u32,
    pub eye_frac: [f32; 3],
    pub kind: u32,
    pub eye_x: [f32; 3],
    pub density_scale: f32,
    pub eye_y: [f32; 3],
    pub pad_0: f32,
    pub dir: [f32; 3],
    pub pad_1: f32,
    pub dir_x: [f32; 3],
    pub pad_2: f32,
    pub dir_y: [f32; 3],
    pub pad_3: f32,
    pub normal_x: [f32; 3],
    pub pad_4: f32,
    pub normal_y: [f32; 3],
    pub pad_5: f32,
    pub normal_z: [f32; 3],
    pub pad_6: f32,
    pub base_color: [f32; 3],
    pub pad_7: f32,
    pub emissive: [f32; 3],
    pub pad_8: f32,
}

/// A view and its light.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct View {
    pub t_from_depth: [f32; 4],
    pub depth_from_t: [f32; 4],
    pub dir: [f32; 3],
    pub t_near: f32,
    pub dir_x: [f32; 3],
    pub t_far: f32,
    pub dir_y: [f32; 3],
    pub exposure: f32,
    pub sun_direction: [f32; 3],
    pub volume_first: u32,
    pub sun_illuminance: [f32; 3],
    pub volume_count: u32,
    pub ambient: [f32; 3],
    pub steps_scale: f32,
    pub size: [u32; 2],
    pub origin: [u32; 2],
}

/// Where the traced picture goes in the target.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Placement {
    pub origin: [u32; 2],
    pub size: [u32; 2],
}
