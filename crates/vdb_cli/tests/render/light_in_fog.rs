//! Fog in pictures: its transmittance and its light against closed forms and paths.

use std::f64::consts::PI;

use glam::{DVec2, DVec3, IVec3};
use vdb_core::reference::{Paths, Scattering};
use vdb_core::synth::level_set;
use vdb_core::tree::CoordBox;
use vdb_core::{AnyTree, GridClass, VdbFile};

use super::{
    Image, PIXELS, RADIUS, SOFT, VOXEL, decode, draw, draw_ball, fog_ball, folder, grid, model,
    pixels, saved,
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

/// The light of a pixel by paths, with its standard error, and in the picture.
type Pixel = ([f64; 2], f64);

/// Every fourth pixel in both directions of the bundled cloud, white, in parallel light of a radiance of 0.4 from a
/// white surface: dark enough for the tone curve to leave it as it is.
fn pixels_of_the_cloud(scatter: f64, to_sun: DVec3) -> Vec<Pixel> {
    const RADIANCE: f64 = 0.4;
    const WIDTH: f64 = 10.0;
    let folder = folder(&format!("cloud-{scatter}-{to_sun}"));
    let file = folder.join("cloud.vdb").to_str().unwrap().to_owned();
    std::fs::copy(model("cloud.vdb"), &file).unwrap();
    let vdb = VdbFile::open(&file).unwrap();
    let AnyTree::Float(tree) = &vdb.grids[0].tree else { panic!("not floats") };
    let world_from_index = vdb.grids[0].transform.linear().unwrap();
    let index_from_world = world_from_index.inverse();
    let bbox = tree.active_bbox().unwrap();
    let middle = (bbox.min + bbox.max).as_dvec3() * 0.5;
    let middle = world_from_index.transform_point3(middle);

    let text = |numbers: DVec3| numbers.to_array().map(|number| number.to_string()).join(",");
    let light = format!("{},{}", text(to_sun), text(DVec3::splat(RADIANCE)));
    let (eye, at) = (text(middle + 50.0 * DVec3::Z), text(middle));
    let view = ["--translate", &eye, "--lookat", &at, "--camera", "ortho", "--frame", "10"];
    let size = ["--size", "96x96", "--background", "black", "--ambient", "0,0,0"];
    let fog = ["--scatter", &text(DVec3::splat(scatter)), "--light", &light];
    let image = draw(&file, &[&view[..], &size, &fog].concat());
    std::fs::remove_dir_all(&folder).unwrap();

    let paths = Paths::new(&**tree).unwrap();
    let scattering = Scattering {
        extinction: scatter * world_from_index.matrix3.x_axis.length(),
        anisotropy: 0.0,
        to_sun: to_sun.normalize(),
        orders: u32::MAX,
    };
    let all = (0..96).step_by(4).flat_map(|y| (0..96).step_by(4).map(move |x| (x, y)));
    let pixel = |(x, y): (u32, u32)| {
        let across = (DVec2::new(x.into(), y.into()) + 0.5) / 96.0 - 0.5;
        let eye = middle + WIDTH * DVec3::new(across.x, -across.y, 0.0) + 50.0 * DVec3::Z;
        let origin = index_from_world.transform_point3(eye);
        let seed = u64::from(96 * x + y);
        let light = &paths.light((origin, DVec3::NEG_Z), &scattering, &[1.0], 256, seed)[0].sun;
        // The irradiance is π times the radiance of a white surface.
        let right = [light.value, light.standard_error].map(|light| PI * RADIANCE * light);
        (right[0] > 0.0).then(|| (right, decode(image.at(x as usize, y as usize)[0])))
    };
    all.filter_map(pixel).collect()
}

/// The bundled cloud under suns beside, behind and in front of it, of medium and of large depth.
#[test]
fn the_bundled_cloud_is_lit_as_by_paths() {
    for scatter in [1.6, 5.0] {
        for to_sun in [(1.0, 0.5, 0.0), (0.3, 0.8, -1.0), (-0.5, 0.7, 0.8)].map(DVec3::from) {
            let pixels = pixels_of_the_cloud(scatter, to_sun);
            assert!(pixels.len() > 100, "{} pixels of cloud", pixels.len());
            let sum = |f: &dyn Fn(&Pixel) -> f64| pixels.iter().map(f).sum::<f64>();
            let all = sum(&|([right, _], _)| *right);
            let brightness = sum(&|(_, found)| *found) / all;
            let uncertainty = sum(&|([_, noise], _)| noise * noise).sqrt() / all;
            let error = sum(&|([right, _], found)| (found - right).abs()) / all;
            // The mean magnitude of a normal distribution is 0.8 of its width.
            let noise = 0.8 * sum(&|([_, noise], _)| *noise) / all;
            let deducted = (error.powi(2) - noise.powi(2)).max(0.0).sqrt();
            println!(
                "scattering {scatter}, sun {to_sun}: {brightness:.3} ± {uncertainty:.3} as bright, \
                 {error:.3} off, {deducted:.3} without noise"
            );
            // docs/internals/notebook.md has the model's own errors.
            assert!((brightness - 1.0).abs() < 0.05 + 3.0 * uncertainty, "{brightness} as bright");
            assert!(deducted < 0.1, "{deducted} off");
        }
    }
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
