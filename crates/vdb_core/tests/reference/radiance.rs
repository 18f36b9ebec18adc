//! Light from fogs: against closed forms.

use glam::{DVec3, Vec3};
use vdb_core::{
    reference::{Medium, Ray, Sun, phase, radiance},
    synth,
    tree::{CoordBox, IVec3, Vdb543},
};

/// Scatters all, glows not, unit phase function: the scattered part alone.
const WHITE: Medium = Medium { extinction_scale: 0.1, emission: 0.0, albedo: 1.0, phase: 1.0 };

fn block() -> Vdb543<f32> {
    let bbox = CoordBox { min: IVec3::splat(0), max: IVec3::splat(31) };
    synth::fog::block(bbox, 1.0)
}

fn through_x() -> Ray {
    Ray::new(IVec3::new(-10, 15, 15), Vec3::splat(0.5), Vec3::X)
}

fn sun(dir: DVec3, extinction_scale: f64) -> Sun {
    Sun { dir, extinction_scale, irradiance: 1.0 }
}

#[test]
fn emission_is_what_absorption_leaves() {
    // A constant source: L = e (1 - T), whatever the density, however much of it.
    let ball = synth::fog::sphere(DVec3::splat(15.0), 14.0, 6.0);
    for scale in [1e-9, 1e-3, 0.1, 1.0, 1e3, 1e9] {
        let medium = Medium { extinction_scale: scale, emission: 2.5, ..WHITE };
        let light = radiance(&ball, &through_x(), &medium, None, 1e-6);
        let conserved = light.radiance.value + 2.5 * light.transmittance.value;
        assert!((conserved - 2.5).abs() < 1e-14, "{scale}: {light:?}");
        // And for a block, T itself is known.
        let light = radiance(&block(), &through_x(), &medium, None, 1e-6);
        let exact = -2.5 * (-32.0 * scale).exp_m1();
        let off = (light.radiance.value - exact).abs();
        assert!(off <= light.radiance.error + 1e-15, "{scale}: {light:?} {exact}");
    }
}

#[test]
fn scattering_with_the_sun_behind_before_and_beside() {
    let (tolerance, depth) = (1e-7, 3.2_f64);
    let lit = |tree: &Vdb543<f32>, sun: &Sun| {
        radiance(tree, &through_x(), &WHITE, Some(sun), tolerance).radiance.value
    };
    // 32 voxels of extinction 0.1. The shadow ray repeats the view ray in one direction or the
    // other. Sun behind the viewer: T_sun = T, ∫ T dT = (1 - T²)/2.
    let behind = lit(&block(), &sun(DVec3::NEG_X, 0.1));
    assert!((behind - (1.0 - (-2.0 * depth).exp()) / 2.0).abs() < 4.0 * tolerance, "{behind}");
    // Sun before the viewer: T · T_sun is the transmittance of the whole, L = τ exp(-τ).
    let before = lit(&block(), &sun(DVec3::X, 0.1));
    assert!((before - depth * (-depth).exp()).abs() < 4.0 * tolerance, "{before}");
    // The same two for a density that varies, of whatever depth.
    let ball = synth::fog::sphere(DVec3::splat(15.0), 14.0, 6.0);
    let through = radiance(&ball, &through_x(), &WHITE, None, tolerance).transmittance.value;
    let behind = lit(&ball, &sun(DVec3::NEG_X, 0.1));
    assert!((behind - (1.0 - through * through) / 2.0).abs() < 4.0 * tolerance, "{behind}");
    let before = lit(&ball, &sun(DVec3::X, 0.1));
    assert!((before + through.ln() * through).abs() < 4.0 * tolerance, "{before}");
    // The sun's rays in an unscaled direction, with the scale to match.
    let twice = lit(&ball, &sun(DVec3::NEG_X * 2.0, 0.2));
    assert!((twice - behind).abs() < 1e-9);
    // Overhead: every point of the ray lies 15.5 - 1/2 + 1 = 16 voxels below the top's middle.
    let inside = through_x().with_span(11.0, 39.0);
    let above = radiance(&block(), &inside, &WHITE, Some(&sun(DVec3::Y, 0.1)), tolerance);
    let exact = (-1.6_f64).exp() * -(-2.8_f64).exp_m1();
    assert!((above.radiance.value - exact).abs() < 4.0 * tolerance, "{above:?} {exact}");
}

#[test]
fn a_dense_fog_is_lit_at_its_face_and_conserved() {
    // T falls from 1 to 0 within a millionth of a voxel, which no rule over t would see.
    let dense = Medium { extinction_scale: 1e6, ..WHITE };
    let clear = sun(DVec3::NEG_X, 0.0);
    let light = radiance(&block(), &through_x(), &dense, Some(&clear), 1e-6);
    assert!((light.radiance.value - 1.0).abs() < 1e-9, "{light:?}");
    let shaded = sun(DVec3::NEG_X, 1e6);
    let light = radiance(&block(), &through_x(), &dense, Some(&shaded), 1e-6);
    assert!((light.radiance.value - 0.5).abs() < 1e-5, "{light:?}");
}

#[test]
fn the_phase_function_keeps_energy_and_has_its_mean_cosine() {
    for g in [-0.9, -0.3, 0.0, 0.5, 0.8] {
        let steps = 100_000;
        let (mut all, mut mean) = (0.0, 0.0);
        for i in 0..steps {
            let cosine = -1.0 + 2.0 * (f64::from(i) + 0.5) / f64::from(steps);
            let part = phase(g, cosine) * 4.0 * std::f64::consts::PI / f64::from(steps);
            all += part;
            mean += part * cosine;
        }
        assert!((all - 1.0).abs() < 1e-6 && (mean - g).abs() < 1e-6, "{g}: {all}, {mean}");
    }
}
