//! Surfaces in pages: a terrain that reaches from the camera's feet to the horizon.

mod borders;

use std::fs;
use std::path::{Path, PathBuf};

use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbGrid, VdbPagedVolume, VdbPages, VdbPagesStatus, VdbRenderMode, VdbVolume,
    VdbVolumeState,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::pages::{FunctionSource, PageIndex, PageOptions, PageSource};
use vdb_core::synth::level_set;
use vdb_core::tree::CoordBox;

use super::common::{Picture, Stage};
use super::files::temporary;
use super::flip::{flip, mean};
use super::levels_within::{above_hills, hills};
use super::materials::{Painted, add_materials};
use super::pages_folder;
use super::{SIZE, SURFACE, pixel_ray};

const VOXEL: f64 = 0.02;
const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };
/// The corners of the terrain, in voxels. No border between pages is at its edge.
const LOW: IVec3 = IVec3::new(-300, -40, -700);
const HIGH: IVec3 = IVec3::new(300, 40, 50);

/// The distance from the hills in voxels, given a voxel.
fn distance(at: DVec3) -> f64 {
    // Dividing by 1.2 keeps the Lipschitz constant below 1 on the steepest slope.
    (at.y * VOXEL - hills(at.x * VOXEL, at.z * VOXEL).0) / (1.2 * VOXEL)
}

/// Writes the pages of the terrain. Returns the path of their index.
fn cook(name: &str, kind: PackKind) -> PathBuf {
    let bounds = [LOW, HIGH].map(|corner| corner.as_dvec3());
    let source =
        FunctionSource::new("hills", DAffine3::from_scale(DVec3::splat(VOXEL)), bounds, distance);
    let options = PageOptions { edge: 128, smooth: kind == SMOOTH, ..PageOptions::default() };
    cook_source(name, &source, &options)
}

/// Writes the pages of a source. Returns the path of their index.
fn cook_source(name: &str, source: &impl PageSource, options: &PageOptions) -> PathBuf {
    pages_folder::cook(&temporary("pages", name), source, options)
}

/// A stage with the sun above the terrain.
struct Land {
    stage: Stage,
    target: Handle<Image>,
    camera: Entity,
}

impl Land {
    fn new(view: Transform) -> Self {
        Self::with(Stage::new(), view)
    }

    fn with(mut stage: Stage, view: Transform) -> Self {
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, view);
        let sun = DirectionalLight { illuminance: 4.0, shadow_maps_enabled: true, ..default() };
        let low = Transform::from_xyz(3.0, 1.5, 1.0).looking_at(Vec3::ZERO, Vec3::Y);
        stage.world().spawn((sun, low));
        Self { stage, target, camera }
    }

    /// Spawns the terrain in pages, whose voxels are to be no larger than `detail` pixels.
    fn spawn(&mut self, index: &Path, detail: f32) -> Entity {
        let pages: Handle<VdbPages> =
            self.stage.world().resource::<AssetServer>().load(index.to_owned());
        let volume = VdbPagedVolume { detail, ..VdbPagedVolume::new(pages) };
        self.stage.world().spawn(volume).id()
    }

    /// Waits until all pages are there.
    fn complete(&mut self, terrain: Entity) -> VdbPagesStatus {
        for _ in 0..3_000 {
            self.stage.update(1);
            let status = *self.stage.world().get::<VdbPagesStatus>(terrain).unwrap();
            if status.is_complete && status.displayed > 0 {
                return status;
            }
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        panic!("never complete: {:?}", self.stage.world().get::<VdbPagesStatus>(terrain));
    }

    fn picture(&mut self, mode: VdbRenderMode, name: &str) -> Picture {
        let camera = VdbCamera { mode, ..default() };
        self.stage.world().entity_mut(self.camera).insert(camera);
        let picture = self.stage.picture(&self.target);
        picture.save(&format!("pages_{name}_{mode:?}"));
        picture
    }
}

/// A camera just above the near end of the terrain.
fn near() -> Transform {
    Transform::from_xyz(0.1, 1.0, 0.9).looking_at(Vec3::new(0.0, -0.3, -4.0), Vec3::Y)
}

/// A camera that sees nothing but terrain.
fn above() -> Transform {
    Transform::from_xyz(-1.3, 3.0, -5.0).looking_at(Vec3::new(-0.9, 0.0, -6.0), Vec3::Y)
}

/// The number of pixels of a picture of depths that show no terrain.
fn holes(depths: &Picture) -> usize {
    depths.count(|pixel| pixel.x == 0.0)
}

/// The number of pixels in which only one of two pictures of depths shows the terrain.
fn differing(a: &Picture, b: &Picture) -> usize {
    a.pixels.iter().zip(&b.pixels).filter(|(a, b)| (a.x == 0.0) != (b.x == 0.0)).count()
}

/// At full resolution, pages look like the whole grid, in shadow, too.
#[gpu_test]
fn pages_at_full_resolution_look_like_the_whole() {
    for (kind, name) in [(SMOOTH, "smooth"), (SURFACE, "voxels")] {
        let index = cook(&format!("full_{name}"), kind);
        let mut land = Land::new(near());
        // Cameras need no settings.
        land.stage.world().entity_mut(land.camera).remove::<VdbCamera>();
        let terrain = land.spawn(&index, 1e-6);
        let status = land.complete(terrain);
        assert!(status.displayed > 20, "{status:?}");
        let modes = [VdbRenderMode::Depth, VdbRenderMode::Lit];
        let paged = modes.map(|mode| land.picture(mode, name));
        land.stage.world().entity_mut(terrain).despawn();
        let bbox = CoordBox { min: LOW, max: HIGH };
        let whole = level_set::from_distance(bbox, distance);
        let grid: Handle<VdbGrid> = land.stage.grid(whole, kind, VOXEL);
        land.stage.world().spawn(VdbVolume(grid));
        let whole = modes.map(|mode| land.picture(mode, &format!("whole_{name}")));
        assert!(holes(&whole[0]) < 3_000, "little of the terrain is in view");
        let off = mean(&flip(&paged[1], &whole[1]));
        // Colours are 16-bit floats.
        let depths = paged[0].pixels.iter().zip(&whole[0].pixels);
        let deep = depths.filter(|(a, b)| (a.x - b.x).abs() > 1e-3 * b.x).count();
        println!("{name}: FLIP {off:.5}, {deep} depths differ");
        assert_eq!(differing(&paged[0], &whole[0]), 0, "{name}");
        assert!(deep == 0 && off < 1e-3, "{name}: {deep} depths, FLIP {off}");
    }
}

/// Where pages of several levels meet, no ray passes between them, and the surface is where its voxels
/// may be.
#[gpu_test]
#[ignore = "slow: large grids, and several pictures of each"]
fn pages_of_several_levels_have_no_holes() {
    for (kind, name, most) in [(SMOOTH, "smooth", 0.5), (SURFACE, "voxels", 2.0)] {
        let index = cook(&format!("levels_{name}"), kind);
        let mut land = Land::new(above());
        let terrain = land.spawn(&index, 3.0);
        for step in 0..4 {
            let at = above().translation + Vec3::new(0.03, 0.4, 0.1) * step as f32;
            let view = above().with_translation(at);
            *land.stage.world().get_mut::<Transform>(land.camera).unwrap() = view;
            land.complete(terrain);
            let levels = displayed_levels(&mut land, terrain);
            let depth = land.picture(VdbRenderMode::Depth, &format!("levels_{name}_{step}"));
            assert_eq!(holes(&depth), 0, "{name}");
            let mut worst = 0.0_f64;
            for (x, y) in (0..SIZE.x).flat_map(|x| (0..SIZE.y).map(move |y| (x, y))) {
                let (origin, dir) = pixel_ray(view, x, y);
                // Bevy's reversed depth, with a near plane of 0.1.
                let t = 0.1 / f64::from(depth.at(x, y).x);
                let pixel = 2.0 * (22.5_f64.to_radians()).tan() / f64::from(SIZE.y);
                let voxel = (3.0 * t * pixel).max(VOXEL);
                worst = worst.max(above_hills(origin + t * dir).abs() / voxel);
            }
            println!("{name}: levels {levels:?}, off by at most {worst:.2} of the largest voxels");
            assert!(levels[0] > 0 || levels.len() > 1, "{levels:?}");
            assert!(worst > 0.0 && worst < most, "{name}: {worst}");
        }
    }
}

/// The number of displayed pages of each level.
fn displayed_levels(land: &mut Land, terrain: Entity) -> Vec<usize> {
    let world = land.stage.world();
    let children: Vec<Entity> = world.get::<Children>(terrain).unwrap().iter().collect();
    let mut levels = Vec::new();
    for page in children {
        if world.get::<InheritedVisibility>(page).unwrap().get() {
            let name = world.get::<Name>(page).unwrap().as_str().to_owned();
            let level: usize = name["page ".len()..].split('/').next().unwrap().parse().unwrap();
            levels.resize(levels.len().max(level + 1), 0);
            levels[level] += 1;
        }
    }
    levels
}

/// Pages that are cut anew replace those of the index before, at other borders, too.
#[gpu_test]
#[ignore = "slow: cooks two surfaces"]
fn an_index_that_is_loaded_again_brings_its_own_pages() {
    let path = cook("again", SMOOTH);
    let mut land = Land::new(above());
    let terrain = land.spawn(&path, 1e-6);
    let before = land.complete(terrain);
    let plain = |at: DVec3| at.y + 20.0;
    let bounds = [LOW, HIGH].map(|corner| corner.as_dvec3());
    let scale = DAffine3::from_scale(DVec3::splat(VOXEL));
    let source = FunctionSource::new("plain", scale, bounds, plain);
    cook_source(
        "again",
        &source,
        &PageOptions { edge: 256, smooth: true, ..PageOptions::default() },
    );
    land.stage.world().resource::<AssetServer>().clone().reload(path);
    for _ in 0..1_000 {
        land.stage.update(1);
        if land.stage.world().get::<VdbPagesStatus>(terrain) != Some(&before) {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let after = land.complete(terrain);
    assert!(after.displayed < before.displayed, "{before:?}, {after:?}");
    let depths = land.picture(VdbRenderMode::Depth, "again");
    let (origin, dir) = pixel_ray(above(), SIZE.x / 2, SIZE.y / 2);
    let t = 0.1 / f64::from(depths.center().x);
    assert!(((origin + t * dir).y + 20.0 * VOXEL).abs() < 0.01, "{}", origin + t * dir);
}

/// From the first frame that shows the terrain, every frame shows all of it, while pages arrive one
/// by one and the camera jumps.
#[gpu_test]
#[ignore = "slow: draws a hundred frames"]
fn nothing_is_missing_while_pages_arrive() {
    let index = cook("arrive", SMOOTH);
    let mut land = Land::new(above());
    let terrain = land.spawn(&index, 1e-6);
    let camera = VdbCamera { mode: VdbRenderMode::Depth, ..default() };
    land.stage.world().entity_mut(land.camera).insert(camera);
    // Compiles what draws the terrain.
    land.complete(terrain);
    land.stage.picture(&land.target);
    land.stage.world().entity_mut(terrain).despawn();
    let terrain = land.spawn(&index, 1e-6);
    land.stage.world().get_mut::<VdbPagedVolume>(terrain).unwrap().max_loading = 1;
    let (mut seen, mut most, mut before) = (0, 0, 0);
    for frame in 0..400 {
        if frame % 40 == 39 {
            let mut at = land.stage.world().get_mut::<Transform>(land.camera).unwrap();
            at.translation.z += if frame % 80 == 39 { -5.0 } else { 5.0 };
        }
        let picture = land.stage.picture(&land.target);
        let status = *land.stage.world().get::<VdbPagesStatus>(terrain).unwrap();
        if seen > 0 || holes(&picture) == 0 {
            assert_eq!(holes(&picture), 0, "frame {frame}: {status:?}");
            seen += 1;
            most = most.max(status.missing);
        }
        if status.is_complete && frame > 100 {
            break;
        }
        before = before.max(status.missing);
    }
    println!("{seen} whole frames, one of them with {most} of {before} pages missing");
    assert!(seen > 20 && before > 5, "{seen} frames, at most {before} pages missing");
    // The pages of the coarsest level are enough.
    assert!(most + 10 >= before, "no whole frame had {before} pages missing, only {most}");
}

/// Memory stays below the ceiling: what is farther away has larger voxels.
#[gpu_test]
#[ignore = "slow: loads all pages"]
fn pages_stay_below_their_ceiling() {
    let path = cook("ceiling", SMOOTH);
    let index =
        PageIndex::read(&fs::read(&path).unwrap(), &bevy_vdb::VdbLimits::default()).unwrap();
    let roots: u64 = index.roots().map(|id| index.pages[&id].packed_bytes).sum();
    let all: u64 = index.pages.values().map(|page| page.packed_bytes).sum();
    let mut land = Land::new(above());
    let terrain = land.spawn(&path, 1e-6);
    for max_bytes in [0, all / 4, all / 2, u64::MAX, all / 4] {
        land.stage.world().get_mut::<VdbPagedVolume>(terrain).unwrap().max_bytes = max_bytes;
        land.stage.update(2);
        let status = land.complete(terrain);
        println!("{max_bytes} bytes: {status:?}");
        assert!(status.bytes <= max_bytes.max(roots), "{status:?}");
        assert_eq!(status.without_room == 0, max_bytes == u64::MAX);
        let picture = land.picture(VdbRenderMode::Depth, &format!("ceiling_{max_bytes}"));
        assert_eq!(holes(&picture), 0, "{max_bytes}");
    }
}

/// A page that is missing or damaged is covered by the coarser one; an index that is damaged fails.
#[gpu_test]
fn broken_pages_leave_coarser_ones() {
    let path = cook("broken", SMOOTH);
    let folder = path.parent().unwrap();
    let mut files: Vec<_> =
        fs::read_dir(folder.join("0")).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    fs::remove_file(&files[0]).unwrap();
    let middle = files.len() / 2;
    fs::write(&files[middle], b"no page").unwrap();
    let mut land = Land::new(above());
    let terrain = land.spawn(&path, 1e-6);
    let status = land.complete(terrain);
    let picture = land.picture(VdbRenderMode::Depth, "broken");
    assert_eq!((status.failed, holes(&picture)), (2, 0), "{status:?}");
    land.stage.world().entity_mut(terrain).despawn();
    let damaged = folder.join("damaged.vdbpages");
    fs::write(&damaged, b"no index").unwrap();
    let terrain = land.spawn(&damaged, 1.0);
    let pages = land.stage.world().get::<VdbPagedVolume>(terrain).unwrap().pages.clone();
    for _ in 0..1_000 {
        land.stage.update(1);
        if land.stage.world().resource::<AssetServer>().load_state(&pages).is_failed() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    assert!(land.stage.world().resource::<AssetServer>().load_state(&pages).is_failed());
    let status = *land.stage.world().get::<VdbPagesStatus>(terrain).unwrap();
    assert_eq!(status, VdbPagesStatus::default(), "of a damaged index");
}

#[gpu_test]
fn a_custom_material_is_that_of_all_pages() {
    let path = cook("painted", SMOOTH);
    let mut land = Land::with(Stage::with(add_materials), above());
    let terrain = land.spawn(&path, 4.0);
    let red = Painted { base_color: LinearRgba::RED, perceptual_roughness: 0.5, ..default() };
    land.stage.world().entity_mut(terrain).insert(red);
    land.complete(terrain);
    let picture = land.picture(VdbRenderMode::Lit, "painted");
    let pixel = picture.center();
    assert!(pixel.x > 0.05 && pixel.y < 0.1 * pixel.x, "{pixel}");
}

/// Pages have the settings of their volume, and leave with it.
#[gpu_test]
fn pages_have_the_settings_of_their_volume() {
    use bevy::camera::visibility::RenderLayers;
    use bevy::light::NotShadowCaster;
    use bevy_vdb::VdbMaterial;

    let path = cook("settings", SMOOTH);
    let mut land = Land::new(above());
    let terrain = land.spawn(&path, 4.0);
    let red = VdbMaterial { base_color: Color::linear_rgb(1.0, 0.0, 0.0), ..default() };
    land.stage.world().entity_mut(terrain).insert((red.clone(), NotShadowCaster));
    land.complete(terrain);
    let picture = land.picture(VdbRenderMode::Lit, "red");
    assert!(
        picture.center().x > 0.05 && picture.center().y < 0.5 * picture.center().x,
        "{}",
        picture.center()
    );
    let pages = |land: &mut Land| -> Vec<Entity> {
        land.stage.world().get::<Children>(terrain).unwrap().iter().collect()
    };
    for page in pages(&mut land) {
        let world = land.stage.world();
        assert_eq!(world.get::<VdbMaterial>(page), Some(&red));
        assert!(world.get::<NotShadowCaster>(page).is_some());
    }
    let other = RenderLayers::layer(3);
    land.stage.world().entity_mut(terrain).remove::<NotShadowCaster>().insert(other);
    land.stage.update(2);
    assert_eq!(
        holes(&land.picture(VdbRenderMode::Depth, "other_layer")),
        (SIZE.x * SIZE.y) as usize
    );
    let all = pages(&mut land);
    assert!(land.stage.world().get::<NotShadowCaster>(all[0]).is_none());
    land.stage.world().entity_mut(terrain).remove::<VdbPagedVolume>();
    land.stage.update(2);
    assert!(all.iter().all(|page| land.stage.world().get::<VdbVolumeState>(*page).is_none()));
}
