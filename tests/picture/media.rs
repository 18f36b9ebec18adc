//! Fogs and fire that overlap, marched together from the light cache.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbDiagnostics, VdbEmission, VdbMaterial, VdbQuality, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::fog;
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::light_cache::error;
use super::{SIZE, looking};

/// World units.
const VOXEL: f64 = 0.1;
/// Slabs about a voxel thick, and few enough steps for lavapipe, which stops a shader's loops after
/// 65,535 iterations in all.
const IN_SLABS: VdbQuality =
    VdbQuality { fog_light_error: 0.0, fog_shadow_step: 1.0, fog_slabs: 100, ..VdbQuality::EXACT };

struct Scene {
    stage: Stage,
    target: Handle<Image>,
    camera: Entity,
}

impl Scene {
    fn new() -> Self {
        Self::of_size(SIZE)
    }

    /// A camera, and a sun with shadows.
    fn of_size(size: UVec2) -> Self {
        Self::on(Stage::new(), size)
    }

    /// The same scene in an app that may have shown another, and need not compile its pipelines again.
    fn on(mut stage: Stage, size: UVec2) -> Self {
        stage.clear();
        let target = stage.target(size);
        let from = Transform::from_xyz(2.2, 3.0, 6.6).looking_at(Vec3::ZERO, Vec3::Y);
        let camera = stage.camera(&target, from);
        stage.world().entity_mut(camera).insert(VdbCamera::default());
        let light = DirectionalLight { illuminance: 10.0, shadow_maps_enabled: true, ..default() };
        stage.world().spawn((light, looking(Vec3::new(1.0, 1.0, 0.2))));
        Self { stage, target, camera }
    }

    fn cloud(&mut self, seed: u64, at: Transform, material: VdbMaterial) -> Entity {
        let grid = self.stage.grid(fog::cloud(30.0, seed), PackKind::Fog, VOXEL);
        self.stage.world().spawn((VdbVolume(grid), material, at)).id()
    }

    fn with(&mut self, quality: VdbQuality) -> Picture {
        self.stage.world().entity_mut(self.camera).insert(quality);
        self.stage.picture(&self.target)
    }

    /// A picture from the cache alone.
    fn cached(&mut self, fog_light_error: f32) -> Picture {
        let picture = self.with(VdbQuality { fog_light_error, ..VdbQuality::HIGH });
        let report = self.stage.world().resource::<VdbDiagnostics>().camera(self.camera).unwrap();
        assert!(report.has("light cache") && !report.has("fogs beside the cache"), "{report:?}");
        picture
    }
}

/// A fog split into parts that share its density looks the same, however many are marched together.
#[gpu_test]
#[ignore = "slow: up to eight fogs at once"]
fn a_fog_in_parts_is_the_same_fog() {
    let material = |density_scale| VdbMaterial { density_scale, anisotropy: 0.4, ..default() };
    let mut whole = Scene::new();
    whole.cloud(3, Transform::IDENTITY, material(1.0));
    let whole = whole.cached(0.005);
    let mut scene = Scene::new();
    for parts in [&[0.3, 0.7][..], &[0.1, 0.6, 0.3], &[0.125; 8]] {
        scene = Scene::on(scene.stage, SIZE);
        for part in parts {
            scene.cloud(3, Transform::IDENTITY, material(*part));
        }
        let picture = scene.cached(0.005);
        picture.save(&format!("media_{}_parts", parts.len()));
        let off = error(&picture, &whole);
        println!("{} parts: off by {off:.5}", parts.len());
        assert!(off < 0.005, "{parts:?}: {off}");
    }
}

/// Clouds of different colours, phase functions and orientations, which shade each other.
#[gpu_test]
#[ignore = "slow: its reference is thin slabs"]
fn clouds_that_overlap_look_as_in_thin_slabs() {
    let mut scene = Scene::new();
    let red = VdbMaterial {
        base_color: Color::linear_rgb(0.9, 0.3, 0.2),
        density_scale: 0.3,
        anisotropy: 0.5,
        ..default()
    };
    let white = VdbMaterial { density_scale: 0.2, anisotropy: -0.2, ..default() };
    let turned = Transform::from_xyz(1.1, 0.4, 0.6).with_rotation(Quat::from_rotation_y(0.7));
    scene.cloud(3, Transform::IDENTITY, red);
    scene.cloud(5, turned, white.clone());
    scene.cloud(7, Transform::from_xyz(-0.5, -1.0, 1.0).with_scale(Vec3::splat(0.7)), white);
    let reference = scene.with(IN_SLABS);
    reference.save("media_clouds_in_slabs");
    for asked in [0.02, 0.005] {
        let picture = scene.cached(asked);
        picture.save(&format!("media_clouds_{asked}"));
        let off = error(&picture, &reference);
        println!("clouds: asked for {asked}, off by {off:.5}");
        assert!(off < f64::from(asked), "{asked}: {off}");
    }
}

/// A fire in smoke that dims and hides it.
#[gpu_test]
#[ignore = "slow: its references have 100 slabs"]
fn fire_in_smoke_looks_as_in_thin_slabs() {
    let mut scene = Scene::new();
    let cube = CoordBox { min: IVec3::splat(-16), max: IVec3::splat(15) };
    let flame = fog::from_values(cube, |at| {
        let p = at.as_dvec3() / 32.0;
        let axis = DVec3::new(p.x, 0.0, p.z).length();
        (0.5 - p.y - (5.0 * axis).powi(2)).clamp(0.0, 1.0) as f32
    });
    let smoke = VdbMaterial { base_color: Color::linear_rgb(0.5, 0.5, 0.5), ..default() };
    let smoke = scene.cloud(3, Transform::IDENTITY, smoke);
    let grid = scene.stage.grid(flame, PackKind::Fog, VOXEL);
    let color = LinearRgba::rgb(6.0, 3.0, 1.0);
    let emissions = [
        ("scalar", VdbEmission::Scalar { grid: grid.clone(), color }),
        (
            "temperature",
            VdbEmission::Temperature { grid, scale: 1800.0, offset: 0.0, strength: 1e-3 },
        ),
    ];
    for (name, emission) in emissions {
        scene.stage.world().entity_mut(smoke).insert(emission);
        let reference = scene.with(IN_SLABS);
        reference.save(&format!("media_{name}_in_slabs"));
        for asked in [0.02, 0.005] {
            let picture = scene.cached(asked);
            picture.save(&format!("media_{name}_{asked}"));
            let off = error(&picture, &reference);
            println!("{name}: asked for {asked}, off by {off:.5}");
            assert!(off < f64::from(asked), "{name}, {asked}: {off}");
        }
    }
}

/// A sheet of fire one voxel thick, on either side of a face between leaves, with empty leaves around it.
#[gpu_test]
#[ignore = "slow: its references have 100 slabs"]
fn no_fire_is_lost_between_leaves() {
    let mut scene = Scene::new();
    let thin = VdbMaterial { density_scale: 0.2, ..default() };
    let smoke = scene.cloud(3, Transform::IDENTITY, thin);
    for y in [-1, 0] {
        let cube = CoordBox { min: IVec3::new(-16, -9, -16), max: IVec3::new(15, 9, 15) };
        let sheet = fog::from_values(cube, |at| if at.y == y { 1.0 } else { 0.0 });
        let grid = scene.stage.grid(sheet, PackKind::Fog, VOXEL);
        let emission = VdbEmission::Scalar { grid, color: LinearRgba::rgb(6.0, 3.0, 1.0) };
        scene.stage.world().entity_mut(smoke).insert(emission);
        let reference = scene.with(IN_SLABS);
        let picture = scene.cached(0.005);
        picture.save(&format!("media_sheet_{y}"));
        let off = error(&picture, &reference);
        println!("sheet at {y}: off by {off:.5}");
        assert!(off < 0.02, "{y}: {off}");
    }
}

/// Beyond eight fogs on a ray, and beside fog that is too dense for the cache, fog is lit by rays, if their steps are
/// short.
#[gpu_test]
#[ignore = "slow: nine fogs in 100 slabs"]
fn fogs_that_do_not_fit_are_lit_by_rays() {
    let mut scene = Scene::of_size(SIZE / 2);
    let thin = VdbMaterial { density_scale: 0.1, ..default() };
    let many: Vec<_> = (0..9).map(|_| scene.cloud(3, Transform::IDENTITY, thin.clone())).collect();
    let quality = VdbQuality { fog_slabs: 100, fog_shadow_step: 1.0, ..VdbQuality::HIGH };
    let picture = scene.with(quality);
    let uses = |scene: &mut Scene| {
        let report = scene.stage.world().resource::<VdbDiagnostics>().camera(scene.camera).unwrap();
        ["light cache", "fogs beside the cache"].map(|feature| report.has(feature))
    };
    assert_eq!(uses(&mut scene), [true, true]);
    let rays = scene.with(VdbQuality { fog_light_error: 0.0, ..quality });
    assert!(error(&picture, &rays) < 0.01, "{}", error(&picture, &rays));
    many.into_iter().skip(1).for_each(|cloud| {
        scene.stage.world().despawn(cloud);
    });
    scene.with(quality);
    assert_eq!(uses(&mut scene), [true, false]);
    let dense = VdbMaterial { density_scale: 1000.0, ..default() };
    scene.cloud(5, Transform::from_xyz(4.0, 0.0, 0.0).with_scale(Vec3::splat(0.3)), dense);
    scene.with(VdbQuality { fog_shadow_step: 0.25, ..quality });
    assert_eq!(uses(&mut scene), [true, true]);
    // Rays with longer steps would be less accurate than the cache.
    scene.with(quality);
    assert_eq!(uses(&mut scene), [true, false]);
}
