//! Opacity of fog along a ray: the twin of `assets/shaders/traversal/fog.wgsl`, in f64.

use std::ops::ControlFlow;

use glam::IVec3;

use super::cubic::Cubic;
use super::index_ray::{IndexHit, IndexRay, nearest_voxel};
use super::local_ray::LocalRay;
use super::samples::Samples;
use crate::pack::PackedGrid;

/// The point at which `∫ density dt` passes `enough`, in units of the index ray's `t`; if that is
/// zero, the first point with any density. Along a ray the density is a cubic in each trilinear
/// cell, so there is no step size.
pub(super) fn first_opaque(
    grid: &PackedGrid,
    samples: &mut Samples,
    local: &LocalRay,
    enough: f64,
    ray: &IndexRay,
) -> Option<IndexHit> {
    let mut sum = 0.0;
    for passage in local.spans(grid) {
        let cell = passage.cell.wrapping_add(grid.base);
        // In a constant tile, the samples of any cell will do.
        let corners = samples.corners(cell.to_array().map(i64::from))?;
        let [low, high] = passage.t;
        let length = (high - low) / local.speed;
        let cubic = Cubic::through(passage.thirds().map(|t| corners.at(passage.at(t))));
        let part = length * cubic.integral();
        if part > 0.0 && sum + part >= enough {
            let s = cubic.integral_reaches((enough - sum) / length);
            let at = low + (high - low) * s;
            let t = local.t_from_dda(at);
            return Some(IndexHit {
                t,
                ijk: IVec3::from_array(nearest_voxel(ray.at(t))),
                normal: -corners.gradient(passage.at(at)),
                begins_inside: false,
            });
        }
        sum += part;
    }
    None
}

/// Calls `visit` for each part of the ray within a cell or a tile, in order, with its ends in units of
/// the index ray's `t` and its mean density.
pub(super) fn visit(
    grid: &PackedGrid,
    samples: &mut Samples,
    local: &LocalRay,
    t_max: f64,
    mut visit: impl FnMut([f64; 2], f64) -> ControlFlow<()>,
) {
    for mut passage in local.spans(grid) {
        let cell = passage.cell.wrapping_add(grid.base);
        let Some(corners) = samples.corners(cell.to_array().map(i64::from)) else { return };
        passage.t[1] = passage.t[1].min((t_max - local.t_begin) * local.speed);
        let [low, high] = passage.t;
        if low >= high {
            continue;
        }
        let mean = Cubic::through(passage.thirds().map(|t| corners.at(passage.at(t)))).integral();
        let ends = [low, high].map(|t| local.t_from_dda(t));
        if mean > 0.0 && visit(ends, mean).is_break() {
            return;
        }
    }
}
