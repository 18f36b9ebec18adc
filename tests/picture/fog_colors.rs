//! The colour of fog, from a grid of colours.

use bevy::light::NotShadowCaster;
use bevy::math::{DAffine3, DQuat, DVec3};
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbColorGrid, VdbGrid, VdbMaterial, VdbQuality, VdbVectorGrid, VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Dimming, Fog, Ray, emitted};
use vdb_core::synth::fog;
use vdb_core::tree::{CoordBox, Tree, Vdb543, join_values};

use super::common::{Picture, Stage};
use super::{SIZE, looking, pixel_ray};

const VOXEL: f64 = 0.1;

/// A transform that the fog's grid does not have.
fn elsewhere() -> DAffine3 {
    DAffine3::from_scale_rotation_translation(
        DVec3::new(0.07, 0.06, 0.09),
        DQuat::from_euler(EulerRot::XYZ, 0.4, -0.8, 1.3),
        DVec3::new(0.1, -0.05, 0.15),
    )
}

impl Stage {
    fn colors(&mut self, tree: Vdb543<[f32; 3]>, place: DAffine3) -> VdbColorGrid {
        let grid = VdbVectorGrid::new("Cd", tree, place).unwrap();
        VdbColorGrid(self.world().resource_mut::<Assets<VdbVectorGrid>>().add(grid))
    }

    fn sun(&mut self, shadow_maps_enabled: bool) -> Entity {
        let sun = DirectionalLight { illuminance: 10.0, shadow_maps_enabled, ..default() };
        self.world().spawn((sun, looking(Vec3::new(1.0, 2.0, 3.0)))).id()
    }
}

/// How fog comes to be lit: a name, whether the sun casts shadows, `fog_light_error`, and in how
/// many fogs the density is.
pub(super) type Way = (&'static str, bool, f32, usize);
pub(super) const WAYS: [Way; 5] = [
    ("without shadows", false, 0.0, 1),
    ("rays", true, 0.0, 1),
    ("cache", true, 0.01, 1),
    ("rays, two fogs", true, 0.0, 2),
    ("cache, two fogs", true, 0.01, 2),
];
/// One that has most of the code.
pub(super) const QUICK: &[Way] = &[WAYS[2]];

/// The largest difference of a picture from what each pixel's ray should have, relative to the
/// largest of these.
fn worst(picture: &Picture, view: Transform, expected: impl Fn(DVec3, DVec3) -> DVec3) -> f64 {
    let (mut largest, mut worst) = (0.0_f64, 0.0_f64);
    for y in (0..SIZE.y).step_by(2) {
        for x in (y / 2 % 3..SIZE.x).step_by(3) {
            let (origin, dir) = pixel_ray(view, x, y);
            let expected = expected(origin, dir);
            largest = largest.max(expected.max_element());
            let shown = picture.at(x, y).truncate().as_dvec3();
            worst = worst.max((shown - expected).abs().max_element());
        }
    }
    assert!(largest > 0.1, "something is seen: {largest}");
    worst / largest
}

#[gpu_test]
fn fog_scatters_light_in_the_colour_that_it_has_there() {
    check_scattering(QUICK);
}

#[gpu_test]
#[ignore = "slow: each way compiles shaders of its own"]
fn fog_scatters_light_in_its_colour_however_it_is_lit() {
    check_scattering(&WAYS);
}

/// Light scattered once, without shadows of the fog on itself: `∫ T σ ω E / 4π ds`.
fn check_scattering(ways: &[Way]) {
    let density = fog::block(CoordBox { min: IVec3::splat(-12), max: IVec3::splat(11) }, 1.0);
    // Within the part where the density is 1, so that the product with it is the colour.
    let parts = [
        fog::sphere(DVec3::new(-2.0, 1.0, 0.0), 8.0, 6.0),
        fog::sphere(DVec3::new(3.0, 2.0, -1.0), 7.0, 5.0),
        fog::sphere(DVec3::new(0.0, -3.0, 2.0), 7.0, 6.0),
    ];
    let mut stage = Stage::new();
    for &(name, shadows, fog_light_error, fogs) in ways {
        stage.clear();
        let target = stage.target(SIZE);
        let view = looking(Vec3::new(1.0, 0.8, 4.0));
        let camera = stage.camera(&target, view);
        let once = VdbCamera { multiple_scattering: false, ..default() };
        // Slabs hold one colour each.
        let quality = VdbQuality { fog_light_error, fog_slabs: 400, ..VdbQuality::EXACT };
        stage.world().entity_mut(camera).insert((once, quality));
        stage.sun(shadows);
        let sigma = 0.8;
        let base_color = Color::linear_rgb(1.0, 0.5, 0.75);
        let colors = stage.colors(join_values(parts.each_ref()), elsewhere());
        for _ in 0..fogs {
            let grid = stage.grid(density.clone(), PackKind::Fog, VOXEL);
            let density_scale = sigma / fogs as f32;
            let material = VdbMaterial { base_color, density_scale, ..default() };
            stage.world().spawn((VdbVolume(grid), material, colors.clone(), NotShadowCaster));
        }
        let picture = stage.picture(&target);
        picture.save(&format!("fog_colors_{name}").replace([' ', ','], "_"));
        let scattered = DVec3::new(1.0, 0.5, 0.75) * 10.0 / (4.0 * std::f64::consts::PI);
        let soot = Fog::new(&density);
        let error = worst(&picture, view, |origin, dir| {
            let ray = |place: DAffine3| {
                let index = place.inverse();
                Ray::from_f64(index.transform_point3(origin), index.transform_vector3(dir))
            };
            let extinction_scale = f64::from(sigma) * dir.length();
            let place = DAffine3::from_scale(DVec3::splat(VOXEL));
            let dimming = Dimming { fog: &soot, ray: ray(place), extinction_scale };
            let part = |tree: &Vdb543<f32>| {
                let emission = |value| value * extinction_scale;
                emitted(&Fog::new(tree), &ray(elsewhere()), emission, Some(&dimming), 1e-6).value
            };
            scattered * DVec3::from_array(parts.each_ref().map(part))
        });
        println!("{name}: {error:.1e}");
        // Steps of up to two voxels share a colour, whose second difference over a step is about 1/36;
        // midpoints err by a 24th of that in each step, and 400 slabs by less.
        assert!(error < 5e-3, "{name}: {error}");
    }
}

#[gpu_test]
#[ignore = "slow: each way compiles shaders with and without colours"]
fn fog_of_one_colour_is_fog_of_that_albedo() {
    // In light of all kinds, scattered however often.
    let albedo = [0.9_f32, 0.6, 0.2];
    let mut stage = Stage::new();
    for (name, shadows, fog_light_error, fogs) in WAYS {
        let mut shown = |colored: bool| {
            stage.clear();
            let target = stage.target(SIZE);
            let camera = stage.camera(&target, looking(Vec3::new(1.0, 0.8, 5.0)));
            let quality = VdbQuality { fog_light_error, ..VdbQuality::HIGH };
            stage.world().entity_mut(camera).insert(quality);
            stage.sun(shadows);
            let lamp = PointLight {
                intensity: 2_000.0,
                shadow_maps_enabled: shadows,
                range: 20.0,
                ..default()
            };
            stage.world().spawn((lamp, Transform::from_xyz(-2.5, 0.0, 1.0)));
            stage.world().entity_mut(camera).insert(AmbientLight { brightness: 0.2, ..default() });
            for i in 0..fogs {
                let grid = stage.ball_of_fog(15.0, 10.0);
                let [r, g, b] = albedo;
                let base_color = if colored { Color::WHITE } else { Color::linear_rgb(r, g, b) };
                let material = VdbMaterial { base_color, density_scale: 2.0, ..default() };
                let at = Transform::from_xyz(0.5 * i as f32, 0.0, 0.0);
                let volume = stage.world().spawn((VdbVolume(grid), material, at)).id();
                if colored {
                    let colors = stage.colors(Tree::new(albedo), DAffine3::IDENTITY);
                    stage.world().entity_mut(volume).insert(colors);
                }
            }
            let picture = stage.picture(&target);
            picture.save(&format!("fog_of_one_colour_{name}_{colored}").replace([' ', ','], "_"));
            picture
        };
        let (plain, colored) = (shown(false), shown(true));
        let most = plain.pixels.iter().map(|pixel| pixel.x).fold(0.0, f32::max);
        assert!(most > 0.1, "{name}: {most}");
        let pairs = plain.pixels.iter().zip(&colored.pixels);
        let error = pairs.map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max) / most;
        println!("{name}: {error:.1e}");
        // Both are sums of the same terms, in pictures of 16 bits. Without shadows, the plain fog is lit
        // by the lamp at the same points.
        assert!(error < 2e-3, "{name}: {error}");
    }
}

/// A grid that only colours is looked up, and not traced.
#[gpu_test]
fn a_fog_without_a_loaded_colour_keeps_its_own() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 5.0));
    stage.sun(false);
    let grid: Handle<VdbGrid> = stage.ball_of_fog(15.0, 5.0);
    let missing = VdbColorGrid(Handle::default());
    stage.world().spawn((VdbVolume(grid), missing));
    let pixel = stage.picture(&target).center();
    assert!(pixel.x > 0.01 && pixel.x == pixel.y && pixel.x == pixel.z, "{pixel}");
}
