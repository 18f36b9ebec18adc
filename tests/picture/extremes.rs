//! Numbers that no artist would type, and identities that hold for all of them.

use bevy::camera::{Exposure, RenderTarget};
use bevy::light::EnvironmentMapLight;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{VdbCamera, VdbGrid, VdbMaterial, VdbRenderMode, VdbVolume};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::synth::{Uniform, build, fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};

use super::common::{Picture, Stage};
use super::{SIZE, SURFACE, looking};

const SMOOTH: PackKind = PackKind::Smooth { iso: 0.0 };
/// Numbers that an app may set by mistake.
const ODD: [f32; 5] = [0.0, -1.0, f32::MAX, f32::INFINITY, f32::NAN];

/// A grid and the look of it, alone before a camera, lit by a sun and the sky.
fn shown(
    stage: &mut Stage,
    grid: VdbGrid,
    material: VdbMaterial,
    prepare: impl FnOnce(&mut World),
) -> Picture {
    stage.clear();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::new(3.1, 4.7, 6.3)));
    let world = stage.world();
    let grid = world.resource_mut::<Assets<VdbGrid>>().add(grid);
    world.spawn((VdbVolume(grid), material));
    let light = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
    world.spawn((DirectionalLight { illuminance: 3.0, ..default() }, light));
    world.entity_mut(camera).insert(AmbientLight { brightness: 0.25, ..default() });
    prepare(world);
    stage.picture(&target)
}

/// A ball or a torus at a place in index space, put back to the world's origin by its transform.
fn shifted(kind: PackKind, shift: IVec3) -> VdbGrid {
    // Powers of two, and an eye in f32, so that f64 can add any shift to a place without rounding.
    const VOXEL: f64 = 0.125;
    let center = shift.as_dvec3() + DVec3::new(0.25, -0.5, 0.125);
    let tree = match kind {
        PackKind::Fog => fog::sphere(center, 15.0, 6.0),
        _ => level_set::torus(center, 12.0, 5.3),
    };
    let world_from_index =
        DAffine3::from_scale(DVec3::splat(VOXEL)) * DAffine3::from_translation(-shift.as_dvec3());
    VdbGrid::new("shifted", tree, world_from_index, kind).unwrap()
}

#[gpu_test]
fn a_grid_looks_the_same_wherever_in_index_space_it_lies() {
    let shift = IVec3::new((1 << 30) - 12_345, -(1 << 29) - 77, 1_000_003);
    let mut stage = Stage::new();
    for kind in [SURFACE, SMOOTH, PackKind::Fog] {
        let mut picture =
            |shift| shown(&mut stage, shifted(kind, shift), VdbMaterial::default(), |_| {});
        let (here, there) = (picture(IVec3::ZERO), picture(shift));
        let seen = here.count(|pixel| pixel.x > 0.0);
        assert!(seen > 500, "{seen} pixels of {kind:?}");
        let differ = here.pixels.iter().zip(&there.pixels).filter(|(a, b)| a != b).count();
        assert_eq!(differ, 0, "pixels of {kind:?} differ, of {seen}");
    }
}

/// What shines evenly on a thing that loses no light is seen wherever one looks.
#[gpu_test]
fn a_white_furnace_keeps_its_light() {
    let ball = || level_set::sphere(DVec3::ZERO, 20.0);
    let cloud = || fog::sphere(DVec3::ZERO, 25.0, 12.0);
    let mut stage = Stage::new();
    // Numbers that 16-bit floats have, as radiance, coverage and the picture are made of them: each
    // rounds by up to 0.025 % of 1.
    for light in [0.75, 1.0, 6.5, 960.0] {
        for (tree, kind) in [(ball(), SURFACE), (ball(), SMOOTH), (cloud(), PackKind::Fog)] {
            let scale = DAffine3::from_scale(DVec3::splat(0.1));
            let grid = VdbGrid::new("white", tree, scale, kind).unwrap();
            let mut furnace = |base_color| {
                shown(&mut stage, grid.clone(), VdbMaterial { base_color, ..default() }, |world| {
                    world.insert_resource(ClearColor(Color::linear_rgb(light, light, light)));
                    let mut cameras = world.query_filtered::<Entity, With<Camera3d>>();
                    let camera = cameras.single(world).unwrap();
                    let mut images = world.resource_mut::<Assets<Image>>();
                    let map = EnvironmentMapLight::solid_color(&mut images, Color::WHITE);
                    let map = EnvironmentMapLight { intensity: light, ..map };
                    world.entity_mut(camera).remove::<AmbientLight>().insert(map);
                    let mut sun = world.query::<&mut DirectionalLight>();
                    sun.single_mut(world).unwrap().illuminance = 0.0;
                })
            };
            if light == 1.0 {
                let seen = furnace(Color::BLACK).count(|pixel| pixel.x < 0.9);
                assert!(seen > 500, "in black, {seen} pixels of {kind:?} would be seen");
            }
            let picture = furnace(Color::WHITE);
            let colors = picture.pixels.iter().flat_map(|pixel| pixel.truncate().to_array());
            let worst = colors.map(|c| (c / light - 1.0).abs()).fold(0.0, f32::max);
            println!("white furnace of {light}, {kind:?}: {:.3} % off at most", 100.0 * worst);
            assert!(worst <= 1e-3, "{kind:?}: {worst}");
        }
    }
}

/// Voxels whose densities are zero, denormal, huge, infinite, negative or no number.
fn densities() -> Vdb543<f32> {
    let kinds = [0.0, 1e-45, 0.5, 1e30, f32::MAX, f32::INFINITY, f32::NAN, -1.0, f32::NEG_INFINITY];
    let bbox = CoordBox { min: IVec3::splat(-15), max: IVec3::splat(15) };
    build(
        0.0,
        bbox,
        |_| Uniform::No,
        |ijk| {
            let kind = (ijk.x * 31 + ijk.y * 17 + ijk.z * 7).rem_euclid(97) as usize;
            kinds.get(kind).map_or((0.0, false), |density| (*density, true))
        },
    )
}

/// A colour whose green is 1.
fn color(x: f32) -> LinearRgba {
    LinearRgba::rgb(x, 1.0, 0.0)
}

/// Volumes in the columns and rows of a picture, each with one of these numbers in its material.
fn side_by_side(
    stage: &mut Stage,
    grid: &Handle<VdbGrid>,
    kind: PackKind,
    view: Transform,
) -> Vec<Entity> {
    let plain = VdbMaterial::default();
    let mut volumes = Vec::new();
    for (column, x) in ODD.into_iter().enumerate() {
        let [perceptual_roughness, metallic, reflectance] = [x; 3];
        let materials = [
            VdbMaterial { emissive: color(x), ..plain.clone() },
            VdbMaterial { base_color: color(x).into(), ..plain.clone() },
            VdbMaterial { perceptual_roughness, metallic, reflectance, ..plain.clone() },
            VdbMaterial { density_scale: x, ..plain.clone() },
        ];
        // The last is for fog alone.
        let wanted = if kind == PackKind::Fog { 4 } else { 3 };
        for (row, material) in materials.into_iter().take(wanted).enumerate() {
            let at = Vec2::new(column as f32 - 2.0, row as f32 - 1.5) * 0.8;
            let at = Transform::from_translation(view.transform_point(at.extend(-4.5)))
                .with_scale(Vec3::splat(0.2));
            volumes.push(stage.world().spawn((VdbVolume(grid.clone()), material, at)).id());
        }
    }
    volumes
}

#[gpu_test]
#[ignore = "slow: every odd number in every setting"]
fn no_pixel_is_infinite_or_no_number() {
    let mut stage = Stage::new();
    let target = stage.target(UVec2::new(32, 20));
    let view = looking(Vec3::new(1.0, 2.0, 4.0));
    let camera = stage.camera(&target, view);
    stage.world().entity_mut(camera).insert(AmbientLight { brightness: 0.25, ..default() });
    let light = Transform::default().looking_to(Vec3::new(-0.4, -1.0, -0.3), Vec3::Y);
    let sun = stage.world().spawn((DirectionalLight::default(), light)).id();
    let normal = Exposure { ev100: -(1.2_f32.log2()) };
    let mut huge = Vdb543::new(f32::MAX);
    for value in level_set::sphere(DVec3::ZERO, 12.0).values().filter(|v| v.log2_dim == 0) {
        huge.set(value.origin, value.value * 1e38);
    }
    let grids = [
        (densities(), PackKind::Fog),
        (level_set::sphere(DVec3::ZERO, 14.0), SURFACE),
        (huge.clone(), SURFACE),
        (huge, SMOOTH),
    ];
    let mut pictures = 0;
    for (tree, kind) in grids {
        let grid = stage.grid(tree, kind, 0.1);
        let volume = stage.world().spawn((VdbVolume(grid), VdbMaterial::default())).id();
        // Numbers as they are, then each of the material, the light and the camera on its own.
        let mut show = |material: VdbMaterial, illuminance, brightness, exposure| {
            let world = stage.world();
            world.entity_mut(volume).insert(material);
            world.entity_mut(sun).insert(DirectionalLight { illuminance, ..default() });
            let ambient = AmbientLight { brightness, ..default() };
            world.entity_mut(camera).insert((ambient, exposure));
            // Asserts that every pixel is finite.
            let picture = stage.picture(&target);
            pictures += 1;
            picture
        };
        let plain = VdbMaterial::default();
        let seen = show(plain.clone(), 3.0, 0.25, normal).count(|pixel| pixel.x > 0.0);
        assert!(seen > 50, "{seen} pixels of {kind:?}");
        for x in ODD {
            show(plain.clone(), x, 0.25, normal);
            show(plain.clone(), 3.0, x, normal);
        }
        for ev100 in [-200.0, -60.0, 200.0] {
            let all = VdbMaterial {
                base_color: color(f32::MAX).into(),
                emissive: color(f32::MAX),
                density_scale: f32::MAX,
                ..plain.clone()
            };
            show(all, f32::MAX, f32::MAX, Exposure { ev100 });
        }
        // Materials side by side, each alone on its rays.
        show(plain.clone(), 3.0, 0.25, normal);
        let grid = stage.world().get::<VdbVolume>(volume).unwrap().0.clone();
        stage.world().despawn(volume);
        let volumes = side_by_side(&mut stage, &grid, kind, view);
        let sheet = stage.target(SIZE);
        stage.world().entity_mut(camera).insert(RenderTarget::Image(sheet.clone().into()));
        let picture = stage.picture(&sheet);
        picture.save(&format!("odd_materials_{kind:?}"));
        // Green is 1 in all colours.
        let seen = picture.count(|pixel| pixel.y > 0.5);
        assert!(seen > 50, "{seen} pixels of {kind:?} in colours");
        stage.world().entity_mut(camera).insert(RenderTarget::Image(target.clone().into()));
        pictures += 1;
        volumes.into_iter().for_each(|volume| _ = stage.world().despawn(volume));
    }
    let grid = stage.grid(densities(), SMOOTH, 0.1);
    stage.world().spawn(VdbVolume(grid));
    for mode in VdbRenderMode::ALL.iter().copied().filter(|mode| !mode.is_lit()) {
        let scales = if mode == VdbRenderMode::Steps { &ODD[..] } else { &ODD[..1] };
        for &steps_scale in scales {
            stage.world().entity_mut(camera).insert(VdbCamera { mode, steps_scale, ..default() });
            stage.picture(&target);
            pictures += 1;
        }
    }
    println!("{pictures} pictures, every pixel finite");
}

/// However bright: nothing times infinity would be no number.
#[gpu_test]
fn opaque_fog_hides_what_is_behind() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    stage.world().entity_mut(camera).insert(Exposure { ev100: -60.0 });
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 14.0), SURFACE, 0.1);
    let bright = VdbMaterial { emissive: LinearRgba::rgb(f32::MAX, 1.0, 0.0), ..default() };
    stage.world().spawn((VdbVolume(grid), bright, Transform::from_xyz(0.0, 0.0, -4.0)));
    assert!(stage.picture(&target).center().x > 6e4, "the surface shines");
    let grid = stage.ball_of_fog(24.0, 6.0);
    let black = VdbMaterial { base_color: Color::BLACK, density_scale: f32::MAX, ..default() };
    stage.world().spawn((VdbVolume(grid), black));
    assert_eq!(stage.picture(&target).center().truncate(), Vec3::ZERO);
}
