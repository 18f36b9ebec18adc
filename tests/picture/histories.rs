//! Random histories of a world: whatever has been spawned, changed and removed before, the picture is that of a world
//! which has just been made of the same components.

use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbClipPlane, VdbClippedBy, VdbEmission, VdbGpuUsage, VdbGrid, VdbMaterial,
    VdbQuality, VdbReloadShaders, VdbRenderMode, VdbVolume, VdbVoxel,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking};

const VOXEL: f64 = 0.1;
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };

/// A sun with shadows, and where it shines from.
fn sun_from(from: Vec3) -> (DirectionalLight, Transform) {
    let sun = DirectionalLight { illuminance: 3.0, shadow_maps_enabled: true, ..default() };
    (sun, Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::Y))
}

/// A world that changes at random, and one that is made anew to be compared with it.
struct History {
    random: Random,
    live: Stage,
    target: Handle<Image>,
    camera: Entity,
    fresh: Stage,
    log: Vec<String>,
}

impl History {
    fn new(seed: u64) -> Self {
        let mut live = Stage::new();
        let target = live.target(SIZE);
        let camera = live.camera(&target, looking(Vec3::new(2.0, 3.0, 6.0)));
        live.world().spawn(sun_from(Vec3::ONE));
        let random = Random::new(seed);
        Self { random, live, target, camera, fresh: Stage::new(), log: Vec::new() }
    }

    fn chance(&mut self, share: f64) -> bool {
        self.random.unit() < share
    }

    fn vector(&mut self, low: f64, high: f64) -> Vec3 {
        DVec3::from_array(std::array::from_fn(|_| self.random.range(low, high))).as_vec3()
    }

    /// A random placement: rotated, unevenly scaled, sometimes mirrored.
    fn place(&mut self) -> Transform {
        let turn = self.vector(0.0, 6.0);
        let scale = self.vector(0.6, 1.2)
            * if self.chance(0.2) { Vec3::new(1.0, 1.0, -1.0) } else { Vec3::ONE };
        Transform {
            translation: self.vector(-1.8, 1.8),
            rotation: Quat::from_euler(EulerRot::XYZ, turn.x, turn.y, turn.z),
            scale,
        }
    }

    fn grid(&mut self, fogs_only: bool) -> Handle<VdbGrid> {
        let radius = self.random.range(6.0, 11.0);
        let (tree, kind) = match self.random.below(if fogs_only { 2 } else { 4 }) {
            0 => (fog::sphere(DVec3::ZERO, radius, 4.0), PackKind::Fog),
            1 => {
                let half = radius as i32 / 2;
                let cube = CoordBox { min: IVec3::splat(-half), max: IVec3::splat(half) };
                (fog::block(cube, 0.7), PackKind::Fog)
            }
            2 => (level_set::sphere(DVec3::ZERO, radius), SURFACE),
            _ => (level_set::torus(DVec3::ZERO, radius, 3.0), SMOOTH),
        };
        self.live.grid(tree, kind, VOXEL)
    }

    fn material(&mut self) -> VdbMaterial {
        let color = self.vector(0.1, 0.9);
        VdbMaterial {
            base_color: Color::linear_rgb(color.x, color.y, color.z),
            density_scale: self.random.range(1.0, 6.0) as f32,
            anisotropy: self.random.range(-0.3, 0.6) as f32,
            perceptual_roughness: 0.6,
            ..default()
        }
    }

    fn pick<T: Component>(&mut self) -> Option<Entity> {
        let world = self.live.world();
        let all: Vec<Entity> = world.query_filtered::<Entity, With<T>>().iter(world).collect();
        (!all.is_empty()).then(|| all[self.random.below(all.len() as u64) as usize])
    }

    /// Makes one random change, such as an app could make in any frame.
    fn change(&mut self) {
        let what = self.random.below(14);
        self.log.push(format!("{what}"));
        let volume = self.pick::<VdbVolume>();
        match (what, volume) {
            (0 | 1, _) | (_, None) => {
                let bundle = (VdbVolume(self.grid(false)), self.material(), self.place());
                self.live.world().spawn(bundle);
            }
            (2, Some(volume)) => _ = self.live.world().despawn(volume),
            (3, Some(volume)) => {
                let place = self.place();
                self.live.world().entity_mut(volume).insert(place);
            }
            (4, Some(volume)) => {
                let shown =
                    [Visibility::Hidden, Visibility::Visible][usize::from(self.chance(0.6))];
                self.live.world().entity_mut(volume).insert(shown);
            }
            (5, Some(volume)) => {
                let material = self.material();
                self.live.world().entity_mut(volume).insert(material);
            }
            (6, Some(volume)) => {
                let shared = self.pick::<VdbVolume>().unwrap();
                let shared = self.live.world().get::<VdbVolume>(shared).unwrap().clone();
                self.live.world().entity_mut(volume).insert(shared);
            }
            (7, Some(volume)) => {
                let grid = VdbVolume(self.grid(false));
                self.live.world().entity_mut(volume).insert(grid);
            }
            (8, Some(volume)) => self.edit(volume),
            (9, Some(volume)) => {
                if self.chance(0.5) {
                    let fire = VdbEmission::Scalar {
                        grid: self.grid(true),
                        color: LinearRgba::rgb(0.3, 0.1, 0.0),
                    };
                    self.live.world().entity_mut(volume).insert(fire);
                } else {
                    self.live.world().entity_mut(volume).remove::<VdbEmission>();
                }
            }
            (10, Some(volume)) => self.clip(volume),
            (11, _) => self.light(),
            (12, _) => self.look(),
            (_, _) => {
                VdbReloadShaders.apply(self.live.world());
            }
        }
    }

    /// Fills a ball of voxels or empties it.
    fn edit(&mut self, volume: Entity) {
        let middle = self.vector(-8.0, 8.0).as_ivec3();
        let dig = self.chance(0.5);
        let handle = self.live.world().get::<VdbVolume>(volume).unwrap().0.clone();
        let mut grids = self.live.world().resource_mut::<Assets<VdbGrid>>();
        let mut grid = grids.get_mut(&handle).unwrap();
        let is_fog = grid.kind() == PackKind::Fog;
        let bbox = CoordBox { min: middle - 6, max: middle + 6 };
        let made = grid.edit(|voxels| {
            voxels.update(bbox, |ijk, old| {
                let distance = ((ijk - middle).as_vec3().length() - 3.0).clamp(-3.0, 3.0);
                let value = match (is_fog, dig) {
                    (true, true) => old.value * distance.max(0.0) / 3.0,
                    (true, false) => old.value.max(-distance / 3.0),
                    (false, true) => old.value.max(-distance),
                    (false, false) => old.value.min(distance),
                };
                VdbVoxel { value, active: true }
            });
        });
        made.unwrap();
    }

    fn clip(&mut self, volume: Entity) {
        if self.chance(0.4) {
            self.live.world().entity_mut(volume).remove::<VdbClippedBy>();
            return;
        }
        let place = Transform { scale: Vec3::ONE, ..self.place() };
        let plane = self.live.world().spawn((VdbClipPlane, place)).id();
        self.live.world().entity_mut(volume).insert(VdbClippedBy(vec![plane]));
    }

    fn light(&mut self) {
        let from = self.vector(1.0, 4.0);
        let lamp = self.pick::<PointLight>();
        let sun = self.pick::<DirectionalLight>();
        let world = self.live.world();
        match (self.random.below(4), sun, lamp) {
            (0, Some(sun), _) => _ = world.despawn(sun),
            (1, _, Some(lamp)) => _ = world.despawn(lamp),
            (2, _, None) => {
                let lamp = PointLight { intensity: 300.0, ..default() };
                world.spawn((lamp, Transform::from_translation(from)));
            }
            (_, Some(sun), _) => _ = world.entity_mut(sun).insert(sun_from(from)),
            (_, None, _) => _ = world.spawn(sun_from(from)),
        }
    }

    /// Another quality, mode or view.
    fn look(&mut self) {
        let presets = [VdbQuality::EXACT, VdbQuality::HIGH, VdbQuality::BALANCED, VdbQuality::FAST];
        let quality = presets[self.random.below(4) as usize];
        let modes =
            [VdbRenderMode::Lit, VdbRenderMode::Lit, VdbRenderMode::Normals, VdbRenderMode::Depth];
        let mode = modes[self.random.below(4) as usize];
        let from = self.vector(1.0, 3.0).normalize() * 7.0;
        let camera = VdbCamera { mode, multiple_scattering: self.chance(0.5), ..default() };
        // Levels of detail arrive in their own time, and means depend on the frames before.
        let quality = VdbQuality { detail: 0.0, accumulate: 0, resolution: 1.0, ..quality };
        self.live.world().entity_mut(self.camera).insert((camera, quality, looking(from)));
    }

    /// The picture of a world that has just been made of the same components.
    fn picture_from_scratch(&mut self) -> Picture {
        let Self { live, fresh, camera, .. } = self;
        fresh.clear();
        let target = fresh.target(SIZE);
        let view = *live.world().get::<Transform>(*camera).unwrap();
        let own = fresh.camera(&target, view);
        let world = live.world();
        let seen = (
            world.get::<VdbCamera>(*camera).unwrap().clone(),
            *world.get::<VdbQuality>(*camera).unwrap(),
        );
        fresh.world().entity_mut(own).insert(seen);
        let anew = |fresh: &mut Stage, grid: &VdbGrid| {
            let world_from_index = DAffine3::from_scale(DVec3::splat(VOXEL));
            let tree = grid.tree().unwrap().as_ref().clone();
            let grid = VdbGrid::new("fresh", tree, world_from_index, grid.kind()).unwrap();
            fresh.world().resource_mut::<Assets<VdbGrid>>().add(grid)
        };
        let mut volumes = world.query::<(
            &VdbVolume,
            &VdbMaterial,
            &Transform,
            &Visibility,
            Option<&VdbEmission>,
            Option<&VdbClippedBy>,
        )>();
        let grids = world.resource::<Assets<VdbGrid>>();
        for (volume, material, place, shown, emission, clipped) in volumes.iter(world) {
            let grid = anew(fresh, grids.get(&volume.0).unwrap());
            let entity =
                fresh.world().spawn((VdbVolume(grid), material.clone(), *place, *shown)).id();
            if let Some(VdbEmission::Scalar { grid, color }) = emission {
                let grid = anew(fresh, grids.get(grid).unwrap());
                let fire = VdbEmission::Scalar { grid, color: *color };
                fresh.world().entity_mut(entity).insert(fire);
            }
            if let Some(VdbClippedBy(planes)) = clipped {
                let place = *world.get::<Transform>(planes[0]).unwrap();
                let plane = fresh.world().spawn((VdbClipPlane, place)).id();
                fresh.world().entity_mut(entity).insert(VdbClippedBy(vec![plane]));
            }
        }
        let mut suns = world.query::<(&DirectionalLight, &Transform)>();
        for (sun, place) in suns.iter(world) {
            fresh.world().spawn((*sun, *place));
        }
        let mut lamps = world.query::<(&PointLight, &Transform)>();
        for (lamp, place) in lamps.iter(world) {
            fresh.world().spawn((*lamp, *place));
        }
        fresh.picture(&target)
    }

    /// Compares the picture with that of a new world. Returns the number of pixels that show something.
    fn check(&mut self, name: &str) -> usize {
        let found = self.live.picture(&self.target);
        let expected = self.picture_from_scratch();
        // The two worlds list volumes and lights in different orders, in which sums of light are rounded differently,
        // to 16-bit floats between passes: by a few times 2⁻¹¹. What a history must not leave behind, such as a
        // volume, a shadow or a setting, changes pixels by more.
        let off =
            |(a, b): (&Vec4, &Vec4)| (*a - *b).abs().max_element() > 0.01 * (0.1 + b.max_element());
        let wrong = found.pixels.iter().zip(&expected.pixels).filter(|pair| off(*pair)).count();
        let shown = expected.count(|pixel| pixel.truncate() != Vec3::ZERO);
        println!(
            "{name}: {shown} pixels show something, {wrong} differ after {}",
            self.log.join(" ")
        );
        if wrong > 0 {
            found.save(&format!("{name}_found"));
            expected.save(&format!("{name}_expected"));
        }
        assert!(wrong == 0, "{wrong} of {shown} pixels differ after {}", self.log.join(" "));
        shown
    }
}

/// Follows a history, some changes per frame, and compares after every ten of them.
fn follow(seed: u64, changes: usize) {
    let mut history = History::new(seed);
    let mut most_shown = 0;
    for i in 1..=changes {
        history.change();
        if history.chance(0.6) {
            let frames = 1 + history.random.below(3) as usize;
            history.live.update(frames);
        }
        if i % 10 == 0 {
            most_shown = most_shown.max(history.check(&format!("history_{seed}_{i}")));
        }
    }
    assert!(most_shown > 0, "nothing is visible in any picture of history {seed}");
    history.live.clear();
    history.live.update(3);
    let usage = history.live.world().resource::<VdbGpuUsage>().clone();
    assert_eq!((usage.grids(), usage.bytes()), (0, 0), "memory that nothing needs");
}

/// `VDB_HISTORIES=N` follows N histories of 40 changes, each with its own seed.
#[gpu_test]
#[ignore = "slow: hundreds of changes, with the shaders that they need"]
fn a_history_leaves_no_trace() {
    let histories = std::env::var("VDB_HISTORIES").map_or(1, |n| n.parse().unwrap());
    (1..=histories).for_each(|seed| follow(seed, 40));
}
