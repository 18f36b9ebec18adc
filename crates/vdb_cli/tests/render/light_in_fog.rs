//! Fog in pictures: its transmittance and its light against closed forms and paths.

use std::f64::consts::PI;

use glam::{DVec3, IVec3};
use vdb_core::GridClass;
use vdb_core::reference::{Paths, Scattering};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::{
    Image, MIDDLE, PIXELS, RADIUS, SOFT, VOXEL, decode, draw_ball, fog_ball, folder, grid, pixels,
    saved,
};

/// The integral of the ball's density, in voxels, on a line that passes its middle at a distance.
fn chord(distance: f64) -> f64 {
    // ∫ (R - r) ds and ∫ r ds of lines within a radius, in closed form.
    let half = |radius: f64| (radius * radius - distance * distance).max(0.0).sqrt();
    let of_r = |s: f64| {
        let r = (s * s + distance * distance).sqrt();
        0.5 * (s * r + distance * distance * (s / distance.max(1e-9)).asinh())
    };
    let (outer, inner) = (half(RADIUS), half(RADIUS - SOFT));
    let soft = RADIUS * (outer - inner) - (of_r(outer) - of_r(inner));
    2.0 * (inner + soft / SOFT)
}

#[test]
fn fog_lets_through_what_the_closed_form_says() {
    let folder = folder("fog");
    let file = saved(&folder, "ball.vdb", vec![fog_ball()]);
    let dark = ["--light", "0,1,0,0,0,0", "--ambient", "0,0,0", "--background", "white"];
    let fog = ["--absorb", "0.2,0.05,0.02", "--scatter", "0,0,0"];
    let image = draw_ball(&file, &[&dark[..], &fog].concat());
    for (x, y, at) in pixels() {
        let depth = VOXEL * chord(at.length() / VOXEL);
        for (axis, absorb) in [0.2, 0.05, 0.02].into_iter().enumerate() {
            let (is, expected) = (decode(image.at(x, y)[axis]), (-absorb * depth).exp());
            // Half a step of eight bits is up to 0.0045. Where the density bends, at either end of the
            // soft layer, interpolation is off by up to 1/8 of the change of slope, 1/32, over a chord
            // of 12.6 voxels within the outermost one: 0.4 voxels, if the ray only grazes the ball.
            let grazes = at.length() > 0.7 * VOXEL * RADIUS;
            let tolerance = if grazes { 0.0045 + 0.4 * VOXEL * absorb } else { 0.006 };
            assert!((is - expected).abs() < tolerance, "{at}, {axis}: {is}, not {expected}");
        }
    }
    // White fog in uniform light sends out as much as it takes away.
    let furnace = ["--light", "0,1,0,0,0,0", "--ambient", "0.5,0.5,0.5", "--background", "#bcbcbc"];
    let image = draw_ball(&file, &furnace);
    assert!(image.bytes.iter().all(|byte| byte.abs_diff(0xbc) <= 1), "white fog is seen");
    // Thin fog scatters a quarter of the sun's light, once: E / 4π is a quarter of the radiance.
    let thin = ["--light", "0,1,0,2,2,2", "--ambient", "0,0,0", "--background", "black"];
    let image = draw_ball(&file, &[&thin[..], &["--scatter", "0.002,0.002,0.002"]].concat());
    let middle = decode(image.at(PIXELS / 2, PIXELS / 2)[1]);
    let once = 0.002 * VOXEL * chord(0.0) * 2.0 / 4.0;
    // Light that is scattered again adds about half the depth, 0.038; a step of eight bits is 0.0003 here, 0.03
    // of the light.
    assert!((0.97..1.07).contains(&(middle / once)), "{middle}, not {once}");
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A cloud in front of the camera, in the light of a sun at the camera's upper left.
#[test]
fn fog_scatters_sunlight_as_paths_do() {
    let folder = folder("paths");
    let tree = fog::cloud(RADIUS, 3);
    let file =
        saved(&folder, "cloud.vdb", vec![grid("density", tree.clone(), GridClass::FogVolume)]);
    // Dark enough for the tone curve to leave all light as it is.
    let sun = ["--light", "-1,0.7,0.8,0.4,0.4,0.4", "--ambient", "0,0,0", "--background", "black"];
    let (scatter, absorb) = (1.2, 0.06);
    let numbers = [absorb, scatter].map(|n| format!("{n},{n},{n}"));
    let fog = ["--absorb", &numbers[0], "--scatter", &numbers[1]];
    let image = draw_ball(&file, &[&sun[..], &fog].concat());
    let paths = Paths::new(&tree).unwrap();
    let scattering = Scattering {
        extinction: VOXEL * (scatter + absorb),
        anisotropy: 0.0,
        to_sun: DVec3::new(-1.0, 0.7, 0.8).normalize(),
        orders: u32::MAX,
    };
    let (mut off, mut sum, mut all, mut variance) = (0.0, 0.0, 0.0, 0.0);
    for (x, y, at) in pixels().filter(|(x, y, _)| x % 6 == 0 && y % 6 == 0) {
        let origin = MIDDLE + at.extend(100.0) / VOXEL;
        let albedo = scatter / (scatter + absorb);
        let light = &paths.light((origin, DVec3::NEG_Z), &scattering, &[albedo], 256, x as u64)[0];
        // The irradiance is π times the radiance of a white surface.
        let irradiance = 0.4 * PI;
        let right = irradiance * light.sun.value;
        variance += (irradiance * light.sun.standard_error).powi(2);
        let found = decode(image.at(x, y)[0]);
        (off, sum, all) = (off + (found - right).abs(), sum + found, all + right);
    }
    let [off, brightness, noise] = [off, sum, variance.sqrt()].map(|sum| sum / all);
    println!("{off} off, {brightness} as bright, with a standard error of {noise}");
    // docs/internals/notebook.md has the model's own errors. A pixel also has the noise of its paths, 0.05.
    assert!((brightness - 1.0).abs() < 0.05 + 3.0 * noise, "{brightness} as bright");
    assert!(off < 0.12, "{off} off");
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Each channel of a coloured fog is that of a grey fog with its coefficients.
#[test]
fn channels_of_fog_are_independent() {
    let folder = folder("channels");
    let file = saved(&folder, "ball.vdb", vec![fog_ball()]);
    let sun = ["--light", "-1,1,1,0.4,0.4,0.4", "--ambient", "0,0,0", "--background", "black"];
    let with = |absorb: [f64; 3], scatter: [f64; 3]| {
        let [absorb, scatter] = [absorb, scatter].map(|rgb| rgb.map(|c| c.to_string()).join(","));
        draw_ball(&file, &[&sun[..], &["--absorb", &absorb, "--scatter", &scatter]].concat())
    };
    for (absorb, scatter) in
        [([0.0, 0.3, 0.1], [2.0, 1.0, 0.5]), ([0.0, 0.2, 0.5], [1.0, 0.8, 0.5])]
    {
        let all = with(absorb, scatter);
        for channel in 0..3 {
            let own = with([absorb[channel]; 3], [scatter[channel]; 3]);
            for (all, own) in all.bytes.chunks(3).zip(own.bytes.chunks(3)) {
                // Rays of a coloured fog go on until its thinnest channel is opaque, which rounds otherwise.
                assert!(all[channel].abs_diff(own[channel]) <= 1, "{all:?}, {channel}: {own:?}");
            }
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn fog_is_bright_on_the_side_of_the_sun_and_dark_behind_a_solid() {
    let folder = folder("sides");
    let file = saved(&folder, "ball.vdb", vec![fog_ball()]);
    let sun = ["--light", "-1,0,0,1,1,1", "--ambient", "0,0,0", "--background", "black"];
    let dense = ["--scatter", "1,1,1"];
    let image = draw_ball(&file, &[&sun[..], &dense].concat());
    let sides =
        |image: &Image| [PIXELS / 4, 3 * PIXELS / 4].map(|x| decode(image.at(x, PIXELS / 2)[0]));
    let [near, far] = sides(&image);
    assert!(near > 0.1 && near > 3.0 * far, "{near} beside the sun, {far} behind");
    // A plate between the sun and the ball.
    let distance =
        |p: DVec3| ((p - DVec3::X * -38.0).abs() - DVec3::new(2.0, 40.0, 40.0)).max_element();
    let bbox = CoordBox { min: IVec3::new(-44, -44, -44), max: IVec3::new(-32, 44, 44) };
    let plate = grid("plate", level_set::from_distance(bbox, distance), GridClass::LevelSet);
    let file = saved(&folder, "both.vdb", vec![fog_ball(), plate]);
    let image = draw_ball(&file, &[&sun[..], &dense].concat());
    let [near, far] = sides(&image);
    assert!(near < 0.002 && far < 0.002, "{near} and {far} in the shadow");
    std::fs::remove_dir_all(&folder).unwrap();
}
