//! What is shown: models made on the spot, so that no file is needed.

use std::sync::Arc;

use bevy::math::{DVec3, IVec3, UVec2};
use bevy::prelude::*;
use bevy_vdb::{VdbEmission, VdbMaterial, VdbQuality, VdbTraversal, VdbVolume};
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
    /// What shines in the first volume, by its temperatures as parts of [`HOTTEST`].
    fire: Option<Arc<Vdb543<f32>>>,
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
    Fire,
}

/// Kelvin.
const HOTTEST: f32 = 1800.0;
/// Of a fire, per world unit: so that it is about as bright as the sun makes its smoke.
const STRENGTH: f32 = 1e-3;

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
    let noisy = Arc::new(fog::from_values(cube, |at| noise(at, edge)));
    // Lit at each of so many places, fog takes as much time as all else together: half as large an edge.
    let small = CoordBox { min: cube.min / 2, max: cube.max / 2 };
    let lit_ball = Arc::new(fog::sphere(DVec3::ZERO, 0.5 * radius, 0.3 * radius));
    let lit_noisy = Arc::new(fog::from_values(small, |at| noise(at, edge / 2)));
    let flames = Arc::new(fog::from_values(small, |at| flame(at, edge / 2)));
    let fog = VdbMaterial { density_scale: OPTICAL_DEPTH as f32, ..default() };
    let stone = VdbMaterial { perceptual_roughness: 0.8, reflectance: 0.3, ..default() };
    let mirror = VdbMaterial { metallic: 1.0, perceptual_roughness: 0.0, ..default() };
    let glowing = VdbMaterial { emissive: LinearRgba::rgb(0.2, 0.1, 0.05), ..stone.clone() };
    let near = Vec3::new(0.75, 0.55, 1.2);
    let scene =
        |name, tree: &Arc<Vdb543<f32>>, kind, material: &VdbMaterial, eye, sweep: Sweep| Scene {
            name,
            volumes: vec![(tree.clone(), kind, material.clone(), Vec3::ZERO)],
            eye,
            voxel: 1.0 / f64::from(if sweep.is_lit_fog() { edge / 2 } else { edge }),
            has_surface: kind != PackKind::Fog,
            shadows: true,
            fire: None,
            sweep,
        };
    let mut all = vec![
        scene("level set, near", &gyroid, smooth, &stone, near, Sweep::Surface),
        scene("level set, far", &gyroid, smooth, &stone, 6.0 * near, Sweep::Surface),
        scene("voxels, near", &gyroid, voxels, &stone, near, Sweep::Surface),
        scene("thin truss", &truss, voxels, &stone, near, Sweep::Surface),
        scene("mirror", &gyroid, smooth, &mirror, near, Sweep::Mirror),
        scene("even fog", &noisy, PackKind::Fog, &fog, near, Sweep::EvenFog),
        scene("smooth fog", &lit_ball, PackKind::Fog, &fog, near, Sweep::LitFog),
        scene("noisy fog", &lit_noisy, PackKind::Fog, &fog, near, Sweep::LitFog),
        scene("two fogs", &lit_noisy, PackKind::Fog, &fog, near, Sweep::SharedFog),
        scene("fire", &lit_noisy, PackKind::Fog, &fog, near, Sweep::Fire),
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
                let beside = Vec3::splat(0.2);
                scene.volumes.push((lit_ball.clone(), PackKind::Fog, fog.clone(), beside));
            }
            Sweep::Fire => scene.fire = Some(flames.clone()),
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

/// Temperatures of flames that rise from below, as parts of the hottest.
fn flame(at: IVec3, edge: u32) -> f32 {
    let p = at.as_vec3() / edge as f32;
    let axis = Vec2::new(p.x + 0.08 * (9.0 * p.y).sin(), p.z + 0.08 * (7.0 * p.y).cos());
    let up = 0.5 + p.y;
    (1.0 - up - (5.0 * axis.length()).powi(2)).clamp(0.0, 1.0)
}

impl Sweep {
    fn is_lit_fog(self) -> bool {
        matches!(self, Self::LitFog | Self::SharedFog | Self::Fire)
    }
}

impl Scene {
    /// Of its pictures: lit fog is shown in half of what is asked for, along each axis, a multiple of 16.
    pub fn size(&self, size: UVec2) -> UVec2 {
        let half = UVec2::new((size.x / 32).max(1) * 16, (size.y / 2).max(16));
        if self.sweep.is_lit_fog() { half } else { size }
    }

    /// Whether the reference tracer can say what it looks like.
    pub fn is_simple(&self) -> bool {
        self.volumes.len() == 1 && self.fire.is_none()
    }

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
        for (i, (tree, kind, material, at)) in self.volumes.iter().enumerate() {
            let grid = stage.grid(Vdb543::clone(tree), *kind, self.voxel);
            let at = Transform::from_translation(*at);
            let volume = stage.world().spawn((VdbVolume(grid), material.clone(), at)).id();
            let Some(fire) = self.fire.as_ref().filter(|_| i == 0) else { continue };
            let grid = stage.grid(Vdb543::clone(fire), PackKind::Fog, self.voxel);
            let emission =
                VdbEmission::Temperature { grid, scale: HOTTEST, offset: 0.0, strength: STRENGTH };
            stage.world().entity_mut(volume).insert(emission);
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
                        VdbTraversal::HddaSkip,
                        VdbTraversal::Hdda,
                        VdbTraversal::Dda,
                        VdbTraversal::March,
                    ] {
                        if traversal == VdbTraversal::HddaSkip || resolution == 1.0 {
                            add(VdbQuality { traversal, ..base });
                        }
                    }
                    if resolution != 1.0 && resolution != 0.5 {
                        add(base);
                        continue;
                    }
                    for shadow_range in [0.3, 0.1] {
                        add(VdbQuality { shadow_range, ..base });
                    }
                    add(VdbQuality { shadows: false, ..base });
                    for detail in [1.0, 2.0, 4.0] {
                        add(VdbQuality { detail, ..base });
                    }
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
                        add(VdbQuality { fog_step, detail: 1.0, ..base });
                    }
                }
                Sweep::LitFog | Sweep::SharedFog | Sweep::Fire => {
                    if resolution == 0.7 || resolution == 0.35 {
                        continue;
                    }
                    let rays = VdbQuality { fog_light_error: 0.0, ..base };
                    if matches!(self.sweep, Sweep::LitFog) {
                        for fog_light_step in [1.0, 2.0, 4.0, 8.0, 16.0] {
                            let fog_shadow_step = 0.5 * fog_light_step;
                            add(VdbQuality { fog_light_step, fog_shadow_step, ..rays });
                        }
                        add(VdbQuality { shadows: false, ..base });
                    } else {
                        for fog_slabs in [32, 8] {
                            add(VdbQuality { fog_slabs, ..rays });
                        }
                    }
                    for fog_light_error in [0.001, 0.003, 0.01, 0.02, 0.05, 0.1] {
                        add(VdbQuality { fog_light_error, ..base });
                    }
                }
            }
        }
        all
    }
}
