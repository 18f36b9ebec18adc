//! Opacity maps are filled again when what they show changes, and only then.

use bevy::light::{DirectionalLightShadowMap, PointLightShadowMap};
use bevy::prelude::*;
use bevy_vdb::{
    VdbClipPlane, VdbClippedBy, VdbDiagnostics, VdbGrid, VdbMaterial, VdbQuality, VdbRamp,
    VdbRampStop, VdbVolume, VdbVoxel,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::fog;
use vdb_core::tree::CoordBox;

use super::common::Picture;
use super::mesh_shadows::{Scene, VOXEL, bulb, spot, sun};

/// Two clouds above a plane, each in the light of a sun, a spot light and a bulb.
struct Clouds {
    scene: Scene,
    clouds: [Entity; 2],
    sun: Entity,
    spot: Entity,
}

impl Clouds {
    fn new() -> Self {
        let mut scene = Scene::new(Vec3::new(-2.0, 7.0, 5.0));
        scene.stage.world().insert_resource(DirectionalLightShadowMap { size: 128 });
        scene.stage.world().insert_resource(PointLightShadowMap { size: 64 });
        scene.stage.world().entity_mut(scene.camera).insert(VdbQuality::FAST);
        let clouds = [(20.0, Vec3::new(0.0, 2.0, 0.0)), (10.0, Vec3::new(2.5, 1.5, 0.5))];
        let clouds = clouds.map(|(radius, at)| {
            let material = VdbMaterial { base_color: Color::BLACK, ..default() };
            let cloud = scene.volume(fog::cloud(radius, 3), PackKind::Fog, material);
            scene.stage.world().entity_mut(cloud).insert(Transform::from_translation(at));
            cloud
        });
        let sun = scene.stage.world().spawn(sun(Vec3::new(1.0, 1.5, 0.3))).id();
        let spot = scene.stage.world().spawn(spot()).id();
        scene.stage.world().spawn(bulb());
        Self { scene, clouds, sun, spot }
    }

    /// In how many of the next frames maps are filled.
    fn fills(&mut self, frames: usize) -> usize {
        let camera = self.scene.camera;
        let is_filled = |_: &usize| {
            self.scene.stage.update(1);
            let report = self.scene.stage.world().resource::<VdbDiagnostics>().camera(camera);
            let report = report.expect("volumes in view");
            report.passes.iter().any(|pass| pass.name == "vdb_opacity")
        };
        (0..frames).filter(is_filled).count()
    }

    fn picture(&mut self, name: &str) -> Picture {
        self.scene.picture(&format!("opacity_{}", name.replace(' ', "_")))
    }

    /// The same picture with a texture that is made anew.
    fn picture_anew(&mut self, name: &str) -> Picture {
        let plane = self.scene.plane;
        self.scene.stage.world().entity_mut(plane).insert(Visibility::Hidden);
        assert_eq!(self.fills(1), 0, "{name}: no mesh is seen");
        self.scene.stage.world().entity_mut(plane).insert(Visibility::Inherited);
        assert_eq!(self.fills(2), 1, "{name}: a mesh is seen again");
        self.picture(&format!("{name}_anew"))
    }

    fn place(&mut self, thing: Entity, by: impl FnOnce(&mut Transform)) {
        by(&mut self.scene.stage.world().get_mut::<Transform>(thing).expect("a place"));
    }

    /// Replaces the voxels in the middle of the first cloud.
    fn edit(&mut self, value: f32) {
        let world = self.scene.stage.world();
        let handle = world.get::<VdbVolume>(self.clouds[0]).expect("a volume").0.clone();
        let mut grids = world.resource_mut::<Assets<VdbGrid>>();
        let part = CoordBox { min: IVec3::splat(-8), max: IVec3::splat(8) };
        let even = |_, _| VdbVoxel { value, active: true };
        grids.get_mut(&handle).expect("a grid").edit(|voxels| voxels.update(part, even)).unwrap();
    }
}

fn ramp(extinction: f32) -> VdbRamp {
    let stop = |value, extinction| VdbRampStop {
        value,
        extinction,
        color: Color::BLACK,
        emission: LinearRgba::BLACK,
    };
    VdbRamp::new([stop(0.0, 0.0), stop(0.5, extinction), stop(1.0, 0.5)])
}

/// What changes in a scene, and whether an opacity map shows it.
type Change = (&'static str, bool, fn(&mut Clouds));

#[gpu_test]
fn opacity_maps_are_filled_when_what_they_show_changes() {
    let mut clouds = Clouds::new();
    let mut before = clouds.picture("first");
    assert_eq!(clouds.fills(1), 0, "nothing has changed");
    let changes: [Change; 14] = [
        ("camera turns", false, |clouds| {
            let camera = clouds.scene.camera;
            clouds.place(camera, |at| at.rotate_y(0.1));
        }),
        ("camera comes nearer", false, |clouds| {
            let camera = clouds.scene.camera;
            clouds.place(camera, |at| at.translation *= 0.8);
        }),
        ("plane moves", false, |clouds| {
            let plane = clouds.scene.plane;
            clouds.place(plane, |at| at.translation.y = -0.5);
        }),
        ("cloud moves", true, |clouds| {
            let cloud = clouds.clouds[0];
            clouds.place(cloud, |at| at.translation.x += 0.37);
        }),
        ("other cloud turns", true, |clouds| {
            let cloud = clouds.clouds[1];
            clouds.place(cloud, |at| at.rotate_x(1.0));
        }),
        ("voxels change", true, |clouds| clouds.edit(3.0)),
        ("voxels change again", true, |clouds| clouds.edit(1.0)),
        ("density", true, |clouds| {
            let cloud = clouds.clouds[0];
            let mut material = clouds.scene.stage.world().get_mut::<VdbMaterial>(cloud);
            material.as_mut().expect("a material").density_scale = 3.0;
        }),
        ("sun turns", true, |clouds| {
            let sun = clouds.sun;
            clouds.place(sun, |at| at.rotate_z(0.3));
        }),
        ("lamp moves", true, |clouds| {
            let spot = clouds.spot;
            clouds.place(spot, |at| at.translation.x -= 1.0);
        }),
        ("grid is replaced", true, |clouds| {
            let grid = clouds.scene.stage.grid(fog::cloud(15.0, 9), PackKind::Fog, VOXEL);
            clouds.scene.stage.world().entity_mut(clouds.clouds[0]).insert(VdbVolume(grid));
        }),
        ("ramp", true, |clouds| {
            clouds.scene.stage.world().entity_mut(clouds.clouds[0]).insert(ramp(3.0));
        }),
        ("other ramp", true, |clouds| {
            clouds.scene.stage.world().entity_mut(clouds.clouds[0]).insert(ramp(1.0));
        }),
        ("clip plane", true, |clouds| {
            let at = Transform::from_xyz(0.3, 0.0, 0.0).with_rotation(Quat::from_rotation_z(0.5));
            let world = clouds.scene.stage.world();
            let plane = world.spawn((VdbClipPlane, at)).id();
            world.entity_mut(clouds.clouds[0]).insert(VdbClippedBy(vec![plane]));
        }),
    ];
    for (name, is_shown, change) in changes {
        change(&mut clouds);
        assert_eq!(clouds.fills(3), usize::from(is_shown), "{name}");
        let after = clouds.picture(name);
        assert_eq!(clouds.fills(1), 0, "{name}: nothing has changed since");
        assert!(after.pixels != before.pixels, "{name}: nothing is seen of it");
        let anew = clouds.picture_anew(name);
        let differ = after.pixels.iter().zip(&anew.pixels).filter(|(a, b)| a != b).count();
        assert_eq!(differ, 0, "{name}: pixels that differ if all maps are filled");
        before = after;
    }
}

/// Whatever part of the clouds is within reach of its shadow maps, whose texels are smaller than voxels.
#[gpu_test]
fn no_opacity_map_is_filled_while_a_camera_flies() {
    let mut clouds = Clouds::new();
    clouds.scene.stage.world().insert_resource(DirectionalLightShadowMap { size: 512 });
    clouds.picture("flight");
    let camera = clouds.scene.camera;
    for step in 0..22 {
        clouds.place(camera, |at| at.translation *= 1.06);
        assert_eq!(clouds.fills(1), 0, "step {step}");
    }
}
