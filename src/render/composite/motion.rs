//! Matrices to the previous frame, for Bevy's motion vectors.

use bevy::core_pipeline::prepass::PreviousViewData;
use bevy::math::{DAffine3, DMat4};
use bevy::prelude::*;
use bevy::render::view::ExtractedView;

use crate::render::extract::ExtractedVolume;
use crate::render::gpu::affine;

/// Matrices from the clip space of a view's rays, with jitter: first to the clip space of this
/// frame without jitter, then, for each visible volume, to that of the previous frame.
///
/// If neither the view nor a volume has moved, the matrices are equal bit for bit: for both frames,
/// `view_from_world` is rounded to f32 as Bevy rounds it for [`PreviousViewData`].
pub(super) fn matrices<'a>(
    view: &ExtractedView,
    clip_from_view: Mat4,
    before: Option<&PreviousViewData>,
    volumes: impl Iterator<Item = &'a ExtractedVolume>,
) -> Vec<Mat4> {
    let world_from_view = view.world_from_view.affine();
    let world_from_clip =
        DMat4::from(affine(world_from_view)) * clip_from_view.as_dmat4().inverse();
    let clip_from_world = |clip_from_view: Mat4, view_from_world: Mat4| {
        clip_from_view.as_dmat4() * view_from_world.as_dmat4()
    };
    let now = clip_from_world(view.clip_from_view, Mat4::from(world_from_view.inverse()));
    let then =
        before.map_or(now, |before| clip_from_world(before.clip_from_view, before.view_from_world));
    let of_volume = |volume: &ExtractedVolume| {
        let moved =
            way_back(volume).map_or(world_from_clip, |way| DMat4::from(way) * world_from_clip);
        (then * moved).as_mat4()
    };
    let mut matrices = Vec::with_capacity(1 + volumes.size_hint().0);
    matrices.push((now * world_from_clip).as_mat4());
    matrices.extend(volumes.map(of_volume));
    matrices
}

/// The transform from a volume's current position to the previous one; `None` if it has not moved.
fn way_back(volume: &ExtractedVolume) -> Option<DAffine3> {
    let (now, then) = (volume.world_from_local, volume.world_from_local_before);
    (now != then).then(|| affine(then) * affine(now).inverse())
}
