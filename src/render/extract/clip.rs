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

#[cfg(test)]
mod tests {
    use bevy::ecs::system::SystemState;

    use super::*;

    /// Bits go to planes in the order in which volumes name them, once each; those beyond the last bit do not cut.
    #[test]
    fn planes_beyond_the_last_bit_do_not_cut() {
        let mut world = World::new();
        let planes: Vec<Entity> = (0..types::MAX_CLIP_PLANES + 1)
            .map(|i| {
                let at = GlobalTransform::from_translation(Vec3::Y * i as f32);
                world.spawn((VdbClipPlane, at)).id()
            })
            .collect();
        let mut state = SystemState::<Query<&GlobalTransform, With<VdbClipPlane>>>::new(&mut world);
        let transforms = state.get(&world).unwrap();
        let mut own = ExtractedClipPlanes::default();
        let few = own.add(&VdbClippedBy(vec![planes[2], planes[0]]), &transforms);
        assert_eq!((few.planes, few.has_too_many), (0b11, false));
        let all = own.add(&VdbClippedBy(planes.clone()), &transforms);
        assert_eq!((all.planes, all.has_too_many), (u32::MAX, true));
        let last = own.add(&VdbClippedBy(planes[types::MAX_CLIP_PLANES..].to_vec()), &transforms);
        assert_eq!((last.planes, last.content, last.has_too_many), (0, 0, true));

        let data = own.data(0b10, DVec3::Y * 5.0);
        assert_eq!(data[0], [0.0; 4], "a plane that is not in use");
        assert_eq!(data[1], [0.0, -1.0, 0.0, -5.0], "what is below the plane y = 0 is kept");

        own.begin_frame();
        let again = own.add(&VdbClippedBy(vec![planes[0], planes[2]]), &transforms);
        assert_ne!(again.content, few.content, "the order of planes");
        assert_eq!(again.planes, 0b11);
    }
}
