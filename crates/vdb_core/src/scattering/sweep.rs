//! Sweeps: light of each direction follows its way through the lattice, from cell to cell.

use glam::{IVec3, UVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::lattice::count;
use super::medium::Medium;

/// Light that travels in one direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Direction {
    /// From a cell to the next one on the way: -1, 0 or 1 along each axis.
    pub step: IVec3,
    /// Steradians.
    pub weight: f32,
}

impl Direction {
    /// `(1, O)` with the unit vector O: the dot product with the moments of a source is the source in this
    /// direction.
    pub fn moments(&self) -> Vec4 {
        let way = self.step.as_vec3().normalize();
        Vec4::new(1.0, way.x, way.y, way.z)
    }
}

/// The 14 points of Lebedev (1976), which integrate polynomials up to the fifth degree exactly: the axes
/// (4π/15) and the space diagonals (3π/10). Light goes straight from cell to cell in all of them.
pub(super) fn directions() -> Vec<Direction> {
    let steps = (0..27).map(|i| IVec3::new(i % 3, i / 3 % 3, i / 9) - 1);
    let weighted = steps.filter_map(|step| match step.length_squared() {
        1 => Some(Direction { step, weight: 4.0 * std::f32::consts::PI / 15.0 }),
        3 => Some(Direction { step, weight: 3.0 * std::f32::consts::PI / 10.0 }),
        _ => None,
    });
    weighted.collect()
}

/// The shares of an intensity that come from the intensity and the source one step before, and from the
/// source in the cell.
#[derive(Clone, Copy, Debug, Default)]
struct Transfer {
    passed: f32,
    before: f32,
    here: f32,
}

impl Transfer {
    /// Over an optical depth, for a source that is linear in it: with `A = (1 - e) / D`, the integral of the
    /// source is `(A - e) before + (1 - A) here`.
    fn over(depth: f32) -> Self {
        let passed = (-depth).exp();
        let mean = match depth < 1e-3 {
            true => 1.0 - 0.5 * depth + depth * depth / 6.0,
            false => (1.0 - passed) / depth,
        };
        Self { passed, before: mean - passed, here: 1.0 - mean }
    }

    /// From outside, where it is dark, half a cell to the middle of the first one, whose source it has.
    fn into(depth: f32) -> Self {
        Self { passed: 0.0, before: 0.0, here: 1.0 - (-depth).exp() }
    }
}

/// All light of one direction.
struct Beam {
    direction: Direction,
    transfers: Vec<Transfer>,
    source: Vec<f32>,
    /// Radiance in the middle of each cell.
    intensity: Vec<f32>,
}

/// The indices along an axis in the order in which light meets them.
fn ordered(cells: u32, step: i32) -> impl Iterator<Item = i32> {
    let cells = cells as i32;
    (0..cells).map(move |i| if step < 0 { cells - 1 - i } else { i })
}

impl Beam {
    fn new(direction: Direction, medium: &Medium) -> Self {
        let mut transfers = vec![Transfer::default(); count(medium.size)];
        let length = direction.step.as_vec3().length();
        let mean = |a: f32, b: f32| length * (0.5 * a + 0.5 * b);
        visit(direction.step, medium.size, |at, before| {
            let here = medium.thickness[at];
            transfers[at] = match before {
                Some(before) => Transfer::over(mean(medium.thickness[before], here)),
                None => Transfer::into(mean(0.0, here)),
            };
        });
        let zeros = vec![0.0; count(medium.size)];
        Self { direction, transfers, source: zeros.clone(), intensity: zeros }
    }

    fn sweep(&mut self, size: UVec3, sources: &[Vec4]) {
        let moments = self.direction.moments();
        for (source, all) in self.source.iter_mut().zip(sources) {
            *source = all.dot(moments);
        }
        let (transfers, source, intensity) = (&self.transfers, &self.source, &mut self.intensity);
        visit(self.direction.step, size, |at, before| {
            let transfer = transfers[at];
            // Of light from outside, the cell itself counts with weights of 0.
            let before = before.unwrap_or(at);
            intensity[at] = transfer.passed * intensity[before]
                + transfer.before * source[before]
                + transfer.here * source[at];
        });
    }
}

/// Calls `visit` for each cell after the one from which light comes to it, with the index of both; the latter
/// is `None` at the border.
fn visit(step: IVec3, size: UVec3, mut visit: impl FnMut(usize, Option<usize>)) {
    let size_i = size.as_ivec3();
    let offset = (step.z * size_i.y + step.y) * size_i.x + step.x;
    for z in ordered(size.z, step.z) {
        for y in ordered(size.y, step.y) {
            let row = (z * size_i.y + y) * size_i.x;
            let is_row =
                (0..size_i.y).contains(&(y - step.y)) && (0..size_i.z).contains(&(z - step.z));
            for x in ordered(size.x, step.x) {
                let before = is_row && (0..size_i.x).contains(&(x - step.x));
                visit((row + x) as usize, before.then_some((row + x - offset) as usize));
            }
        }
    }
}

/// Light and fog on a lattice of one level of detail.
pub(super) struct Level {
    size: UVec3,
    beams: Vec<Beam>,
    /// `e1 (1, S)`: the moments of the light that arrives unscattered, with its direction of travel S.
    arriving: Vec<Vec4>,
    sources: Vec<Vec4>,
}

impl Level {
    /// For the directions, and the direction of travel of light that arrives, a unit vector.
    pub fn new(medium: &Medium, directions: &[Direction], travel: Vec3) -> Self {
        let moments = Vec4::new(1.0, travel.x, travel.y, travel.z);
        let beams = directions.par_iter().map(|direction| Beam::new(*direction, medium)).collect();
        Self {
            size: medium.size,
            beams,
            arriving: medium.arriving.iter().map(|arriving| arriving * moments).collect(),
            sources: vec![Vec4::ZERO; count(medium.size)],
        }
    }

    /// One sweep of all directions: `(φ, F)` of light that was scattered once more than that which arrives
    /// and that of `light`, which is moved towards it by a factor.
    ///
    /// `scattering` are the factors from the moments of light to those of the source,
    /// `ω′ / 4π (1, 3g′, 3g′, 3g′)`.
    pub fn sweep(&mut self, light: &mut [Vec4], scattering: Vec4, factor: f32) {
        let size = self.size;
        for ((source, light), arriving) in self.sources.iter_mut().zip(&*light).zip(&self.arriving)
        {
            *source = scattering * (light + arriving);
        }
        let sources = &self.sources;
        self.beams.par_iter_mut().for_each(|beam| beam.sweep(size, sources));
        let weights: Vec<Vec4> = self
            .beams
            .iter()
            .map(|beam| beam.direction.weight * beam.direction.moments())
            .collect();
        light.par_iter_mut().with_min_len(4096).enumerate().for_each(|(at, light)| {
            let beams = self.beams.iter().zip(&weights);
            let swept: Vec4 = beams.map(|(beam, weight)| beam.intensity[at] * weight).sum();
            *light += factor * (swept - *light);
        });
    }

    /// The radiance in the middle of each cell in a direction, after a sweep.
    #[cfg(test)]
    pub fn intensity(&self, direction: usize) -> &[f32] {
        &self.beams[direction].intensity
    }
}
