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
        // In a constant tile, the samples of any cell will do.
        let corners = samples.of_passage(grid, &passage)?;
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

/// Half the distance between the two Gauss–Legendre points on an interval of length 1. They integrate
/// a cubic exactly.
const GAUSS: f64 = 0.288_675_134_594_812_9;

/// Calls `visit` for each part of the ray within a cell or a tile, in order, with its ends in units of
/// the index ray's `t` and its mean density.
pub(super) fn visit(
    grid: &PackedGrid,
    samples: &mut Samples,
    local: &LocalRay,
    t_max: f64,
    mut visit: impl FnMut([f64; 2], f64) -> ControlFlow<()>,
) {
    let t_max = (t_max - local.t_begin) * local.speed;
    for passage in local.spans(grid) {
        let Some(corners) = samples.of_passage(grid, &passage) else { return };
        let [low, high] = [passage.t[0], passage.t[1].min(t_max)];
        if low >= high {
            continue;
        }
        let at = |s: f64| corners.at(passage.at(low + (high - low) * s));
        let mean = 0.5 * (at(0.5 - GAUSS) + at(0.5 + GAUSS));
        let ends = [low, high].map(|t| local.t_from_dda(t));
        if mean > 0.0 && visit(ends, mean).is_break() {
            return;
        }
    }
}
