//! From this frame to the previous one, for Bevy's motion vectors.

use bevy::core_pipeline::prepass::PreviousViewData;
use bevy::math::{DAffine3, DMat4, DVec3, DVec4};
use bevy::prelude::*;
use bevy::render::render_resource::Buffer;
use bevy::render::view::ExtractedView;

use crate::render::extract::{ExtractedVelocity, ExtractedVolume};
use crate::render::gpu::{affine, types};

/// The most means of all volumes: 32 MiB, a quarter of what WebGPU lets a binding have by default.
const MOST_MEANS: usize = 1 << 22;

/// The buffers that motion vectors are computed from.
pub(crate) struct MotionBuffers {
    /// Of [`Clips::matrices`].
    pub matrices: Buffer,
    /// Of [`Clips::velocities`].
    pub of_velocities: Option<[Buffer; 2]>,
}

/// The clip spaces of a view in this frame and the previous one.
///
/// If neither the view nor a volume has moved, the matrices are equal bit for bit: for both frames,
/// `view_from_world` is rounded to f32 as Bevy rounds it for [`PreviousViewData`].
pub(super) struct Clips {
    /// From the clip space of the view's rays, with jitter.
    world_from_clip: DMat4,
    /// To the clip space of this frame, without jitter.
    now_from_world: DMat4,
    /// To that of the previous frame.
    then_from_world: DMat4,
}

impl Clips {
    pub fn new(
        view: &ExtractedView,
        clip_from_view: Mat4,
        before: Option<&PreviousViewData>,
    ) -> Self {
        let world_from_view = view.world_from_view.affine();
        let world_from_clip =
            DMat4::from(affine(world_from_view)) * clip_from_view.as_dmat4().inverse();
        let clip_from_world = |clip_from_view: Mat4, view_from_world: Mat4| {
            clip_from_view.as_dmat4() * view_from_world.as_dmat4()
        };
        let now_from_world =
            clip_from_world(view.clip_from_view, Mat4::from(world_from_view.inverse()));
        let then_from_world = before.map_or(now_from_world, |before| {
            clip_from_world(before.clip_from_view, before.view_from_world)
        });
        Self { world_from_clip, now_from_world, then_from_world }
    }

    /// Matrices from the clip space of the view's rays: first to the clip space of this frame, then,
    /// for each visible volume, to that of the previous frame.
    pub fn matrices(&self, volumes: &[&ExtractedVolume]) -> Vec<Mat4> {
        let of_volume = |volume: &&ExtractedVolume| {
            let moved = way_back(volume)
                .map_or(self.world_from_clip, |way| DMat4::from(way) * self.world_from_clip);
            (self.then_from_world * moved).as_mat4()
        };
        let mut matrices = Vec::with_capacity(1 + volumes.len());
        matrices.push((self.now_from_world * self.world_from_clip).as_mat4());
        matrices.extend(volumes.iter().map(of_volume));
        matrices
    }

    /// The velocities within each visible volume, and the means of their lattices: at least one, as
    /// a binding cannot be empty, and at most [`MOST_MEANS`], beyond which nothing moves.
    pub fn velocities(
        &self,
        volumes: &[&ExtractedVolume],
    ) -> (Vec<types::Velocities>, Vec<[u32; 2]>) {
        let mut means = Vec::new();
        let of_volume = |volume: &&ExtractedVolume| {
            let velocity = volume.velocity.as_ref().filter(|own| {
                own.displacement != 0.0 && means.len() + own.lattice.means.len() <= MOST_MEANS
            });
            velocity.map_or_else(types::Velocities::default, |velocity| {
                let first = means.len() as u32;
                means.extend_from_slice(&velocity.lattice.means);
                self.velocities_of(volume, velocity, first)
            })
        };
        let velocities = volumes.iter().map(of_volume).collect();
        means.resize(means.len().max(1), [0; 2]);
        (velocities, means)
    }

    fn velocities_of(
        &self,
        volume: &ExtractedVolume,
        velocity: &ExtractedVelocity,
        first: u32,
    ) -> types::Velocities {
        let lattice = &velocity.lattice;
        let edge = (1_u64 << lattice.log2_edge) as f64;
        // The middle of the first cube, whose voxels are points.
        let middle = lattice.origin.as_dvec3() + 0.5 * (edge - 1.0);
        let lattice_from_index =
            DAffine3::from_scale(DVec3::splat(edge.recip())) * DAffine3::from_translation(-middle);
        let lattice_from_local = lattice_from_index * velocity.local_from_index.inverse();
        let lattice_from_world = lattice_from_local * affine(volume.world_from_local).inverse();
        let then_from_local = affine(volume.world_from_local_before).matrix3;
        let column = |axis: DVec3| {
            let displacement = then_from_local * axis * velocity.displacement;
            self.then_from_world * DVec4::from((displacement, 0.0))
        };
        let lattice_from_clip = DMat4::from(lattice_from_world) * self.world_from_clip;
        types::Velocities {
            lattice_from_clip: lattice_from_clip.as_mat4().to_cols_array_2d(),
            clip_from_mean: DVec3::AXES.map(|axis| column(axis).as_vec4().to_array()),
            size: lattice.size.to_array(),
            first,
        }
    }
}

/// The transform from a volume's current position to the previous one; `None` if it has not moved.
fn way_back(volume: &ExtractedVolume) -> Option<DAffine3> {
    let (now, then) = (volume.world_from_local, volume.world_from_local_before);
    (now != then).then(|| affine(then) * affine(now).inverse())
}
