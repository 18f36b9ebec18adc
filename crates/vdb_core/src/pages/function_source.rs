//! Pages of a signed distance that is evaluated where a page needs it.

use glam::{DAffine3, DVec3, IVec3};

use super::format::MOST_LEVELS;
use super::index::scale;
use super::source::PageSource;
use crate::Error;
use crate::pack::PackKind;
use crate::synth::{Uniform, build};
use crate::tree::{CoordBox, Vdb543};

/// Samples on either side of the surface whose distances are kept.
const HALF_BAND: f64 = 3.0;
/// The farthest from the origin that a box may reach, in samples.
const FARTHEST: f64 = 1e9;
/// The most cubes of the size of a page in a box: each takes an evaluation of the function.
const MOST_CUBES: f64 = 1e8;

/// A surface given by a function, for pages: memory is needed for a few pages only, whatever the size
/// of the whole.
///
/// The function returns the signed distance to the surface from a point, both in index space of the
/// finest level; negative is inside. Its magnitude may underestimate the distance but must never
/// exceed it, and its slope must not exceed 1: whole cubes are skipped where the magnitude is large.
/// Divide a function that is steeper by its largest slope.
///
/// Coarser levels evaluate the function at their own samples. Time is roughly proportional to the
/// area of the surface, plus one evaluation for each cube of the size of a page in `bounds`, at every
/// level.
pub struct FunctionSource<F> {
    name: String,
    world_from_index: DAffine3,
    bounds: [DVec3; 2],
    distance: F,
}

impl<F: Fn(DVec3) -> f64 + Sync> FunctionSource<F> {
    /// The source of a function's pages, of the surface within `bounds`, the low and the high corner
    /// of a box in index space of the finest level. Everything outside of the box is outside of the
    /// surface. The box ends at a billion samples from the origin at the latest.
    pub fn new(
        name: impl Into<String>,
        world_from_index: DAffine3,
        bounds: [DVec3; 2],
        distance: F,
    ) -> Self {
        let far = DVec3::splat(FARTHEST);
        let bounds = bounds.map(|corner| corner.clamp(-far, far));
        Self { name: name.into(), world_from_index, bounds, distance }
    }

    /// The samples of a level in the box; `None` if there are none.
    fn samples_inside(&self, level: u32) -> Option<CoordBox> {
        let [low, high] = self.bounds.map(|corner| corner / scale(level));
        let all = CoordBox { min: low.ceil().as_ivec3(), max: high.floor().as_ivec3() };
        let is_sound = low.is_finite() && high.is_finite();
        (is_sound && all.min.cmple(all.max).all()).then_some(all)
    }

    /// The distance at the middle of a box of samples of a level, and from there to its corners.
    fn around(&self, level: u32, samples: CoordBox) -> (f64, f64) {
        let [min, max] = [samples.min, samples.max].map(|corner| corner.as_dvec3() * scale(level));
        let middle = (min + max) / 2.0;
        ((self.distance)(middle), (max - middle).length())
    }
}

impl<F: Fn(DVec3) -> f64 + Sync> PageSource for FunctionSource<F> {
    fn name(&self) -> &str {
        &self.name
    }

    fn kind(&self) -> PackKind {
        PackKind::Surface { iso: 0.0 }
    }

    fn world_from_index(&self) -> DAffine3 {
        self.world_from_index
    }

    fn levels(&self) -> u32 {
        MOST_LEVELS
    }

    fn pages(&self, level: u32, edge: u32, kind: PackKind) -> Result<Vec<IVec3>, Error> {
        let Some(all) = self.samples_inside(level) else { return Ok(Vec::new()) };
        let edge = edge as i32;
        let is_smooth = matches!(kind, PackKind::Smooth { .. });
        let min = (all.min - i32::from(is_smooth)).to_array().map(|c| c.div_euclid(edge));
        let max = all.max.to_array().map(|c| c.div_euclid(edge));
        let cubes = (0..3).map(|i| i64::from(max[i]) - i64::from(min[i]) + 1).map(|n| n as f64);
        if cubes.product::<f64>() > MOST_CUBES {
            let what = format!("a box of more than {MOST_CUBES} pages of one level");
            return Err(Error::not_supported(what));
        }
        let mut pages = Vec::new();
        for x in min[0]..=max[0] {
            for y in min[1]..=max[1] {
                for z in min[2]..=max[2] {
                    let at = IVec3::new(x, y, z);
                    let samples = CoordBox { min: at * edge, max: at * edge + edge };
                    // A smooth surface closes where the box cuts it.
                    let is_whole = all.intersection(samples) == Some(samples);
                    let (distance, reach) = self.around(level, samples);
                    let is_outside = distance > reach;
                    let is_inside = distance < -reach;
                    if !(is_outside || is_inside && is_smooth && is_whole) {
                        pages.push(at);
                    }
                }
            }
        }
        Ok(pages)
    }

    fn samples(&self, level: u32, bounds: CoordBox) -> Result<Vdb543<f32>, Error> {
        let (step, band) = (scale(level), HALF_BAND * scale(level));
        let background = band as f32;
        let inside = self.samples_inside(level).and_then(|all| all.intersection(bounds));
        let Some(inside) = inside else { return Ok(Vdb543::new(background)) };
        let uniform = |cube: CoordBox| {
            let (distance, reach) = self.around(level, cube);
            match () {
                () if distance >= band + reach => Uniform::Yes(background, false),
                () if distance <= -band - reach => Uniform::Yes(-background, false),
                () => Uniform::No,
            }
        };
        let voxel = |ijk: IVec3| {
            let distance = (self.distance)(ijk.as_dvec3() * step) as f32;
            (distance.clamp(-background, background), distance.abs() < background)
        };
        Ok(build(background, inside, uniform, voxel))
    }
}
