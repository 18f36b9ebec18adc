//! Voxels that change while the app runs.

use bevy::ecs::system::RunSystemOnce;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{
    VdbEdit, VdbGpuUsage, VdbGrid, VdbMaterial, VdbRayCastSettings, VdbSpatialQuery, VdbVolume,
    VdbVoxel,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };
const VOXEL: f64 = 0.1;

/// A ball at the origin before a torus that is never edited, in the sun.
struct Scene {
    stage: Stage,
    target: Handle<Image>,
    volume: Entity,
    grid: Handle<VdbGrid>,
}

impl Scene {
    fn new(kind: PackKind) -> Self {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        stage.camera(&target, looking(Vec3::new(3.0, 4.0, 6.0)));
        let torus = stage.grid(level_set::torus(DVec3::ZERO, 30.0, 6.0), SURFACE, VOXEL);
        let behind = Transform::from_xyz(-3.0, -3.0, -6.0);
        stage.world().spawn((VdbVolume(torus), VdbMaterial::default(), behind));
        let tree = match kind {
            PackKind::Fog => fog::sphere(DVec3::ZERO, 20.0, 6.0),
            _ => level_set::sphere(DVec3::ZERO, 20.0),
        };
        let grid = stage.grid(tree, kind, VOXEL);
        let volume = VdbVolume(grid.clone());
        let volume = stage.world().spawn((volume, VdbMaterial::default())).id();
        let sun = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
        stage.world().spawn((DirectionalLight { illuminance: 3.0, ..default() }, sun));
        Self { stage, target, volume, grid }
    }

    fn edit(&mut self, f: impl FnOnce(&mut VdbEdit)) {
        let mut grids = self.stage.world().resource_mut::<Assets<VdbGrid>>();
        grids.get_mut(&self.grid).unwrap().edit(f).unwrap();
    }

    /// Adds a ball of some radius to the grid, or takes one from it.
    fn ball(&mut self, middle: IVec3, radius: f32, dig: bool) {
        let fog = self.kind() == PackKind::Fog;
        let bbox = CoordBox { min: middle - radius as i32 - 4, max: middle + radius as i32 + 4 };
        self.edit(|voxels| {
            voxels.update(bbox, |ijk, old| {
                let distance = (ijk - middle).as_vec3().length() - radius;
                let value = match (fog, dig) {
                    (true, true) => old.value * (distance / 4.0).clamp(0.0, 1.0),
                    (true, false) => old.value.max((-distance / 4.0).clamp(0.0, 1.0)),
                    (false, true) => old.value.max((-distance).clamp(-3.0, 3.0)),
                    (false, false) => old.value.min(distance.clamp(-3.0, 3.0)),
                };
                VdbVoxel { value, active: true }
            });
        });
    }

    fn kind(&mut self) -> PackKind {
        self.own().kind()
    }

    fn own(&mut self) -> &VdbGrid {
        self.stage.world().resource::<Assets<VdbGrid>>().get(&self.grid).unwrap()
    }

    fn picture(&mut self) -> Picture {
        self.stage.picture(&self.target)
    }

    /// The picture of the same voxels as a grid of its own, which no one has edited.
    fn picture_from_scratch(&mut self) -> Picture {
        let grid = self.own();
        let world_from_index = DAffine3::from_scale(DVec3::splat(VOXEL));
        let (tree, kind) = (grid.tree().unwrap().as_ref().clone(), grid.kind());
        let fresh = VdbGrid::new("fresh", tree, world_from_index, kind).unwrap();
        let fresh = self.stage.world().resource_mut::<Assets<VdbGrid>>().add(fresh);
        self.show(&fresh);
        let picture = self.picture();
        let grid = self.grid.clone();
        self.show(&grid);
        picture
    }

    fn show(&mut self, grid: &Handle<VdbGrid>) {
        *self.stage.world().get_mut::<VdbVolume>(self.volume).unwrap() = VdbVolume(grid.clone());
    }

    fn usage(&mut self) -> VdbGpuUsage {
        self.stage.world().resource::<VdbGpuUsage>().clone()
    }

    /// Bytes that one frame sends to the pool.
    fn written(&mut self) -> u64 {
        let usage = self.usage();
        let before = usage.bytes_written();
        self.stage.update(1);
        usage.bytes_written() - before
    }
}

fn kind_name(kind: PackKind) -> &'static str {
    match kind {
        PackKind::Surface { .. } => "voxels",
        PackKind::Smooth { .. } => "smooth",
        PackKind::Fog => "fog",
    }
}

#[gpu_test]
#[ignore = "slow: each edit is compared with a grid of its own"]
fn what_is_edited_looks_as_if_it_had_been_made_so() {
    for kind in [SURFACE, SMOOTH, PackKind::Fog] {
        let mut scene = Scene::new(kind);
        let mut last = scene.picture();
        last.save(&format!("edits_{}_before", kind_name(kind)));
        // The first packs everything anew; the last goes beyond what there was, by several regions.
        let balls = [
            (IVec3::new(9, 12, 14), 9.0, true),
            (IVec3::new(-14, 14, 6), 7.0, false),
            (IVec3::new(-18, 16, 8), 5.0, true),
            (IVec3::new(60, -40, -30), 30.0, false),
        ];
        for (i, (middle, radius, dig)) in balls.into_iter().enumerate() {
            scene.ball(middle, radius, dig);
            let edited = scene.picture();
            edited.save(&format!("edits_{}_{i}", kind_name(kind)));
            assert!(edited != last, "{kind:?}: edit {i} is not seen");
            assert!(edited == scene.picture_from_scratch(), "{kind:?}: edit {i}");
            assert!(edited == scene.picture(), "{kind:?}: edit {i}, shown again");
            last = edited;
        }
        // As if loaded: no room to spare, and the same picture.
        let with_room = scene.usage().bytes_used();
        let mut grids = scene.stage.world().resource_mut::<Assets<VdbGrid>>();
        grids.get_mut(&scene.grid).unwrap().finish_edits().unwrap();
        assert!(scene.picture() == last && !scene.own().is_edited(), "{kind:?}");
        assert!(scene.usage().bytes_used() < with_room);
    }
}

#[gpu_test]
fn a_frame_sends_what_its_edits_have_changed() {
    let mut scene = Scene::new(SMOOTH);
    scene.picture();
    let dot = |scene: &mut Scene, x: i32| {
        scene.edit(|voxels| voxels.set(IVec3::new(x, 19, 0), -1.0));
    };
    dot(&mut scene, 0);
    let whole = scene.written();
    let bytes = scene.own().packed().bytes();
    assert!(whole >= bytes, "{whole} bytes for a grid of {bytes}");
    assert_eq!(scene.written(), 0, "a frame without an edit");
    let buffers = scene.usage().bytes();
    dot(&mut scene, 1);
    let one = scene.written();
    scene.ball(IVec3::new(0, 20, 0), 6.0, true);
    let ball = scene.written();
    println!("{whole} bytes for all, {one} for a voxel, {ball} for a ball");
    // A voxel has samples in eight leaves at most, of 4 KiB; a ball of 13³ in some thirty.
    assert!(0 < one && one < 8 << 12 && one < ball && ball < 40 << 12 && ball < bytes / 2);
    assert_eq!(scene.usage().bytes(), buffers, "the pool was made anew");

    // Several edits before a frame, and none of them lost.
    (0..40).for_each(|i| dot(&mut scene, i - 20));
    let many = scene.written();
    assert!(0 < many && many < bytes / 2, "{many} bytes for 40 voxels");
    let edited = scene.picture();
    assert!(edited == scene.picture_from_scratch());

    // Edited while it is not shown: more often than anyone remembers.
    let torus = scene.stage.grid(level_set::torus(DVec3::ZERO, 9.0, 3.0), SURFACE, VOXEL);
    scene.show(&torus);
    scene.stage.update(1);
    for i in 0..100 {
        scene.ball(IVec3::new(i % 20 - 10, i % 7, 18), 3.0 + (i % 3) as f32, i % 2 == 0);
    }
    assert_eq!(scene.written(), 0, "of a grid that is not shown");
    let grid = scene.grid.clone();
    scene.show(&grid);
    let edited = scene.picture();
    assert!(edited == scene.picture_from_scratch());
    assert_eq!(scene.usage().grids(), 2);
}

#[gpu_test]
fn a_clone_goes_its_own_way() {
    let mut scene = Scene::new(SURFACE);
    scene.ball(IVec3::new(9, 12, 14), 9.0, true);
    let first = scene.picture();
    let clone = scene.own().clone();
    scene.ball(IVec3::new(-9, 12, 14), 9.0, true);
    let both = scene.picture();
    assert!(both != first);
    // The asset becomes what it was, with the pool none the wiser but for its revision.
    let id = scene.grid.id();
    scene.stage.world().resource_mut::<Assets<VdbGrid>>().insert(id, clone).unwrap();
    assert!(scene.picture() == first);
    scene.ball(IVec3::new(-9, 12, 14), 9.0, true);
    assert!(scene.picture() == both);
}

#[gpu_test]
fn rays_of_the_cpu_meet_an_edit_at_once() {
    let mut scene = Scene::new(SMOOTH);
    scene.stage.update(2);
    let height = |scene: &mut Scene| {
        let cast = |volumes: VdbSpatialQuery| {
            let ray = Ray3d::new(Vec3::new(0.0, 10.0, 0.0), Dir3::NEG_Y);
            volumes.cast_ray_nearest(ray, &VdbRayCastSettings::default()).map(|hit| hit.position.y)
        };
        scene.stage.world().run_system_once(cast).unwrap().unwrap()
    };
    assert!((height(&mut scene) - 2.0).abs() < 0.01);
    scene.ball(IVec3::new(0, 20, 0), 8.0, true);
    assert!((height(&mut scene) - 1.2).abs() < 0.01, "{}", height(&mut scene));
    scene.ball(IVec3::new(0, 30, 0), 5.0, false);
    assert!((height(&mut scene) - 3.5).abs() < 0.01, "{}", height(&mut scene));
}
