//! What is shown: models made on the spot, so that no file is needed.

use std::sync::Arc;

use bevy::math::{DVec3, IVec3, UVec2};
use bevy::prelude::*;
use bevy_vdb::{VdbMaterial, VdbQuality, VdbTraversal, VdbVolume};
use vdb_core::pack::PackKind;
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::{CoordBox, Vdb543};

use crate::common::Stage;

/// Optical depth of a fog along its edge, where its density is 1.
const OPTICAL_DEPTH: f64 = 6.0;

pub struct Scene {
    pub name: &'static str,
    /// Scaled so that its edge is a unit of the world; the second is beside the first.
    pub volumes: Vec<(Arc<Vdb543<f32>>, PackKind, VdbMaterial, Vec3)>,
    pub eye: Vec3,
    pub voxel: f64,
    pub has_surface: bool,
    pub shadows: bool,
    sweep: Sweep,
}

/// The knobs that matter to a scene.
#[derive(Clone, Copy)]
enum Sweep {
    Surface,
    Mirror,
    EvenFog,
    LitFog,
    SharedFog,
}

/// All scenes, of models with so many voxels along an edge.
pub fn all(edge: u32) -> Vec<Scene> {
    let radius = f64::from(edge) / 2.0;
    let cube =
        CoordBox { min: IVec3::splat(-(edge as i32) / 2), max: IVec3::splat(edge as i32 / 2 - 1) };
    let smooth = PackKind::Smooth { iso: 0.0 };
    let voxels = PackKind::Surface { iso: 0.0 };
    let gyroid = Arc::new(level_set::gyroid(DVec3::ZERO, 0.45 * radius * 2.0, radius / 2.5));
    let (pitch, thick) = (f64::from(edge) / 8.0, f64::max(2.0, f64::from(edge) / 128.0));
    let truss = Arc::new(level_set::from_distance(cube, |p| truss(p, pitch, thick)));
    let ball = Arc::new(fog::sphere(DVec3::ZERO, radius, 0.6 * radius));
    let noisy = Arc::new(fog::from_values(cube, |at| noise(at, edge)));
    let fog = VdbMaterial { density_scale: OPTICAL_DEPTH as f32, ..default() };
    let stone = VdbMaterial { perceptual_roughness: 0.8, reflectance: 0.3, ..default() };
    let mirror = VdbMaterial { metallic: 1.0, perceptual_roughness: 0.0, ..default() };
    let glowing = VdbMaterial { emissive: LinearRgba::rgb(0.2, 0.1, 0.05), ..stone.clone() };
    let near = Vec3::new(0.75, 0.55, 1.2);
    let scene = |name, tree: &Arc<Vdb543<f32>>, kind, material: &VdbMaterial, eye, sweep| Scene {
        name,
        volumes: vec![(tree.clone(), kind, material.clone(), Vec3::ZERO)],
        eye,
        voxel: 1.0 / f64::from(edge),
        has_surface: kind != PackKind::Fog,
        shadows: true,
        sweep,
    };
    let mut all = vec![
        scene("level set, near", &gyroid, smooth, &stone, near, Sweep::Surface),
        scene("level set, far", &gyroid, smooth, &stone, 6.0 * near, Sweep::Surface),
        scene("voxels, near", &gyroid, voxels, &stone, near, Sweep::Surface),
        scene("thin truss", &truss, voxels, &stone, near, Sweep::Surface),
        scene("mirror", &gyroid, smooth, &mirror, near, Sweep::Mirror),
        scene("even fog", &noisy, PackKind::Fog, &fog, near, Sweep::EvenFog),
        scene("smooth fog", &ball, PackKind::Fog, &fog, near, Sweep::LitFog),
        scene("noisy fog", &noisy, PackKind::Fog, &fog, near, Sweep::LitFog),
        scene("two fogs", &noisy, PackKind::Fog, &fog, near, Sweep::SharedFog),
    ];
    for scene in &mut all {
        match scene.sweep {
            Sweep::EvenFog => {
                scene.shadows = false;
                scene.volumes[0].2.emissive = LinearRgba::rgb(1.0, 0.8, 0.6);
                scene.volumes[0].2.base_color = Color::BLACK;
            }
            Sweep::Mirror => {
                let beside = Vec3::new(-0.6, 0.3, 0.3);
                scene.volumes.push((gyroid.clone(), smooth, glowing.clone(), beside));
            }
            Sweep::SharedFog => {
                scene.volumes.push((ball.clone(), PackKind::Fog, fog.clone(), Vec3::splat(0.2)));
            }
            Sweep::Surface | Sweep::LitFog => {}
        }
    }
    all
}

/// How far a place is, about, from beams along the three axes.
fn truss(at: DVec3, pitch: f64, thick: f64) -> f64 {
    // From the middle of the nearest beam, along each axis.
    let off = (at + 0.5 * pitch).map(|c| (c.rem_euclid(pitch) - 0.5 * pitch).abs());
    let beam = |a: f64, b: f64| a.max(b) - 0.5 * thick;
    beam(off.x, off.y).min(beam(off.y, off.z)).min(beam(off.z, off.x))
}

/// Densities of a cloud: waves of several lengths, down to a few voxels, with gaps.
fn noise(at: IVec3, edge: u32) -> f32 {
    let p = at.as_vec3() / edge as f32;
    let octave = |k: f32, turn: f32| {
        let p = Quat::from_euler(EulerRot::XYZ, turn, 2.0 * turn, 0.7 * turn) * p * k;
        p.x.sin() * p.y.sin() + p.z.sin() * p.x.cos()
    };
    let waves: f32 =
        (0..5).map(|i| octave(12.0 * 2_f32.powi(i), i as f32) / (1.0 + i as f32)).sum();
    let inside = 1.0 - (2.0 * p.length()).powi(4);
    (inside.min(1.0) * (0.6 + waves)).clamp(0.0, 2.0)
}

impl Scene {
    /// Of a sun to the left, above and before.
    pub fn to_sun(&self) -> Vec3 {
        Vec3::new(-0.6, 1.0, 0.4).normalize()
    }

    pub fn view(&self) -> Transform {
        Transform::from_translation(self.eye).looking_at(Vec3::ZERO, Vec3::Y)
    }

    /// What does not change from setting to setting.
    pub fn base(&self, quality: VdbQuality) -> VdbQuality {
        let reflections = if matches!(self.sweep, Sweep::Mirror) { 4 } else { 0 };
        VdbQuality { reflections, ..quality }
    }

    pub fn build(&self, stage: &mut Stage, size: UVec2) -> (Handle<Image>, Entity) {
        let target = stage.target(size);
        let camera = stage.camera(&target, self.view());
        for (tree, kind, material, at) in &self.volumes {
            let grid = stage.grid(Vdb543::clone(tree), *kind, self.voxel);
            let at = Transform::from_translation(*at);
            stage.world().spawn((VdbVolume(grid), material.clone(), at));
        }
        if !matches!(self.sweep, Sweep::EvenFog) {
            let sun = DirectionalLight {
                illuminance: 10.0,
                shadow_maps_enabled: self.shadows,
                ..default()
            };
            let at = Transform::from_translation(self.to_sun()).looking_at(Vec3::ZERO, Vec3::Y);
            stage.world().spawn((sun, at));
        }
        (target, camera)
    }

    /// The settings that are measured, with the names of those that are presets.
    pub fn candidates(&self) -> Vec<(Option<&'static str>, VdbQuality)> {
        let mut all: Vec<_> =
            VdbQuality::PRESETS.iter().map(|(name, of)| (Some(*name), self.base(*of))).collect();
        let mut add = |quality: VdbQuality| {
            if !all.iter().any(|(_, other)| *other == quality) {
                all.push((None, quality));
            }
        };
        let base = self.base(VdbQuality::HIGH);
        for resolution in [1.0, 0.7, 0.5, 0.35, 0.25] {
            let base = VdbQuality { resolution, ..base };
            match self.sweep {
                Sweep::Surface => {
                    for traversal in [
                        VdbTraversal::HddaSdf,
                        VdbTraversal::Hdda,
                        VdbTraversal::Dda,
                        VdbTraversal::March,
                    ] {
                        if traversal == VdbTraversal::HddaSdf || resolution == 1.0 {
                            add(VdbQuality { traversal, ..base });
                        }
                    }
                    for shadow_range in [0.3, 0.1] {
                        add(VdbQuality { shadow_range, ..base });
                    }
                    add(VdbQuality { shadows: false, ..base });
                }
                Sweep::Mirror => {
                    for reflections in [4, 3, 2, 1, 0] {
                        add(VdbQuality { reflections, ..base });
                    }
                    add(VdbQuality { reflection_range: 0.2, ..base });
                }
                Sweep::EvenFog => {
                    for fog_step in [0.0, 0.5, 1.0, 2.0, 4.0, 8.0] {
                        add(VdbQuality { fog_step, ..base });
                    }
                }
                Sweep::LitFog => {
                    for fog_light_step in [0.5, 1.0, 2.0, 4.0, 8.0, 16.0] {
                        for fog_shadow_step in [0.25, 0.5, 1.0, 2.0, 4.0, 8.0] {
                            let even = fog_light_step / fog_shadow_step;
                            if (0.5..=4.0).contains(&even) {
                                add(VdbQuality { fog_light_step, fog_shadow_step, ..base });
                            }
                        }
                    }
                    add(VdbQuality { shadows: false, ..base });
                }
                Sweep::SharedFog => {
                    for fog_slabs in [64, 32, 16, 8, 4] {
                        for fog_shadow_step in [1.0, 4.0] {
                            add(VdbQuality { fog_slabs, fog_shadow_step, ..base });
                        }
                    }
                }
            }
        }
        all
    }
}
