//! The first crossing of the iso-value by the trilinear interpolant: the twin of
//! `assets/shaders/traversal/smooth.wgsl`, in f64.

use glam::IVec3;

use super::cubic::Cubic;
use super::index_ray::{IndexHit, IndexRay, nearest_voxel};
use super::local_ray::LocalRay;
use super::samples::Samples;
use crate::pack::PackedGrid;

/// The first root of the interpolant minus `iso` on a ray.
pub(super) fn first_root(
    grid: &PackedGrid,
    samples: &mut Samples,
    local: &LocalRay,
    iso: f64,
    ray: &IndexRay,
) -> Option<IndexHit> {
    // The end of the previous cell and whether the interpolant was negative there: a change of sign
    // exactly between two cells is a root, too.
    let mut before: Option<(f64, bool)> = None;
    for passage in local.spans(grid) {
        let corners = samples.of_passage(grid, &passage)?;
        let [low, high] = passage.t;
        let f = passage.thirds().map(|t| corners.at(passage.at(t)) - iso);
        let negative = f[0] < 0.0;
        // Both ends are computed from the plane between the two cells.
        let joined = before.filter(|(end, _)| low <= *end);
        before = Some((high, f[3] < 0.0));
        let s = match joined {
            Some((_, was)) if was != negative => 0.0,
            // The cubic at its end may differ in the last place from the value there.
            _ => match Cubic::through(f).first_change() {
                Some(s) => s,
                None if (f[3] < 0.0) != negative => 1.0,
                None => continue,
            },
        };
        let at = low + (high - low) * s;
        let t = local.t_from_dda(at);
        return Some(IndexHit {
            t,
            ijk: IVec3::from_array(nearest_voxel(ray.at(t))),
            normal: corners.gradient(passage.at(at)),
            begins_inside: false,
        });
    }
    None
}
