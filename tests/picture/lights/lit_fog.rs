//! Light that fog scatters, and distance fog before volumes.

use super::*;

/// Fog that light reaches unhindered scatters it evenly: albedo · (E / 4π + what is around it).
#[gpu_test]
fn fog_scatters_what_lights_shed_on_it() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 2.0));
    // Small and dense: no light comes through it, and all of it is as far from each light.
    let grid = stage.cube_of_fog(5, 0.02);
    let albedo = Vec3::new(1.0, 0.5, 0.25);
    let base_color = Color::linear_rgb(albedo.x, albedo.y, albedo.z);
    stage
        .world()
        .spawn((VdbVolume(grid), VdbMaterial { base_color, density_scale: 200.0, ..default() }));
    let four_pi = 4.0 * std::f32::consts::PI;
    let check = |stage: &mut Stage, name: &str, expected: f32| {
        let pixel = stage.picture(&target).center().truncate();
        println!("{name}: {pixel}, of {expected}");
        let off = (pixel - expected * albedo).abs().max_element();
        assert!(off <= 0.02 * expected, "{name}: {pixel}, not {}", expected * albedo);
    };
    let sun = DirectionalLight { illuminance: 5.0, ..default() };
    let light = stage.world().spawn((sun, looking(Vec3::ONE))).id();
    check(&mut stage, "directional", 5.0 / four_pi);
    stage.world().despawn(light);

    // Lumens go into 4π; 100 units away, a 10,000th of them come per area.
    let far = Vec3::new(60.0, 80.0, 0.0);
    let expected = 4e5 / four_pi / 1e4 / four_pi;
    let bulb = PointLight { intensity: 4e5, range: 2000.0, ..default() };
    let light = stage.world().spawn((bulb, Transform::from_translation(far))).id();
    check(&mut stage, "point", expected);
    stage.world().despawn(light);
    let lamp = SpotLight { intensity: 4e5, range: 2000.0, ..default() };
    let light = stage.world().spawn((lamp, looking(far))).id();
    check(&mut stage, "spot", expected);
    // Turned away by half a radian: between the inner and the outer angle, it has less.
    let turned = looking(far).rotation * Quat::from_rotation_y(0.5);
    let at = Transform::from_translation(far).with_rotation(turned);
    stage.world().entity_mut(light).insert(at);
    let outer = lamp.outer_angle.cos();
    let cone = (0.5_f32.cos() - outer) / (lamp.inner_angle.cos() - outer);
    check(&mut stage, "spot, aside", expected * cone * cone);
    stage.world().despawn(light);
    // Of the lumens of a rectangle, a fraction of cos θ / π per steradian goes to one side.
    let pane = RectLight { intensity: 4e5, range: 2000.0, width: 2.0, height: 0.5, ..default() };
    let expected = 4.0 * expected;
    for (turn, cosine) in [(0.0, 1.0), (0.5_f32, 0.5_f32.cos()), (2.0, 0.0)] {
        let turned = looking(far).rotation * Quat::from_rotation_y(turn);
        let at = Transform::from_translation(far).with_rotation(turned);
        let light = stage.world().spawn((pane, at)).id();
        check(&mut stage, &format!("rectangle, turned by {turn}"), expected * cosine);
        stage.world().despawn(light);
    }

    stage.world().entity_mut(camera).insert(AmbientLight { brightness: 0.3, ..default() });
    check(&mut stage, "ambient", 0.3);
    let mut images = stage.world().resource_mut::<Assets<Image>>();
    let map = EnvironmentMapLight::solid_color(&mut images, Color::WHITE);
    let map = EnvironmentMapLight { intensity: 0.4, ..map };
    stage.world().entity_mut(camera).remove::<AmbientLight>().insert(map);
    check(&mut stage, "environment", 0.4);
}

/// Fog sends on most of the light in the directions that its anisotropy says, whatever lamp it comes from,
/// and from what is around it, of which the map below has 0.75·(1.2 - 0.2) more above than below.
#[gpu_test]
#[ignore = "slow: many pictures of fog"]
fn fog_turns_light_as_its_anisotropy_says() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = looking(Vec3::Z * 2.0);
    let camera = stage.camera(&target, view);
    let grid = stage.cube_of_fog(5, 0.02);
    let ray = pixel_ray(view, SIZE.x / 2, SIZE.y / 2).1.normalize();
    let check = |stage: &mut Stage, name: &str, anisotropy: f32, expected: f64| {
        let material = VdbMaterial { density_scale: 200.0, anisotropy, ..default() };
        let volume = stage.world().spawn((VdbVolume(grid.clone()), material)).id();
        let pixel = f64::from(stage.picture(&target).center().x);
        println!("{name}, {anisotropy}: {pixel}, of {expected}");
        assert!((pixel - expected).abs() < 5e-3 * expected, "{name}: {pixel}, not {expected}");
        stage.world().despawn(volume);
    };
    for angle in [0.2_f32, 1.0, 2.9] {
        // So far off the view's axis.
        let to_light = Vec3::new(angle.sin(), 0.0, -angle.cos());
        let sun = DirectionalLight { illuminance: 5.0, ..default() };
        let bulb = PointLight { intensity: 4e6, range: 2000.0, ..default() };
        let lamp = SpotLight { intensity: 4e6, range: 2000.0, ..default() };
        let pane = RectLight { intensity: 1e6, range: 2000.0, ..default() };
        // Lumens go into 4π; of those 100 units away, a 10,000th comes per area.
        let lux = 4e6 / (4.0 * PI) / 1e4;
        let lights: [(&str, f64, &dyn Fn(&mut World) -> Entity); 4] = [
            ("sun", 5.0, &|world| world.spawn((sun, looking(to_light))).id()),
            ("point", lux, &|world| world.spawn((bulb, looking(100.0 * to_light))).id()),
            ("spot", lux, &|world| world.spawn((lamp, looking(100.0 * to_light))).id()),
            // A rectangle sends its lumens to one side, by the cosine: four times as many straight ahead.
            ("rectangle", lux, &|world| world.spawn((pane, looking(100.0 * to_light))).id()),
        ];
        for (name, lux, spawn) in lights {
            let light = spawn(stage.world());
            for anisotropy in [-0.5, 0.8] {
                let cosine = ray.dot(to_light.as_dvec3());
                let expected = lux * phase(f64::from(anisotropy), cosine);
                check(&mut stage, &format!("{name} at {angle}"), anisotropy, expected);
            }
            stage.world().despawn(light);
        }
    }
    let mut images = stage.world().resource_mut::<Assets<Image>>();
    let [top, middle, bottom] = [1.2, 0.6, 0.2].map(|c| Color::linear_rgb(c, c, c));
    let map = EnvironmentMapLight::hemispherical_gradient(&mut images, top, middle, bottom);
    let map = EnvironmentMapLight { intensity: 0.5, ..map };
    stage.world().entity_mut(camera).insert(map);
    for up in [-1.0_f32, 0.0, 1.0] {
        let from = Vec3::new(0.0, -up, 1.0 - up.abs()) * 2.0;
        let view = Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::X);
        stage.world().entity_mut(camera).insert(view);
        let ahead = pixel_ray(view, SIZE.x / 2, SIZE.y / 2).1.normalize().y;
        let expected = 0.5 * ((1.2 + 4.0 * 0.6 + 0.2) / 6.0 + 0.8 * 0.75 * ahead);
        check(&mut stage, &format!("map, up {up}"), 0.8, expected);
    }
}

/// The relative errors of a picture of thin fog, seen from its middle beside a light, of which `scattered` is what fog
/// with an albedo of 1 scatters at a place along a direction: the 99th percentile, and the largest.
fn errors_in_fog(
    name: &str,
    anisotropy: f32,
    light: impl Bundle,
    scattered: impl Fn(DVec3, DVec3) -> f64,
) -> [f64; 2] {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let view = Transform::default();
    stage.camera(&target, view);
    let block = CoordBox { min: IVec3::splat(-20), max: IVec3::splat(20) };
    let grid = stage.grid(fog::block(block, 1.0), PackKind::Fog, 0.1);
    let density = 0.02;
    let material = VdbMaterial { density_scale: density, anisotropy, ..default() };
    stage.world().spawn((VdbVolume(grid), material));
    stage.world().spawn(light);
    let picture = stage.picture(&target);
    picture.save(name);
    let (mut errors, step) = (Vec::new(), 4e-3);
    for y in (0..SIZE.y).step_by(4) {
        for x in (0..SIZE.x).step_by(4) {
            let (_, dir) = pixel_ray(view, x, y);
            let dir = dir.normalize();
            let (mut expected, mut depth) = (0.0, 0.0);
            for i in 0..1000 {
                let place = dir * (step * (f64::from(i) + 0.5));
                // Rays begin at the near plane.
                if place.z > -0.1 {
                    continue;
                }
                // Even to the outermost samples, and then down to nothing in a voxel.
                let inside = ((2.1 - place.abs().max_element()) / 0.1).clamp(0.0, 1.0);
                let part = f64::from(density) * inside * step;
                expected += (-depth - 0.5 * part).exp() * part * scattered(place, dir);
                depth += part;
            }
            errors.push((f64::from(picture.at(x, y).x) / expected - 1.0).abs());
        }
    }
    errors.sort_by(f64::total_cmp);
    let found = [errors.len() * 99 / 100, errors.len() - 1].map(|i| errors[i]);
    println!("{name}: off by {found:?}");
    found
}

#[gpu_test]
fn fog_is_lit_by_a_bulb_place_by_place() {
    let at = DVec3::new(0.6, 1.0, -1.0);
    let bulb = PointLight { intensity: 2e3, range: 2000.0, ..default() };
    let bulb = (bulb, Transform::from_translation(at.as_vec3()));
    let [_, worst] = errors_in_fog("fog_beside_a_bulb", 0.0, bulb, |place, _| {
        2e3 / (4.0 * PI) / place.distance_squared(at) / (4.0 * PI)
    });
    assert!(worst < 0.01, "off by {worst}");
}

/// A rectangle is seen as the sum of many small ones.
#[gpu_test]
#[ignore = "slow: its reference is a sum over hundreds of small lights"]
fn fog_is_lit_by_a_rectangle_place_by_place() {
    let size = DVec2::new(1.2, 0.5);
    let place = Transform::from_xyz(0.5, 1.0, -1.4).looking_at(Vec3::new(0.2, 0.0, -1.0), Vec3::X);
    let pane = RectLight {
        intensity: 2e3,
        range: 2000.0,
        width: size.x as f32,
        height: size.y as f32,
        ..default()
    };
    let radiance = 2e3 / (PI * size.x * size.y);
    let [right, up, forward] =
        [place.right(), place.up(), place.forward()].map(|axis| axis.as_dvec3());
    const PARTS: u32 = 24;
    let parts = (0..PARTS * PARTS).map(|i| {
        let part =
            (DVec2::new(f64::from(i % PARTS), f64::from(i / PARTS)) + 0.5) / f64::from(PARTS);
        let along = (part - 0.5) * size;
        place.translation.as_dvec3() + along.x * right + along.y * up
    });
    let parts: Vec<DVec3> = parts.collect();
    let area = size.x * size.y / parts.len() as f64;
    // What docs/guide/fog.md promises of fog that is closer to a rectangle than its width.
    for (anisotropy, bound) in [(0.0, [0.02, 0.06]), (0.5, [0.06, 0.12])] {
        let name = format!("fog_beside_a_rectangle_{anisotropy}");
        let [most, worst] = errors_in_fog(&name, anisotropy, (pane, place), |at, ray| {
            let seen = |part: &DVec3| {
                let to_part = *part - at;
                let height = -to_part.dot(forward);
                if height <= 0.0 {
                    return 0.0;
                }
                let distance = to_part.length();
                let cosine = to_part.dot(ray) / distance;
                area * height / distance.powi(3) * phase(f64::from(anisotropy), cosine)
            };
            radiance * parts.iter().map(seen).sum::<f64>()
        });
        let off = format!("anisotropy {anisotropy}: off by {most}, {worst}");
        assert!(most < bound[0] && worst < bound[1], "{off}");
    }
}

#[gpu_test]
fn bevys_distance_fog_lies_before_volumes_as_before_meshes() {
    let falloffs = [
        ("linear", FogFalloff::Linear { start: 3.0, end: 9.0 }),
        ("exponential", FogFalloff::Exponential { density: 0.2 }),
        ("squared", FogFalloff::ExponentialSquared { density: 0.15 }),
        ("atmospheric", FogFalloff::from_visibility_color(20.0, Color::linear_rgb(0.3, 0.5, 0.9))),
    ];
    let mut pair = Pair::new(VdbMaterial::default());
    pair.stage.world().spawn(sun());
    for (name, falloff) in falloffs {
        let fog = DistanceFog {
            color: Color::linear_rgb(0.2, 0.4, 0.6),
            // The sun shines through it, from behind what is seen.
            directional_light_color: Color::linear_rgba(0.5, 0.4, 0.3, 0.5),
            directional_light_exponent: 2.0,
            falloff,
        };
        let camera = pair.camera;
        pair.stage.world().entity_mut(camera).insert(fog);
        pair.stage
            .world()
            .spawn((DirectionalLight { illuminance: 2.0, ..default() }, looking(Vec3::NEG_Z)));
        pair.compare(&format!("distance_{name}"));
    }
}

/// Fog of a volume that nothing is seen through, in distance fog: as a mesh that glows so.
#[gpu_test]
fn bevys_distance_fog_lies_before_a_volumes_fog() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 8.0));
    let fog = DistanceFog {
        color: Color::linear_rgb(0.2, 0.4, 0.6),
        falloff: FogFalloff::Exponential { density: 0.1 },
        ..default()
    };
    stage.world().entity_mut(camera).insert(fog);
    let grid = stage.cube_of_fog(10, 0.1);
    for (density_scale, distance) in [(1e4_f32, 7.0_f32), (0.01, 8.0)] {
        let emissive = LinearRgba::rgb(1.0, 0.5, 0.0);
        let material =
            VdbMaterial { density_scale, base_color: Color::BLACK, emissive, ..default() };
        let volume = stage.world().spawn((VdbVolume(grid.clone()), material)).id();
        let pixel = stage.picture(&target).center().truncate();
        stage.world().despawn(volume);
        let coverage = 1.0 - (-density_scale * 2.0).exp();
        let left = (-0.1 * distance).exp();
        let expected =
            coverage * (Vec3::new(0.2, 0.4, 0.6) * (1.0 - left) + left * emissive.to_vec3());
        let error = (pixel - expected).abs().max_element() / expected.max_element();
        assert!(error < 0.01, "{pixel}, not {expected}");
    }
}

/// Fog in samples, beside the exact integral: also where a mesh ends the rays between two samples.
#[gpu_test]
fn fog_in_samples_is_close_to_the_integral() {
    let mut stage = Stage::new();
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.ball_of_fog(20.0, 8.0);
    let emissive = LinearRgba::rgb(1.0, 0.5, 0.25);
    let material =
        VdbMaterial { density_scale: 0.5, base_color: Color::BLACK, emissive, ..default() };
    stage.world().spawn((VdbVolume(grid), material));
    let mesh = stage.world().resource_mut::<Assets<Mesh>>().add(Cuboid::new(1.0, 4.0, 1.0));
    let black = StandardMaterial { base_color: Color::BLACK, unlit: true, ..default() };
    let black = stage.world().resource_mut::<Assets<StandardMaterial>>().add(black);
    let turned = Transform::from_rotation(Quat::from_rotation_y(0.6));
    stage.world().spawn((Mesh3d(mesh), MeshMaterial3d(black), turned));
    let mut picture = |fog_step: f32| {
        stage.world().entity_mut(camera).insert(VdbQuality { fog_step, ..default() });
        let picture = stage.picture(&target);
        let pixels = (0..SIZE.y).flat_map(|y| (0..SIZE.x).map(move |x| (x, y)));
        pixels.map(|(x, y)| picture.at(x, y).x).collect::<Vec<f32>>()
    };
    let exact = picture(0.0);
    assert!(exact.iter().filter(|&&red| red > 0.2).count() > 100, "no fog to be seen");
    for (step, bound) in [(1.0, 2e-3), (4.0, 2e-2)] {
        let sampled = picture(step);
        let off = exact.iter().zip(&sampled).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        println!("fog every {step} voxels: {off} off at most");
        assert!(off > 0.0 && off < bound, "with steps of {step}: {off}");
    }
}
