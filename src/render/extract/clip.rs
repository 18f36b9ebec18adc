//! The clip planes that cut volumes.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::DVec3;
use bevy::prelude::*;

use crate::render::gpu::types;
use crate::scene::ClipPlane;
use crate::{VdbClipPlane, VdbClippedBy};

/// The planes in use, each once, in the order of their bits.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct ExtractedClipPlanes(Vec<(Entity, ClipPlane)>);

/// The clip planes of a volume.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct VolumeClip {
    /// Its planes, a bit each.
    pub planes: u32,
    /// Identifies these planes and their places; 0 without any.
    pub content: u64,
    /// Whether there is no bit left for one of its planes.
    pub has_too_many: bool,
}

impl ExtractedClipPlanes {
    pub(super) fn begin_frame(&mut self) {
        self.0.clear();
    }

    /// Adds the planes of a volume.
    pub(super) fn add(
        &mut self,
        clipped_by: &VdbClippedBy,
        transforms: &Query<&GlobalTransform, With<VdbClipPlane>>,
    ) -> VolumeClip {
        let mut clip = VolumeClip::default();
        let mut content = DefaultHasher::new();
        for &entity in &clipped_by.0 {
            let Ok(transform) = transforms.get(entity) else { continue };
            let Some(plane) = ClipPlane::new(transform) else { continue };
            let known = self.0.iter().position(|(own, _)| *own == entity);
            let bit = known.unwrap_or(self.0.len());
            if bit >= types::MAX_CLIP_PLANES {
                clip.has_too_many = true;
                continue;
            }
            if known.is_none() {
                self.0.push((entity, plane));
            }
            clip.planes |= 1 << bit;
            [plane.point, plane.kept].map(|v| v.to_array().map(f64::to_bits)).hash(&mut content);
        }
        if clip.planes != 0 {
            clip.content = content.finish();
        }
        clip
    }

    /// The planes for the shaders of a view with its eye at a point in world space: those of the bits in
    /// `used`. Others are left out, so that the data changes only with what the view sees.
    pub fn data(&self, used: u32, eye: DVec3) -> [[f32; 4]; types::MAX_CLIP_PLANES] {
        let mut data = [[0.0; 4]; types::MAX_CLIP_PLANES];
        let all = data.iter_mut().zip(&self.0).enumerate();
        for (_, (data, (_, plane))) in all.filter(|(bit, _)| used >> bit & 1 != 0) {
            let distance = plane.distance(eye) as f32;
            let distance = distance.clamp(-types::FARTHEST, types::FARTHEST);
            *data = plane.kept.as_vec3().extend(distance).to_array();
        }
        data
    }
}
