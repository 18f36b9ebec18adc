//! What judges the answers of one grid, whatever it is shown as.

use vdb_core::pack::PackKind;
use vdb_core::reference::{Blocky, Occupied};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::Scene;
use crate::tally::Tally;
use crate::{fog, smooth, voxels};

pub enum Judge<'a> {
    Voxels(&'a Scene<'a>, Blocky<'a, crate::grids::Upper>),
    Smooth(smooth::Judge<'a>),
    Fog(fog::Judge<'a>),
}

impl<'a> Judge<'a> {
    /// `reach`: voxels of a fog from end to end.
    pub fn new(scene: &'a Scene<'a>, reach: f64) -> Self {
        match scene.grid.kind {
            PackKind::Surface { iso } => {
                Self::Voxels(scene, Blocky::new(scene.tree, Occupied::BelowIso(iso)))
            }
            PackKind::Smooth { .. } => Self::Smooth(smooth::Judge::new(scene)),
            PackKind::Fog => Self::Fog(fog::Judge::new(scene, reach, fog::TRANSMITTANCE)),
        }
    }

    pub fn judge(&self, ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally) {
        match self {
            Self::Voxels(scene, oracle) => voxels::judge(scene, oracle, ray, hit, tally),
            Self::Smooth(judge) => judge.judge(ray, hit, tally),
            Self::Fog(judge) => judge.judge(ray, hit, tally),
        }
    }
}
