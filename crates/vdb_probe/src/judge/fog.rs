//! How much light passes through fog.

use vdb_core::reference::Fog;
use vdb_core::reference::standard::{self, Upper};

use super::scene::{Scene, reproduced};
use super::tally::Tally;
use crate::probe::{ProbeHit, ProbeRay};

/// How far a transmittance may be off, absolute.
pub const TRANSMITTANCE: f64 = 1e-3;
/// The same of a homogeneous medium.
pub const HOMOGENEOUS: f64 = 1e-4;

/// Optical depths of a grid from end to end, at its greatest density. Every ray is judged at each of
/// them.
const DEPTHS: [f64; 7] = [1e-9, 1e-3, 1.0, 10.0, 1e3, 1e6, 1e9];
/// A ray's optical depth is right to this part of the grid's depth from end to end.
const DEPTH: f64 = 1.0 / (1 << 21) as f64;
/// The depth of a grid beyond which that alone can change the transmittance of thin edges by about a
/// thousandth.
const DENSE: f64 = 2e3;

/// What judges the answers about a grid.
pub struct Judge<'a> {
    scene: &'a Scene<'a>,
    fog: Fog<'a, Upper>,
    /// Extinctions per unit of density and voxel.
    scales: Vec<f64>,
    bound: f64,
}

impl<'a> Judge<'a> {
    /// The judge of a grid. `reach`: voxels from end to end.
    pub fn new(scene: &'a Scene<'a>, reach: f64, bound: f64) -> Self {
        let most = f64::from(scene.grid.majorant) * reach;
        let scales = DEPTHS.into_iter().map(|depth| depth / most).collect();
        Self { scene, fog: Fog::new(scene.tree), scales, bound }
    }

    /// Holds an answer against the reference tracer.
    pub fn judge(&self, ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally) {
        let exact = self.scene.exact(ray);
        let depth = standard::optical_depth(&self.fog, &exact);
        let mut worst = 0.0_f64;
        let mut thin = false;
        for (scale, whole) in self.scales.iter().zip(DEPTHS) {
            // As the shader does it, in f32.
            let own = (*scale as f32 * hit.optical_length).min(100.0);
            let own = f64::from((-own).exp());
            let scale = f64::from(*scale as f32);
            let error = (own - (-scale * depth.value).exp()).abs();
            let off = (f64::from(hit.optical_length) - depth.value).abs() * scale;
            if error > self.bound && whole > DENSE && off <= DEPTH * whole {
                thin = true;
            } else {
                worst = worst.max(error);
            }
        }
        tally.steep += u64::from(thin);
        tally.met += u64::from(depth.value > 0.0);
        tally.errors.add(worst);
        if worst > self.bound || !self.scene.is_sound(hit) {
            tally.wrong += 1;
            tally.show(|| format!("{}: {worst}, {hit:?}, not {depth:?}", reproduced(ray)));
        }
    }
}
