//! Shaders that are edited while an app runs.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::shader::Shader;
use bevy_vdb::VdbVolume;
use vdb_core::pack::PackKind;
use vdb_core::synth::level_set;

use super::common::{Stage, has_gpu};
use super::{GREEN, SIZE, glow, looking};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

const TRACE: &str = include_str!("../../assets/shaders/trace.wgsl");

/// A shader that does not compile leaves the picture as it was; a sound one is seen.
#[test]
fn a_broken_shader_leaves_the_last_good_one() {
    if !has_gpu() {
        return;
    }
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    stage.world().spawn((VdbVolume(grid), glow(GREEN)));
    let before = stage.picture(&target);
    assert!(before.center().y > 0.5, "nothing is there");
    let edit = |stage: &mut Stage, source: String| {
        let path = "embedded://bevy_vdb/shaders/trace.wgsl";
        let shader: Handle<Shader> = stage.world().resource::<AssetServer>().load(path);
        let mut shaders = stage.world().resource_mut::<Assets<Shader>>();
        shaders.insert(shader.id(), Shader::from_wgsl(source, path)).unwrap();
        stage.update(8);
        stage.picture(&target)
    };
    let wrote = "vec4(finite(found.color), found.coverage)";
    assert!(TRACE.contains(wrote));
    let broken = edit(&mut stage, TRACE.replace(wrote, "vec4(no_such_thing)"));
    assert!(broken == before, "the broken shader shows");
    let blue = "vec4(0.0, 0.0, found.coverage, found.coverage)";
    let mended = edit(&mut stage, TRACE.replace(wrote, blue));
    assert!(mended.center().z > 0.9 && mended.center().y < 0.1, "{}", mended.center());
    assert!(edit(&mut stage, TRACE.into()) == before);
}
