//! Light of one grid through the fog of another: against closed forms.

use glam::Vec3;
use vdb_core::{
    reference::{Dimming, Fog, Medium, Ray, emitted, radiance},
    synth,
    tree::{CoordBox, IVec3, Vdb543},
};

fn block(low: i32, high: i32, value: f32) -> Vdb543<f32> {
    synth::fog::block(CoordBox { min: IVec3::splat(low), max: IVec3::splat(high) }, value)
}

fn through_x() -> Ray {
    Ray::new(IVec3::new(-10, 15, 15), Vec3::splat(0.5), Vec3::X)
}

fn dimmed(emitter: &Vdb543<f32>, fog: &Vdb543<f32>, scale: f64) -> f64 {
    let (emitter, fog) = (Fog::new(emitter), Fog::new(fog));
    let dimming = Dimming { fog: &fog, ray: through_x(), extinction_scale: scale };
    emitted(&emitter, &through_x(), |v| 2.0 * v, Some(&dimming), 1e-9).value
}

#[test]
fn an_even_block_shines_as_its_closed_form_says() {
    let tree = block(0, 31, 1.0);
    // Trilinear: 31 voxels in full, and a ramp of one voxel on either side that adds up to one.
    let length = 32.0;
    let clear = emitted(&Fog::new(&tree), &through_x(), |v| 2.0 * v, None, 1e-9);
    assert!((clear.value - 2.0 * length).abs() < 1e-7, "{clear:?}");
    // As density and light fall off alike, L = ε/σ · (1 - exp(-σL)).
    for sigma in [1e-3, 0.1, 2.0, 50.0] {
        let exact = 2.0 / sigma * -(-sigma * length).exp_m1();
        let light = dimmed(&tree, &tree, sigma);
        assert!((light - exact).abs() < 1e-6 * exact, "{sigma}: {light} {exact}");
        // The same as the fog that emits where it is dense.
        let medium =
            Medium { extinction_scale: sigma, emission: 2.0 / sigma, albedo: 0.0, phase: 0.0 };
        let own = radiance(&tree, &through_x(), &medium, None, 1e-6).radiance.value;
        assert!((light - own).abs() < 1e-6 * own, "{sigma}: {light} {own}");
    }
}

#[test]
fn fog_dims_what_is_behind_it_alone() {
    let ramp = synth::fog::ramp(
        CoordBox { min: IVec3::new(40, 0, 0), max: IVec3::new(60, 31, 31) },
        glam::DVec3::X,
        -39.0,
    );
    let (fog, nothing) = (block(0, 31, 1.0), block(100, 110, 1.0));
    let clear = dimmed(&ramp, &nothing, 0.1);
    // The ramp from 1 to 21 over 20 voxels, with one voxel on either side from 0 to 1, and from 21 to 0.
    assert!((clear - 2.0 * (220.0 + 0.5 + 10.5)).abs() < 1e-6, "{clear}");
    let behind = dimmed(&ramp, &fog, 0.1);
    assert!((behind / clear - (-3.2_f64).exp()).abs() < 1e-9, "{behind}");
    // What shines before the fog is not dimmed.
    let before =
        synth::fog::block(CoordBox { min: IVec3::new(-8, 0, 0), max: IVec3::new(-4, 31, 31) }, 3.0);
    let shown = dimmed(&before, &fog, 0.1);
    assert!((shown - 2.0 * 3.0 * 5.0).abs() < 1e-6, "{shown}");
}

#[test]
fn what_is_not_linear_in_the_value_is_integrated_along_the_ray() {
    let ramp = synth::fog::ramp(
        CoordBox { min: IVec3::new(0, 0, 0), max: IVec3::new(32, 31, 31) },
        glam::DVec3::X,
        0.0,
    );
    let ray = through_x().with_span(10.0, 40.0);
    // ∫ x⁷ dx from -0.5 + 0 … the ray begins at x = -9.5, so that t = 10 is x = 0.5.
    let light = emitted(&Fog::new(&ramp), &ray, |v| v.powi(7), None, 1e-6);
    let exact = (30.5_f64.powi(8) - 0.5_f64.powi(8)) / 8.0;
    assert!((light.value / exact - 1.0).abs() < 1e-9, "{light:?} {exact}");
}
