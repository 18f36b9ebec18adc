//! Light scattered many times: against closed forms.

use std::f64::consts::PI;

use glam::DVec3;
use vdb_core::{
    reference::{Mean, Medium, Paths, Ray, Scattering, Sun, phase, radiance, transmittance},
    synth,
    tree::{CoordBox, IVec3, Vdb543},
};

const ALL: u32 = u32::MAX;

/// A ball whose density varies from sample to sample.
fn cloud() -> Vdb543<f32> {
    let bbox = CoordBox { min: IVec3::splat(-10), max: IVec3::splat(10) };
    synth::fog::from_values(bbox, |ijk| {
        let wave = (ijk.x * 5 + ijk.y * 3).rem_euclid(7) as f32 / 7.0;
        ((10.0 - ijk.as_vec3().length()) / 4.0).clamp(0.0, 1.0) * (0.2 + wave)
    })
}

/// Rays into a ball of ten voxels, of unit directions.
fn rays() -> Vec<(DVec3, DVec3)> {
    let ways = [DVec3::X, DVec3::new(0.3, -1.0, 0.2), DVec3::new(-1.0, 1.0, 0.4)];
    let ways = ways.map(DVec3::normalize);
    let ray = |(i, way): (usize, DVec3)| {
        let aside = 2.5 * i as f64 * way.any_orthonormal_vector();
        (aside - 20.0 * way, way)
    };
    ways.into_iter().enumerate().map(ray).collect()
}

/// Within three standard errors.
fn check(what: &str, mean: Mean, expected: f64) {
    let off = (mean.value - expected).abs();
    println!("{what}: {mean:?} of {expected}");
    assert!(off <= 3.0 * mean.standard_error + 1e-12, "{what}: {mean:?}, not {expected}");
}

fn scattering(extinction: f64, anisotropy: f64, to_sun: DVec3, orders: u32) -> Scattering {
    Scattering { extinction, anisotropy, to_sun: to_sun.normalize(), orders }
}

/// Even light from everywhere, none of it absorbed: nothing is to be seen, and by suns all around it
/// is the same as by surroundings.
#[test]
fn a_white_furnace_shows_nothing() {
    let tree = cloud();
    let paths = Paths::new(&tree).unwrap();
    for (extinction, g) in [(0.02, 0.0), (0.3, 0.8), (3.0, -0.4)] {
        for (i, ray) in rays().into_iter().enumerate() {
            let what = format!("{extinction}, {g}, {ray:?}");
            let one = scattering(extinction, g, DVec3::Y, ALL);
            check(&what, paths.light(ray, &one, &[1.0], 1024, 1)[0].surroundings, 1.0);
            // A unit of irradiance from one of n directions, each with 4π/n of all.
            let (count, mut light, mut variance) = (192, [0.0; 2], [0.0; 2]);
            for k in 0..count {
                let z = 1.0 - 2.0 * (f64::from(k) + 0.5) / f64::from(count);
                let (sin, cos) = (f64::from(k) * PI * (3.0 - 5.0_f64.sqrt())).sin_cos();
                let aside = (1.0 - z * z).sqrt();
                let sun = scattering(extinction, g, DVec3::new(aside * cos, aside * sin, z), ALL);
                let seed = 1000 * i as u64 + k as u64;
                let all = paths.light(ray, &sun, &[1.0, 0.7], 64, seed);
                let part = 4.0 * PI / f64::from(count);
                for j in 0..2 {
                    light[j] += part * all[j].sun.value;
                    variance[j] += (part * all[j].sun.standard_error).powi(2);
                }
            }
            // What is not scattered has no sun.
            let through = transmittance(&tree, &Ray::from_f64(ray.0, ray.1), extinction).value;
            let all =
                |j: usize| Mean { value: light[j] + through, standard_error: variance[j].sqrt() };
            check(&format!("{what} by suns"), all(0), 1.0);
            let dim = paths.light(ray, &one, &[0.7], 4096, 3)[0].surroundings;
            let both = dim.standard_error.hypot(all(1).standard_error);
            let gray = Mean { standard_error: both, ..all(1) };
            check(&format!("{what} by suns, gray"), gray, dim.value);
        }
    }
}

#[test]
fn light_scattered_once_is_what_the_integral_says() {
    let tree = cloud();
    let paths = Paths::new(&tree).unwrap();
    for (extinction, g) in [(0.05, 0.0), (0.3, 0.6), (0.8, -0.3)] {
        for to_sun in [DVec3::new(0.4, 1.0, 0.1), DVec3::new(-1.0, 0.1, 0.3)] {
            for (origin, way) in rays() {
                let once = scattering(extinction, g, to_sun, 1);
                let drawn = paths.light((origin, way), &once, &[0.8], 8192, 7)[0].sun;
                let medium = Medium {
                    extinction_scale: extinction,
                    emission: 0.0,
                    albedo: 0.8,
                    phase: phase(g, way.dot(once.to_sun)),
                };
                let sun = Sun { dir: once.to_sun, extinction_scale: extinction, irradiance: 1.0 };
                let ray = Ray::from_f64(origin, way);
                let exact = radiance(&tree, &ray, &medium, Some(&sun), 1e-6).radiance.value;
                check(&format!("{extinction}, {g}, {to_sun}"), drawn, exact);
            }
        }
    }
}

/// With the sun straight before the viewer, all light comes through the whole block: `τ e^-τ` of it, a
/// sum of rays to the sun of which few are not faint.
#[test]
fn faint_light_is_right_in_the_mean() {
    let bbox = CoordBox { min: IVec3::new(0, -64, -64), max: IVec3::new(7, 63, 63) };
    let mut tree = synth::fog::block(bbox, 1.0);
    // Somewhere else it is denser: what is drawn for that density, mostly passes.
    tree.set(IVec3::new(4, 50, 50), 4.0);
    let paths = Paths::new(&tree).unwrap();
    let once = scattering(1.0, 0.0, DVec3::X, 1);
    let light = paths.light((DVec3::NEG_X * 20.0, DVec3::X), &once, &[1.0], 400_000, 9)[0];
    check("through 8", light.sun, 8.0 * (-8.0_f64).exp() * phase(0.0, 1.0));
    assert!(light.sun.standard_error < 0.02 * light.sun.value, "{:?}", light.sun);
}

/// What is scattered again is a part of what is scattered once that goes down with the optical depth.
#[test]
fn a_thin_fog_scatters_once() {
    let tree = cloud();
    let paths = Paths::new(&tree).unwrap();
    let mut before = f64::INFINITY;
    for extinction in [1e-1, 1e-2, 1e-3] {
        let all = scattering(extinction, 0.3, DVec3::Y, ALL);
        let ray = rays()[0];
        let light =
            |orders| paths.light(ray, &Scattering { orders, ..all }, &[1.0], 400_000, 5)[0].sun;
        // The same paths, so that the difference is what later orders add.
        let [one, all] = [light(1), light(ALL)];
        let again = all.value / one.value - 1.0;
        // No way through the ball is longer than 20 voxels of 1.2 at most.
        println!("{extinction}: {again}");
        assert!(again >= 0.0 && again < 24.0 * extinction, "{extinction}: {again}");
        assert!(again < 0.3 * before, "{extinction}: {again} after {before}");
        before = again;
    }
}

/// Chandrasekhar's function of isotropic scattering in a fog without a bottom, at some cosines:
/// `1/H(μ) = √(1-ω) + ω/2 ∫ x H(x) / (μ + x) dx` over x from 0 to 1 ("Radiative Transfer", 1950,
/// chapter V, equations 11 and 18).
fn h_function(albedo: f64, cosines: &[f64]) -> Vec<f64> {
    let n = 512;
    let node = |i: usize| (i as f64 + 0.5) / f64::from(n);
    let at = |h: &[f64], mu: f64| {
        let sum = (0..n as usize).map(|i| node(i) * h[i] / (mu + node(i))).sum::<f64>();
        1.0 / ((1.0 - albedo).sqrt() + 0.5 * albedo / f64::from(n) * sum)
    };
    let mut h = vec![1.0; n as usize];
    for _ in 0..4000 {
        let next: Vec<f64> = (0..n as usize).map(|i| at(&h, node(i))).collect();
        let moved = next.iter().zip(&h).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        // The mean of two steps: each alone overshoots.
        h = next.iter().zip(&h).map(|(a, b)| 0.5 * (a + b)).collect();
        if moved < 1e-10 {
            break;
        }
    }
    cosines.iter().map(|&mu| at(&h, mu)).collect()
}

#[test]
fn a_deep_slab_has_the_albedo_that_chandrasekhar_found() {
    // The last of his table XI, "the H-functions for isotropic scattering".
    let white = h_function(1.0, &[1.0])[0];
    assert!((white - 2.9078).abs() < 1e-3, "H(1) of albedo 1 is {white}");
    // So wide that nothing leaves by its sides, and 30 deep: what comes back from below is e^-30 of it.
    let bbox = CoordBox { min: IVec3::new(-2048, -2048, 0), max: IVec3::new(2047, 2047, 7) };
    let tree = synth::fog::block(bbox, 1.0);
    let paths = Paths::new(&tree).unwrap();
    let albedos = [0.3, 0.6, 0.9];
    for (seed, [mu, mu_sun]) in
        [[1.0, 1.0], [0.9, 0.4], [0.3, 0.8], [0.5, 0.5]].into_iter().enumerate()
    {
        let aside = |mu: f64| (1.0 - mu * mu).sqrt();
        let way = DVec3::new(aside(mu), 0.0, mu);
        let to_sun = DVec3::new(0.0, aside(mu_sun), -mu_sun);
        let deep = scattering(30.0 / 8.0, 0.0, to_sun, ALL);
        let light = paths.light((-20.0 * way, way), &deep, &albedos, 20_000, seed as u64);
        for (albedo, light) in albedos.into_iter().zip(light) {
            let [h, h_sun] = h_function(albedo, &[mu, mu_sun])[..] else { unreachable!() };
            // Chapter III, equation 60: of a flux πF, ω F/4 · μ₀/(μ + μ₀) · H(μ) H(μ₀).
            let sun = albedo / (4.0 * PI) * mu_sun / (mu + mu_sun) * h * h_sun;
            let what = format!("albedo {albedo}, μ {mu}, μ₀ {mu_sun}");
            check(&what, light.sun, sun);
            // All around, what is not seen is absorbed: 1 - √(1-ω) H(μ).
            let around = 1.0 - (1.0 - albedo).sqrt() * h;
            check(&format!("{what}, surroundings"), light.surroundings, around);
        }
    }
}

#[test]
fn equal_seeds_draw_equal_paths() {
    let tree = cloud();
    let paths = Paths::new(&tree).unwrap();
    let all = scattering(0.3, 0.5, DVec3::Y, ALL);
    let light = |seed| paths.light(rays()[1], &all, &[1.0, 0.5], 1000, seed);
    assert_eq!(light(1), light(1));
    assert_ne!(light(1), light(2));
    // Nothing to scatter, and fog without an end.
    let empty = Vdb543::new(0.0);
    let light = Paths::new(&empty).unwrap().light(rays()[0], &all, &[1.0], 10, 1)[0];
    assert_eq!((light.sun.value, light.surroundings.value), (0.0, 1.0));
    assert!(Paths::new(&Vdb543::new(1.0)).is_none());
}
