//! `VdbQuality::EXACT` held against the reference tracer, on some of the pixels.

use bevy::math::{DMat3, DVec3, UVec2};
use rayon::prelude::*;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Blocky, Fog, Medium, Occupied, Ray, Smooth, Sun, phase};

use crate::Shots;
use crate::common::Picture;
use crate::compare::NEAR;
use crate::scenes::Scene;

/// Rays along the width of the picture that are traced again: to surfaces; and through fog, each of which
/// asks for the light at every place.
const RAYS: [u32; 2] = [24, 8];

/// A sentence on how far the picture is from the reference.
///
/// # Errors
/// When it is not what it should be: then nothing held against it means anything.
pub fn hold(scene: &Scene, exact: &Shots, size: UVec2) -> Result<String, String> {
    if !scene.is_simple() {
        return Ok("The reference tracer knows no such scene.".into());
    }
    let every = (size.x / RAYS[usize::from(!scene.has_surface)]).max(1);
    let pixels: Vec<_> = (every / 2..size.y)
        .step_by(every as usize)
        .flat_map(|y| (every / 2..size.x).step_by(every as usize).map(move |x| (x, y)))
        .collect();
    match &exact.surface {
        Some(surface) => hold_surface(scene, surface, size, &pixels),
        None => hold_light(scene, &exact.lit, size, &pixels),
    }
}

/// The ray of a pixel, in index space, and its direction in world space.
fn ray_of(scene: &Scene, size: UVec2, (x, y): (u32, u32)) -> (Ray, DVec3) {
    let half = (45.0_f64.to_radians() * 0.5).tan();
    let uv = (UVec2::new(x, y).as_dvec2() + 0.5) / size.as_dvec2();
    let aspect = f64::from(size.x) / f64::from(size.y);
    let dir = DVec3::new((2.0 * uv.x - 1.0) * half * aspect, (1.0 - 2.0 * uv.y) * half, -1.0);
    let view = scene.view();
    let dir = DMat3::from_quat(view.rotation.as_dquat()) * dir;
    let index = Ray::from_f64(view.translation.as_dvec3() / scene.voxel, dir / scene.voxel);
    (index, dir)
}

/// Compares depths and normals.
fn hold_surface(
    scene: &Scene,
    (depth, normals): &(Picture, Picture),
    size: UVec2,
    pixels: &[(u32, u32)],
) -> Result<String, String> {
    let (tree, kind, ..) = &scene.volumes[0];
    let (mut met, mut wrong, mut depths, mut turned) = (0, 0, 0.0_f64, 0.0_f64);
    for &(x, y) in pixels {
        let (ray, _) = ray_of(scene, size, (x, y));
        let hit = match kind {
            PackKind::Smooth { iso } => {
                let hit = Smooth::new(tree, *iso).first_root(&ray);
                hit.map(|hit| (hit.t, hit.normal()))
            }
            _ => {
                let hit = Blocky::new(tree, Occupied::BelowIso(0.0)).first_voxel(&ray);
                hit.map(|hit| (hit.t, None))
            }
        };
        let found = f64::from(depth.at(x, y).x);
        wrong += usize::from(hit.is_some() != (found > 0.0));
        if let (Some((t, normal)), true) = (hit, found > 0.0) {
            met += 1;
            depths = depths.max(((NEAR / found - t) / t).abs());
            if let Some(normal) = normal {
                let found = (2.0 * normals.at(x, y).truncate() - 1.0).as_dvec3().normalize();
                let angle = found.dot(normal.normalize()).clamp(-1.0, 1.0).acos();
                turned = turned.max(angle.to_degrees());
            }
        }
    }
    if wrong * 100 > met || depths > 2e-3 {
        return Err(format!(
            "{}: EXACT is not: of {met} rays {wrong} are wrong, depth by up to {depths:.1e}",
            scene.name
        ));
    }
    Ok(format!(
        "Beside the reference tracer, of {} rays of `EXACT`: {met} meet the surface, {wrong} wrongly; \
         depth is off by {depths:.1e} of itself at most, normals by {turned:.2}° (the pictures are of \
         16-bit floats).",
        pixels.len()
    ))
}

/// Compares the radiance of a fog.
fn hold_light(
    scene: &Scene,
    lit: &Picture,
    size: UVec2,
    pixels: &[(u32, u32)],
) -> Result<String, String> {
    let (tree, _, material, _) = &scene.volumes[0];
    let scale = f64::from(material.density_scale);
    let emission = f64::from(material.emissive.red);
    let to_sun = scene.to_sun().as_dvec3();
    let sun = scene.shadows.then_some(Sun {
        dir: to_sun / scene.voxel,
        extinction_scale: scale,
        irradiance: 10.0,
    });
    let tracer = Fog::new(tree);
    let light = |&(x, y): &(u32, u32)| {
        let (ray, dir) = ray_of(scene, size, (x, y));
        let medium = Medium {
            extinction_scale: scale * dir.length(),
            emission,
            albedo: 1.0,
            phase: phase(0.0, 0.0),
        };
        let expected = tracer.radiance(&ray, &medium, sun.as_ref(), 1e-3).radiance.value;
        [(f64::from(lit.at(x, y).x) - expected).powi(2), expected.powi(2)]
    };
    let sums: Vec<[f64; 2]> = pixels.par_iter().map(light).collect();
    let [squares, own] = [0, 1].map(|i| sums.iter().map(|sum| sum[i]).sum::<f64>());
    let error = (squares / f64::max(own, 1e-30)).sqrt();
    if error.is_nan() || error >= 0.02 {
        return Err(format!("{}: EXACT is off by {error:.1e} of its radiance", scene.name));
    }
    Ok(format!(
        "Beside the reference tracer, on {} rays of `EXACT`: radiance is off by {error:.1e} of itself \
         (root of the mean square).",
        pixels.len()
    ))
}
