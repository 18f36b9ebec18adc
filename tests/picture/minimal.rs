//! The example `minimal`, which has no way to draw without a window of its own.

use bevy::camera::RenderTarget;
use bevy::prelude::*;
use bevy_vdb::VdbGpuUsage;
use gpu_test::gpu_test;

use super::SIZE;
use super::common::Stage;

#[allow(dead_code, reason = "its main function opens a window")]
#[path = "../../examples/minimal.rs"]
mod example;

#[gpu_test]
fn the_least_that_shows_a_file_does() {
    let mut stage = Stage::with(|app| _ = app.add_systems(Startup, example::setup));
    let target = stage.target(SIZE);
    let shown = RenderTarget::from(target.clone());
    stage.app.add_systems(PostStartup, move |mut cameras: Query<&mut RenderTarget>| {
        cameras.single_mut().map(|mut camera| *camera = shown.clone()).expect("one camera");
    });
    for _ in 0..2000 {
        stage.update(1);
        if stage.world().resource::<VdbGpuUsage>().grids() > 0 {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let picture = stage.picture(&target);
    picture.save("minimal");
    // A teapot in the middle, lit from one side, before what is cleared.
    let seen = picture.count(|pixel| pixel.truncate().min_element() > 0.01);
    let corner = picture.at(0, 0).truncate();
    assert!(corner.max_element() < 1e-3, "{corner} in the corner");
    assert!(picture.center().x > 0.05, "{} in the middle", picture.center());
    assert!((600..4000).contains(&seen), "{seen} pixels of the teapot");
    let bright = picture.pixels.iter().map(|pixel| pixel.x).fold(0.0, f32::max);
    assert!(bright > 0.2, "{bright} at the most");
}
