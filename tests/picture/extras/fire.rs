//! What shines, as a picture and in mirrors.

use super::*;

#[gpu_test]
fn mirrors_show_fire() {
    let values = fog::sphere(DVec3::new(0.0, 20.0, 0.0), 9.0, 5.0);
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::new(1.0, 4.0, 8.0));
    let camera = stage.camera(&target, view);
    stage.world().entity_mut(camera).insert(VdbQuality { reflections: 1, ..default() });
    let floor = CoordBox { min: IVec3::new(-60, -10, -60), max: IVec3::new(59, -1, 59) };
    let floor = stage.grid(fog::block(floor, -1.0), SURFACE, 0.1);
    let mirror = VdbMaterial { metallic: 1.0, perceptual_roughness: 0.0, ..default() };
    stage.world().spawn((VdbVolume(floor), mirror));
    let nothing = stage.fog_at(&Vdb543::new(0.0), tenths());
    let grid = stage.fog_at(&values, tenths());
    let emission = VdbEmission::Scalar { grid, color: LinearRgba::rgb(0.2, 0.1, 0.05) };
    stage.world().spawn((VdbVolume(nothing), emission));
    let picture = stage.picture(&target);
    picture.save("mirrored_fire");
    let none = Vdb543::new(0.0);
    let fire = Fire { values: &values, place: tenths(), density: &none, density_scale: 0.0 };
    let shine = |origin, dir| fire.radiance(origin, dir, |value| 0.2 * value);
    let top = -0.05;
    let (mut least, mut most, mut count) = (f64::INFINITY, 0.0_f64, 0);
    for y in 0..SIZE.y {
        for x in 0..SIZE.x {
            let (origin, dir) = pixel_ray(view, x, y);
            let at = origin + dir * ((top - origin.y) / dir.y);
            if dir.y >= 0.0 || at.x.abs().max(at.z.abs()) > 5.9 || shine(origin, dir) > 0.0 {
                continue;
            }
            let mirrored = shine(at, dir * DVec3::new(1.0, -1.0, 1.0));
            if mirrored > 0.05 {
                let share = f64::from(picture.at(x, y).x) / mirrored;
                (least, most, count) = (least.min(share), most.max(share), count + 1);
            }
        }
    }
    println!("{count} pixels of the mirror show {least:.4} to {most:.4} of the fire");
    assert!(count > 50, "{count} pixels");
    // White metal reflects all but a few hundredths, by Bevy's own approximation, and nearly evenly.
    assert!(least > 0.9 && most < 1.001 && most / least < 1.01, "{least} to {most}");
}

/// Emission has no coverage, but tonemapping and distance fog apply to it all the same.
#[gpu_test]
fn fire_is_tonemapped_and_fades_with_the_distance() {
    let shown = |hdr: bool, distance: Option<f32>| {
        let mut stage = Stage::new();
        let target = stage.target(SIZE);
        let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
        let mut camera = stage.world().entity_mut(camera);
        camera.insert(Tonemapping::AcesFitted);
        if !hdr {
            camera.remove::<Hdr>();
        }
        if let Some(visibility) = distance {
            let falloff = FogFalloff::Linear { start: 8.0 - visibility, end: 8.0 + visibility };
            let color = Color::linear_rgb(0.0, 0.0, 1.0);
            camera.insert((Tonemapping::None, DistanceFog { color, falloff, ..default() }));
        }
        let nothing = stage.fog_at(&Vdb543::new(0.0), tenths());
        let grid = stage.fog_at(&fog::block(cube(-10, 9), 1.0), tenths());
        let color = LinearRgba::rgb(0.3, 0.15, 0.0);
        stage.world().spawn((VdbVolume(nothing), VdbEmission::Scalar { grid, color }));
        let picture = stage.picture(&target);
        picture.save(&format!("fire_hdr_{hdr}_{distance:?}"));
        picture.center()
    };
    let (with, without) = (shown(true, None), shown(false, None));
    // Against black, and with less than full brightness, both tonemap the same light.
    assert!(with.x > 0.2 && (with - without).abs().max_element() < 1e-3, "{with} {without}");
    // Half of the light from the middle of the fog's range is left, and nothing of the fog's own.
    let faded = shown(true, Some(4.0));
    let expected = 0.5 * 0.6;
    assert!((faded.x - expected).abs() < 0.01, "{faded}");
    assert!(faded.z.abs() < 1e-3, "what covers nothing got the colour of the fog: {faded}");
}

/// Smoke and temperature of a real file, as a program wrote them.
#[gpu_test]
fn a_fire_of_a_file_is_shown() {
    let name = "../shared/corpus/real/blender_fire_0002.vdb";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
    if !path.exists() {
        eprintln!("SKIPPED: there is no {}", path.display());
        return;
    }
    let mut stage = Stage::new();
    let target = stage.target(UVec2::new(160, 120));
    let load = |stage: &mut Stage, name: &str| {
        let label = format!("{}#{name}", path.display());
        stage.world().resource::<AssetServer>().load(label)
    };
    let (density, temperature): (Handle<VdbGrid>, _) =
        (load(&mut stage, "density"), load(&mut stage, "temperature"));
    let mut both = Vec::new();
    while both.len() < 2 {
        stage.update(1);
        let grids = stage.world().resource::<Assets<VdbGrid>>();
        both = [&density, &temperature].iter().filter_map(|id| grids.get(*id)).cloned().collect();
    }
    let (low, high) = both[0].world_bounds().unwrap();
    let middle = (0.5 * (low + high)).as_vec3();
    let away = (high - low).length() as f32;
    let from = middle + Vec3::new(0.3, -1.0, 0.2).normalize() * away * 1.3;
    let view = Transform::from_translation(from).looking_at(middle, Vec3::Z);
    stage.camera(&target, view);
    let material = VdbMaterial { density_scale: 2.0, ..default() };
    let smoke = stage.world().spawn((VdbVolume(density), material)).id();
    stage.world().spawn((
        DirectionalLight { illuminance: 0.5, ..default() },
        Transform::default().looking_to(Vec3::new(1.0, 0.5, -1.0), Vec3::Z),
    ));
    let cold = stage.picture(&target);
    cold.save("blender_smoke");
    let largest = both[1].tree().unwrap().values().map(|value| value.value).fold(0.0, f32::max);
    let scale = 1900.0 / largest;
    let emission =
        VdbEmission::Temperature { grid: temperature, scale, offset: 0.0, strength: 1e-5 };
    stage.world().entity_mut(smoke).insert(emission);
    let hot = stage.picture(&target);
    hot.save("blender_fire");
    let brighter = cold.pixels.iter().zip(&hot.pixels);
    let brighter = brighter.filter(|(cold, hot)| hot.x > cold.x + 0.05 && hot.x > 2.0 * hot.z);
    assert!(brighter.count() > 100, "nothing glows");
}
