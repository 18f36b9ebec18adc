//! Fog over time: consecutive frames of a moving camera or sun, without TAA.

use bevy::prelude::*;
use bevy_vdb::VdbQuality;
use gpu_test::gpu_test;

use super::common::Picture;
use super::flip::flip;
use super::light_cache::{BY_RAYS, Cloud};
use super::looking;

const FRAMES: usize = 6;

/// FLIP between two pictures, in the mean over pixels that show something, if this radiance is white.
fn difference(a: &Picture, b: &Picture, white: f32) -> f64 {
    let bright = |picture: &Picture| Picture {
        size: picture.size,
        pixels: picture.pixels.iter().map(|pixel| *pixel / white).collect(),
    };
    let shows = |(a, b): (&Vec4, &Vec4)| a.max(*b).truncate().max_element() > 0.0;
    let shown: Vec<bool> = a.pixels.iter().zip(&b.pixels).map(shows).collect();
    let all = flip(&bright(a), &bright(b));
    let of_shown = all.iter().zip(&shown).filter(|(_, shown)| **shown);
    of_shown.map(|(flip, _)| flip).sum::<f64>()
        / shown.iter().filter(|shown| **shown).count() as f64
}

/// Frames of a cloud between which something moves.
fn film(cloud: &mut Cloud, quality: VdbQuality, set: impl Fn(&mut Cloud, f32)) -> Vec<Picture> {
    let frame = |i| {
        set(cloud, i as f32);
        cloud.with(quality)
    };
    (0..FRAMES).map(frame).collect()
}

/// Compares how much `HIGH` and `BALANCED` differ from frame to frame, and from `EXACT`, with `EXACT`'s frames.
fn is_steady(name: &str, set: impl Fn(&mut Cloud, f32)) {
    let mut cloud = Cloud::new(1.0);
    let exact = film(&mut cloud, BY_RAYS, &set);
    let white = exact[0].pixels.iter().map(|p| p.truncate().max_element()).fold(0.0, f32::max);
    let between = |frames: &[Picture]| {
        let differences = frames.windows(2).map(|two| difference(&two[0], &two[1], white));
        differences.sum::<f64>() / (FRAMES - 1) as f64
    };
    let expected = between(&exact);
    assert!(expected > 0.005, "hardly anything moves: {expected}");
    // FLIP to `EXACT` of an image in which no difference is seen, and of twice the error.
    let presets = [("HIGH", VdbQuality::HIGH, 0.005), ("BALANCED", VdbQuality::BALANCED, 0.015)];
    for (preset, quality, bound) in presets {
        let frames = film(&mut cloud, quality, &set);
        frames
            .iter()
            .enumerate()
            .for_each(|(i, frame)| frame.save(&format!("{name}_{preset}_{i}")));
        let found = between(&frames);
        let still = frames.iter().zip(&exact).map(|(found, exact)| difference(exact, found, white));
        let still = still.fold(0.0, f64::max);
        println!(
            "{name}, {preset}: FLIP between frames {:.3} of EXACT's {expected:.4}; to EXACT at most {still:.4}",
            found / expected
        );
        assert!(found <= 1.1 * expected, "{name}, {preset}: {found} beside {expected}");
        assert!(still <= bound, "{name}, {preset}: {still} to EXACT");
    }
}

#[gpu_test]
#[ignore = "slow: frames of fog lit by rays"]
fn a_flight_is_as_steady_as_exact() {
    is_steady("flight", |cloud, i| {
        let angle = 0.3 + 0.02 * i;
        let from = 10.3 * Vec3::new(angle.sin(), 0.4, angle.cos()).normalize();
        let camera = cloud.camera;
        let view = Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::Y);
        cloud.stage.world().entity_mut(camera).insert(view);
    });
}

#[gpu_test]
#[ignore = "slow: frames of fog lit by rays"]
fn a_moving_sun_is_as_steady_as_exact() {
    is_steady("sun", |cloud, i| {
        let (angle, sun) = (0.5 + 0.02 * i, cloud.sun);
        let to_sun = Vec3::new(angle.cos(), angle.sin(), 0.3);
        cloud.stage.world().entity_mut(sun).insert(looking(to_sun));
    });
}
