//! The parts of the solver against closed forms, conservation of energy, and symmetry.

use std::f64::consts::PI;

use glam::{DVec3, UVec3, Vec3, Vec4};

use super::chebyshev::relaxation_factors;
use super::lattice::{cells, count, index};
use super::medium::Medium;
use super::octants::{FogOctants, FogSample};
use super::solution::{Optics, ScatteredLight};
use super::sweep::{Level, directions};
use super::{Lattice, Phase};
use crate::synth::Random;

/// In a homogeneous box with a constant source, each ray from the border has a closed form.
#[test]
fn light_builds_up_along_each_direction_in_even_fog() {
    let size = UVec3::new(7, 5, 4);
    let (depth, source) = (0.37_f32, 0.2_f32);
    let even =
        Medium { size, thickness: vec![depth; count(size)], arriving: vec![1.0; count(size)] };
    let mut level = Level::new(&even, &directions(), Vec3::X);
    level.sweep(&mut vec![Vec4::ZERO; count(size)], Vec4::X * source, 1.0);
    for (m, direction) in directions().iter().enumerate() {
        let length = direction.step.as_vec3().length();
        for cell in cells(size) {
            let passed = (0..3).filter_map(|axis| match direction.step[axis] {
                0 => None,
                1 => Some(cell[axis]),
                _ => Some(size[axis] - 1 - cell[axis]),
            });
            let passed = passed.min().unwrap() as f32 + 0.5;
            let expected = source * (1.0 - (-depth * length * passed).exp());
            let found = level.intensity(m)[index(cell, size)];
            // A few roundings of numbers below 0.2.
            assert!((found - expected).abs() < 1e-6, "{direction:?} at {cell}: {found}");
        }
    }
}

/// 14 directions integrate polynomials up to the fifth degree over the sphere.
#[test]
fn directions_have_the_moments_of_the_sphere() {
    let mean = |f: &dyn Fn(Vec3) -> f32| {
        let sum =
            directions().iter().map(|d| d.weight * f(d.step.as_vec3().normalize())).sum::<f32>();
        f64::from(sum) / (4.0 * PI)
    };
    let moments: [(&dyn Fn(Vec3) -> f32, f64); 6] = [
        (&|_| 1.0, 1.0),
        (&|o| o.x, 0.0),
        (&|o| o.y * o.y, 1.0 / 3.0),
        (&|o| o.x * o.z, 0.0),
        (&|o| o.z.powi(4), 0.2),
        (&|o| o.x * o.x * o.y * o.y, 1.0 / 15.0),
    ];
    for (i, (moment, expected)) in moments.into_iter().enumerate() {
        assert!((mean(moment) - expected).abs() < 1e-6, "moment {i}: {}", mean(moment));
    }
}

/// A ball of radius 1, densest in the middle, with two derivatives at its surface: `(1 - r²)²`.
fn ball(at: DVec3) -> f64 {
    (1.0 - at.length_squared()).max(0.0).powi(2)
}

/// The integral of the ball's density from a point towards the light.
fn ball_depth(at: DVec3, to_light: DVec3) -> f64 {
    let along = at.dot(to_light);
    let c = 1.0 - (at - along * to_light).length_squared();
    if c <= 0.0 {
        return 0.0;
    }
    let integral = |s: f64| c * c * s - 2.0 / 3.0 * c * s.powi(3) + 0.2 * s.powi(5);
    integral(c.sqrt()) - integral(along.clamp(-c.sqrt(), c.sqrt()))
}

fn ball_octants(longest: u32, to_light: DVec3) -> FogOctants {
    FogOctants::new(Lattice::around([DVec3::splat(-1.0), DVec3::splat(1.0)], longest), |at| {
        FogSample { extinction: ball(at) as f32, depth: ball_depth(at, to_light) as f32 }
    })
}

/// What leaves and what is absorbed, relative to the light of a sun that enters the ball.
fn balance(longest: u32, extinction: f64, albedo: f64) -> f64 {
    let to_light = DVec3::new(0.3, -0.5, 0.8).normalize();
    let octants = ball_octants(longest, to_light);
    let medium = Medium::new(&octants, extinction as f32, 1.0);
    let mut light = vec![Vec4::ZERO; count(medium.size)];
    let mut level = Level::new(&medium, &directions(), -to_light.as_vec3());
    let scattering = Vec4::X * (albedo / (4.0 * PI)) as f32;
    for factor in relaxation_factors(12, [0.02, 1.0]).repeat(4) {
        level.sweep(&mut light, scattering, factor);
    }
    // Makes the intensities those of the converged light.
    level.sweep(&mut light, scattering, 1.0);
    let face = octants.lattice.edge.powi(2);
    let mut left = 0.0;
    for (m, direction) in directions().iter().enumerate() {
        let leaves = |cell: UVec3| {
            let next = cell.as_ivec3() + direction.step;
            next.cmplt(glam::IVec3::ZERO).any() || next.cmpge(medium.size.as_ivec3()).any()
        };
        // The cross-section of a line of cells.
        let section = face / f64::from(direction.step.as_vec3().length());
        for cell in cells(medium.size).filter(|cell| leaves(*cell)) {
            let intensity = level.intensity(m)[index(cell, medium.size)];
            left += section * f64::from(direction.weight * intensity);
        }
    }
    let lost = medium.thickness.iter().zip(&medium.arriving).zip(&light);
    let absorbed = lost.map(|((thickness, arriving), light)| {
        (1.0 - albedo) * face * f64::from(thickness * (arriving + light.x))
    });
    // All rays of the sun, by their distance from the middle.
    let steps = 2000;
    let entered = (0..steps).map(|i| {
        let distance = (f64::from(i) + 0.5) / f64::from(steps);
        let through = 16.0 / 15.0 * (1.0 - distance * distance).powf(2.5);
        2.0 * PI * distance / f64::from(steps) * (1.0 - (-extinction * through).exp())
    });
    (left + absorbed.sum::<f64>()) / entered.sum::<f64>()
}

/// No energy is made or lost, but for discretisation, which is of the second order: sources are linear
/// between cells, and a cell counts with its middle.
#[test]
fn energy_is_conserved_to_second_order() {
    for (extinction, albedo) in [(1.0, 1.0), (4.0, 1.0), (4.0, 0.8), (4.0, 0.0), (12.0, 1.0)] {
        let errors = [8, 16, 32].map(|longest| balance(longest, extinction, albedo) - 1.0);
        println!("{extinction}, {albedo}: {errors:.5?}");
        // Halving the cells quarters the error, or nearly, while cells are deep; where errors of either sign
        // cancel, it is small anyway.
        let [coarse, middle, fine] = errors.map(f64::abs);
        assert!(fine < 0.005 && (coarse < 0.01 || middle < coarse / 3.0 && fine < middle / 3.0));
    }
}

/// Octants of random density, and random depths towards the light.
fn noise(seed: u64) -> (Lattice, Vec<FogSample>) {
    // Even numbers of cells on all levels, so that all are in the middle of the finest one.
    let lattice = Lattice { low: DVec3::splat(-4.0), edge: 1.0, size: UVec3::splat(8) };
    let mut random = Random::new(seed);
    let mut unit = || random.unit() as f32;
    let sample = |_| FogSample { extinction: (4.0 * unit() - 2.0).max(0.0), depth: 3.0 * unit() };
    (lattice, (0..16 * 16 * 16).map(sample).collect())
}

/// No axis and no side is preferred: a mirrored or turned fog scatters mirrored or turned light.
#[test]
fn all_axes_and_both_sides_of_each_are_alike() {
    let (lattice, samples) = noise(7);
    let optics = Optics { extinction: 1.0, albedo: 0.99, phase: Phase::new(0.5) };
    let to_light = DVec3::new(0.2, 0.5, -0.7).normalize();
    let solve = |turned: &(dyn Fn(DVec3) -> DVec3 + Sync)| {
        let octants = FogOctants::new(lattice, |at| {
            let octant = (2.0 * (turned(at) - lattice.low)).as_uvec3();
            samples[index(octant, 2 * lattice.size)]
        });
        // The turns below are their own inverses.
        ScatteredLight::solve(&octants, &optics, turned(to_light))
    };
    let plain = solve(&|at| at);
    let turns: [&(dyn Fn(DVec3) -> DVec3 + Sync); 5] = [
        &|at| at * DVec3::new(-1.0, 1.0, 1.0),
        &|at| at * DVec3::new(1.0, -1.0, -1.0),
        &|at| DVec3::new(at.y, at.x, at.z),
        &|at| DVec3::new(at.z, at.y, at.x),
        &|at| DVec3::new(-at.x, at.z, at.y),
    ];
    for (i, turned) in turns.into_iter().enumerate() {
        let other = solve(turned);
        let (mut off, mut largest) = (0.0_f32, 0.0_f32);
        for cell in cells(lattice.size) {
            let at = lattice.low + cell.as_dvec3() + 0.5;
            let (light, other) = (plain.at(at), other.at(turned(at)));
            let flux = turned(DVec3::new(light.y.into(), light.z.into(), light.w.into())).as_vec3();
            let expected = Vec4::new(light.x, flux.x, flux.y, flux.z);
            off = off.max((other - expected).abs().max_element());
            largest = largest.max(light.x);
        }
        // Sums in another order round differently, which the largest factor enlarges 41 times.
        println!("turn {i}: {off} of {largest}");
        assert!(off < 1e-5 * largest, "turn {i}: {off} of {largest}");
    }
}

/// The plan of sweeps leaves little to gain: the same with 24 times as many on the finest level.
#[test]
fn the_sweeps_converge() {
    let to_light = DVec3::new(0.3, -0.5, 0.8).normalize();
    let octants = ball_octants(32, to_light);
    for (extinction, anisotropy) in
        [(3.0, 0.0), (30.0, 0.0), (30.0, 0.8), (30.0, 0.95), (10.0, -0.7), (30.0, -0.4)]
    {
        let phase = Phase::new(anisotropy);
        let optics = Optics { extinction, albedo: 1.0, phase };
        let solved = ScatteredLight::solve(&octants, &optics, to_light);
        let medium = Medium::new(&octants, extinction, phase.extinction_scale(1.0) as f32);
        let mut level = Level::new(&medium, &directions(), -to_light.as_vec3());
        let mut light = vec![Vec4::ZERO; count(medium.size)];
        let turned = 3.0 * phase.remainder_anisotropy() as f32;
        let scattering = Vec4::new(1.0, turned, turned, turned) / (4.0 * PI) as f32;
        let damped = [0.02, 1.3 - anisotropy.min(0.0)];
        for factor in relaxation_factors(12, damped).repeat(16) {
            level.sweep(&mut light, scattering, factor);
        }
        let (mut off, mut sum) = (0.0, 0.0);
        for (cell, converged) in cells(medium.size).zip(&light) {
            let at = octants.lattice.low + octants.lattice.edge * (cell.as_dvec3() + 0.5);
            off += (solved.at(at).x - converged.x).abs();
            sum += converged.x;
        }
        println!("{extinction}, {anisotropy}: {}", off / sum);
        assert!(off < 0.02 * sum, "{extinction}, {anisotropy}: {} off", off / sum);
    }
}
