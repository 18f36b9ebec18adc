//! What is between two frames of a sequence.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::fog;
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, WriteOptions};

use super::common::{Picture, Stage};
use super::{SIZE, looking};

/// Radii of two frames, and of what burns in them.
const FRAMES: [[f64; 2]; 2] = [[16.0, 6.0], [9.0, 9.0]];

fn ball(radius: f64) -> Vdb543<f32> {
    fog::sphere(DVec3::ZERO, radius, 4.0)
}

/// The first times `1 - t` and the second times `t`.
fn mixed(radii: [f64; 2], t: f32) -> Vdb543<f32> {
    let [a, b] = radii.map(ball);
    let mut tree = Vdb543::new(0.0);
    let reach = 20;
    for i in 0..(2 * reach + 1_i32).pow(3) {
        let edge = 2 * reach + 1;
        let ijk = IVec3::new(i / (edge * edge), i / edge % edge, i % edge) - reach;
        let value = (1.0 - t) * a.get(ijk) + t * b.get(ijk);
        if value > 0.0 {
            tree.set(ijk, value);
        }
    }
    tree
}

fn look() -> VdbMaterial {
    VdbMaterial { base_color: Color::srgb(0.8, 0.5, 0.3), density_scale: 0.12, ..default() }
}

fn burning(grid: Handle<VdbGrid>) -> VdbEmission {
    VdbEmission::Scalar { grid, color: LinearRgba::rgb(0.01, 0.03, 0.05) }
}

/// A fade is the fog whose densities are blended: in its colour, its light and its emission.
#[gpu_test]
fn a_cross_fade_is_the_blend_of_both_frames() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_fade_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for (number, [smoke, flame]) in (1..).zip(FRAMES) {
        let grids = [("density", smoke), ("flame", flame)].map(|(name, radius)| {
            let mut grid = Grid::new(name, AnyTree::Float(ball(radius).into()));
            grid.class = GridClass::FogVolume;
            grid
        });
        let file = vdb_core::VdbFile::new(grids.into());
        file.save(folder.join(format!("{number}.vdb")), &WriteOptions::default()).unwrap();
    }
    let mut stage = Stage::watching(&folder, |_| {});
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 70.0));
    // Each light by its own ray: what a cache interpolates is another matter.
    stage.world().entity_mut(camera).insert(VdbQuality::EXACT);
    let sun = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
    stage.world().spawn((DirectionalLight { illuminance: 6.0, ..default() }, sun));
    let frames = (1..=2).map(|number| VdbFrame::new(number, format!("{number}.vdb")));
    let sequence = VdbSequence::new(frames).with_rate(1.0).with_repeat(VdbRepeat::Once);
    let sequence = stage.world().resource_mut::<Assets<VdbSequence>>().add(sequence);
    let fading = VdbPlayer::new(sequence).paused().with_blend(VdbFrameBlend::CrossFade);
    let player = stage.world().spawn((fading, look(), burning(Handle::default()))).id();
    for _ in 0..500 {
        stage.update(1);
        if stage.world().get::<VdbPlayerStatus>(player).unwrap().loaded().len() == 2 {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let mut pictures: Vec<(f32, Picture)> = Vec::new();
    for t in [0.0, 0.25, 0.75] {
        stage.world().get_mut::<VdbPlayer>(player).unwrap().seek_time(t.into());
        let picture = stage.picture(&target);
        picture.save(&format!("fade_{t}"));
        pictures.push((t, picture));
    }
    stage.world().entity_mut(player).despawn();
    for (t, faded) in pictures {
        let [smoke, flame] = [0, 1].map(|part: usize| {
            let tree = mixed(FRAMES.map(|radii| radii[part]), t);
            stage.grid(tree, PackKind::Fog, 1.0)
        });
        let blended = stage.world().spawn((VdbVolume(smoke), look(), burning(flame))).id();
        let picture = stage.picture(&target);
        picture.save(&format!("blended_{t}"));
        stage.world().entity_mut(blended).despawn();
        let pairs = picture.pixels.iter().zip(&faded.pixels);
        let difference = pairs.map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max);
        let brightest =
            picture.pixels.iter().map(|p| p.truncate().max_element()).fold(0.0, f32::max);
        println!("{t}: {difference} of {brightest}");
        assert!(brightest > 0.2, "{t}: {brightest}");
        assert!(difference < 0.01, "{t}: {difference}");
    }
    std::fs::remove_dir_all(&folder).ok();
}
