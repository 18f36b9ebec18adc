//! The reference tracer's verdict on every single answer of a [`Probe`](crate::Probe), within the
//! bounds of `docs/reference/accuracy.md`: for the accuracy suite, and for the reports of the
//! benchmark.

pub mod fog;
pub mod given;
mod scene;
pub mod smooth;
mod tally;
pub mod voxels;

use vdb_core::pack::PackKind;
use vdb_core::reference::standard::Upper;
use vdb_core::reference::{Blocky, Occupied};

pub use scene::{Scene, judged, reproduced};
pub use tally::{Errors, Tally};

use crate::probe::{ProbeHit, ProbeRay};

/// What judges the answers about one grid, whatever it is shown as.
pub enum Judge<'a> {
    /// First voxels.
    Voxels(&'a Scene<'a>, Blocky<'a, Upper>),
    /// Roots and normals.
    Smooth(smooth::Judge<'a>),
    /// Transmittances.
    Fog(fog::Judge<'a>),
}

impl<'a> Judge<'a> {
    /// The judge of a grid. `reach`: voxels of a fog from end to end.
    pub fn new(scene: &'a Scene<'a>, reach: f64) -> Self {
        match scene.grid.kind {
            PackKind::Surface { iso } => {
                Self::Voxels(scene, Blocky::new(scene.tree, Occupied::BelowIso(iso)))
            }
            PackKind::Smooth { .. } => Self::Smooth(smooth::Judge::new(scene)),
            PackKind::Fog => Self::Fog(fog::Judge::new(scene, reach, fog::TRANSMITTANCE)),
        }
    }

    /// Holds an answer against the reference tracer.
    pub fn judge(&self, ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally) {
        match self {
            Self::Voxels(scene, oracle) => voxels::judge(scene, oracle, ray, hit, tally),
            Self::Smooth(judge) => judge.judge(ray, hit, tally),
            Self::Fog(judge) => judge.judge(ray, hit, tally),
        }
    }
}
