//! Multiple scattering in fog, by path tracing.
//!
//! A path runs against the light, from the viewer. The next scattering event is sampled by delta
//! tracking (Woodcock et al. 1965): events are sampled for a homogeneous fog of the maximum
//! density, and each is accepted with the fraction of that density at its position. Sunlight at
//! each event is estimated by ratio tracking (Novák et al. 2014, "Residual ratio tracking for
//! estimating attenuation in participating media"). Neither has a step size, and both are unbiased
//! for any number of paths; the spread of the samples gives the error.

use glam::DVec3;
use rayon::prelude::*;

use super::{cells::Corners, field::Field, fog::density, radiance::phase};
use crate::{
    synth::Random,
    tree::{Accessor, Node, Tree},
};

/// The fog and its light. Lengths are in voxels, for grids with cubic voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scattering {
    /// Extinction per voxel for a density of 1; finite and not negative. The cost of a path grows
    /// with the optical depth, and with its square if nothing is absorbed.
    pub extinction: f64,
    /// The mean cosine of the scattering angle (Henyey–Greenstein); between -1 and 1, exclusively.
    pub anisotropy: f64,
    /// The unit vector towards the sun, in index space.
    pub to_sun: DVec3,
    /// The maximum number of scattering events: 1 for what [`radiance()`](super::radiance())
    /// integrates, `u32::MAX` for all.
    pub orders: u32,
}

/// The mean of many samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    /// The mean.
    pub value: f64,
    /// Its standard error: two of three means are off by less than it, 997 of 1,000 by less than
    /// three times it.
    pub standard_error: f64,
}

/// The light that reaches the viewer, for one albedo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathLight {
    /// The scattered light of a sun with an irradiance of 1 on a surface facing it.
    pub sun: Mean,
    /// The light of surroundings with a uniform radiance of 1, including unscattered light from
    /// behind.
    pub surroundings: Mean,
}

/// Traces paths through the density of a tree.
#[derive(Debug)]
pub struct Paths<'a, C: Node<Value = f32>> {
    field: Field<'a, C>,
    /// The maximum density, and the bounds of all density.
    most: f64,
    low: DVec3,
    high: DVec3,
}

/// Paths per random sequence. Each sequence is derived from its number, so the result does not
/// depend on the number of threads.
const BATCH: u32 = 64;

/// The transmittance below which every other ray to the sun is terminated, and the others count
/// twice.
const FAINT: f64 = 0.01;

/// Sums of samples and of their squares.
type Sums = [f64; 2];

impl<'a, C: Node<Value = f32>> Paths<'a, C> {
    /// Finds the bounds and the maximum of the density; `None` for infinite fog, with density in
    /// the background.
    pub fn new(tree: &'a Tree<C>) -> Option<Self> {
        let mut paths = Self {
            field: Field::new(tree),
            most: 0.0,
            low: DVec3::INFINITY,
            high: DVec3::NEG_INFINITY,
        };
        for value in tree.values().filter(|value| density(value.value) > 0.0) {
            let bbox = value.bbox();
            paths.most = paths.most.max(density(value.value));
            // A sample contributes to all cells around it.
            paths.low = paths.low.min(bbox.min.as_dvec3() - 1.0);
            paths.high = paths.high.max(bbox.max.as_dvec3() + 1.0);
        }
        (density(tree.background()) == 0.0).then_some(paths)
    }

    /// The light along a ray to its `origin`, for several albedos: all use the same paths, so their
    /// errors are correlated. The direction is a unit vector in index space. Equal seeds give equal
    /// paths.
    pub fn light(
        &self,
        (origin, direction): (DVec3, DVec3),
        scattering: &Scattering,
        albedos: &[f64],
        paths: u32,
        seed: u64,
    ) -> Vec<PathLight> {
        let batch = |first: u32| {
            let number = u64::from(first / BATCH);
            let mut random = Random::new(seed ^ number.rotate_right(20));
            // Sequences with similar seeds begin similarly.
            for _ in 0..8 {
                random.bits();
            }
            let mut tracer = Tracer {
                paths: self,
                scattering,
                rate: scattering.extinction * self.most,
                accessor: self.field.tree().accessor(),
                random,
            };
            let mut sums = vec![[Sums::default(); 2]; albedos.len()];
            for _ in first..(first + BATCH).min(paths) {
                tracer.add(origin, direction, albedos, &mut sums);
            }
            sums
        };
        let firsts: Vec<u32> = (0..paths).step_by(BATCH as usize).collect();
        let batches: Vec<_> = firsts.into_par_iter().map(batch).collect();
        let of = |i: usize, source: usize| {
            let sum = |k: usize| batches.iter().map(|sums| sums[i][source][k]).sum::<f64>();
            let n = f64::from(paths);
            let value = sum(0) / n;
            let variance = (sum(1) / n - value * value).max(0.0);
            Mean { value, standard_error: (variance / (n - 1.0).max(1.0)).sqrt() }
        };
        let light = |i| PathLight { sun: of(i, 0), surroundings: of(i, 1) };
        (0..albedos.len()).map(light).collect()
    }

    /// The interval of a ray between the first and the last density, in voxels from the origin.
    fn span(&self, origin: DVec3, direction: DVec3) -> Option<[f64; 2]> {
        let mut span = [0.0_f64, f64::INFINITY];
        for axis in 0..3 {
            let [o, d] = [origin[axis], direction[axis]];
            if d == 0.0 {
                if o < self.low[axis] || o > self.high[axis] {
                    return None;
                }
                continue;
            }
            let [a, b] = [(self.low[axis] - o) / d, (self.high[axis] - o) / d];
            span = [span[0].max(a.min(b)), span[1].min(a.max(b))];
        }
        (span[0] < span[1]).then_some(span)
    }
}

/// Traces paths one after the other.
struct Tracer<'p, 'a, C: Node<Value = f32>> {
    paths: &'p Paths<'a, C>,
    scattering: &'p Scattering,
    /// The maximum extinction per voxel.
    rate: f64,
    accessor: Accessor<'a, C>,
    random: Random,
}

impl<C: Node<Value = f32>> Tracer<'_, '_, C> {
    /// Traces a path and adds its contribution.
    fn add(&mut self, origin: DVec3, direction: DVec3, albedos: &[f64], sums: &mut [[Sums; 2]]) {
        let Scattering { anisotropy, to_sun, orders, .. } = *self.scattering;
        // Paths continue with the probability of the greatest albedo; `left` is the relative
        // throughput for the others.
        let greatest = albedos.iter().copied().fold(0.0, f64::max);
        let mut left = vec![1.0; albedos.len()];
        let mut sun = vec![0.0; albedos.len()];
        let mut escaped = false;
        let (mut place, mut way) = (origin, direction);
        for order in 0.. {
            let Some(next) = self.next(place, way) else {
                escaped = true;
                break;
            };
            if order == orders || self.random.unit() >= greatest {
                break;
            }
            place = next;
            // With the sun straight ahead, light that is scattered forwards (cosine 1) is seen.
            let seen = phase(anisotropy, way.dot(to_sun)) * self.transmittance(place, to_sun);
            for (i, albedo) in albedos.iter().enumerate() {
                left[i] *= albedo / greatest;
                sun[i] += left[i] * seen;
            }
            way = self.turned(way, anisotropy);
        }
        for (i, sums) in sums.iter_mut().enumerate() {
            let surroundings = if escaped { left[i] } else { 0.0 };
            for (sum, light) in sums.iter_mut().zip([sun[i], surroundings]) {
                *sum = [sum[0] + light, sum[1] + light * light];
            }
        }
    }

    /// The density at a point as a fraction of the maximum.
    fn part(&mut self, place: DVec3) -> f64 {
        let cell = place.floor();
        let corners =
            self.paths.field.corners(&mut self.accessor, cell.to_array().map(|c| c as i64));
        Corners(corners.map(density)).at(place - cell) / self.paths.most
    }

    /// The distance to the next event in homogeneous fog of the maximum density.
    fn flight(&mut self) -> f64 {
        -(-self.random.unit()).ln_1p() / self.rate
    }

    /// The next scattering event of light from a point; `None` if it leaves the fog.
    fn next(&mut self, origin: DVec3, direction: DVec3) -> Option<DVec3> {
        let [mut t, end] = self.paths.span(origin, direction)?;
        loop {
            t += self.flight();
            // NaN if there is no density anywhere.
            if t.is_nan() || t >= end {
                return None;
            }
            let place = origin + t * direction;
            if self.random.unit() < self.part(place) {
                return Some(place);
            }
        }
    }

    /// A sample whose mean is the transmittance.
    fn transmittance(&mut self, origin: DVec3, direction: DVec3) -> f64 {
        let Some([mut t, end]) = self.paths.span(origin, direction) else { return 1.0 };
        let mut passed = 1.0;
        loop {
            t += self.flight();
            if t.is_nan() || t >= end {
                return passed;
            }
            passed *= 1.0 - self.part(origin + t * direction);
            if passed < FAINT {
                if self.random.unit() < 0.5 {
                    return 0.0;
                }
                passed *= 2.0;
            }
        }
    }

    /// A direction after scattering.
    fn turned(&mut self, way: DVec3, g: f64) -> DVec3 {
        let u = self.random.unit();
        // Inverts the cumulative distribution of the phase function over the cosine.
        let cosine = if g.abs() < 1e-6 {
            2.0 * u - 1.0
        } else {
            let square = ((1.0 - g * g) / (1.0 - g + 2.0 * g * u)).powi(2);
            ((1.0 + g * g - square) / (2.0 * g)).clamp(-1.0, 1.0)
        };
        let (sin, cos) = (std::f64::consts::TAU * self.random.unit()).sin_cos();
        let (x, y) = way.any_orthonormal_pair();
        let aside = (1.0 - cosine * cosine).sqrt();
        (cosine * way + aside * (cos * x + sin * y)).normalize()
    }
}
