//! The uniform of a view: the struct `View` of the shaders.

use bevy::diagnostic::FrameCount;
use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy::render::camera::TemporalJitter;
use vdb_core::view::ViewRays;

use crate::VdbOverlays;
use crate::render::extract::ExtractedSuns;
use crate::render::gpu::{golden, types};

/// The largest factor of a sun's illuminance.
const MAX_FACTOR: f32 = 1e6;

/// The part of the uniform with the rays and suns of a view.
pub(crate) fn view_data(
    rays: &ViewRays,
    world_from_view: DAffine3,
    suns: &ExtractedSuns,
) -> types::View {
    let mut own = [[0.0; 4]; types::MAX_SUNS];
    let mut disks = [[0.0; 4]; types::MAX_SUNS];
    for ((own, disk), sun) in own.iter_mut().zip(&mut disks).zip(&suns.0) {
        *own = sun.direction.extend(sun.factor.min(MAX_FACTOR)).to_array();
        *disk = [(0.5 * sun.angular_diameter).tan(), sun.samples as f32, 0.0, 0.0];
    }
    let world = |v| world_from_view.transform_vector3(v).as_vec3().to_array();
    types::View {
        t_from_depth: rays.t_from_depth.map(|x| x as f32),
        depth_from_t: rays.depth_from_t.map(|x| x as f32),
        dir: world(rays.dir),
        dir_x: world(rays.dir_x),
        dir_y: world(rays.dir_y),
        eye: world_from_view.transform_point3(rays.eye).as_vec3().to_array(),
        eye_x: world(rays.eye_x),
        eye_y: world(rays.eye_y),
        t_near: rays.t_near as f32,
        t_far: rays.t_far as f32,
        suns: own,
        disks,
        sun_count: suns.0.len().min(types::MAX_SUNS) as u32,
        ..default()
    }
}

/// The offset that a frame adds to random numbers, from 0 to 1; 0 unless the view is jittered, so
/// that noise stays fixed where nothing averages frames.
pub(crate) fn random_offset(jitter: Option<&TemporalJitter>, frame: FrameCount) -> f32 {
    jitter.map_or(0.0, |_| golden(frame.0))
}

pub(super) fn overlay_bits(overlays: VdbOverlays) -> u32 {
    u32::from(overlays.leaves) | u32::from(overlays.lower) << 1 | u32::from(overlays.upper) << 2
}
