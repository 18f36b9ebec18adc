//! Whole pictures: the plugin in a Bevy app, against the reference tracer and beside meshes.

mod accumulate;
mod arrivals;
mod cached_lamps;
mod cameras;
mod clip;
#[path = "../common/mod.rs"]
mod common;
mod composition;
mod corners;
mod denoise;
mod device_loss;
mod diagnostics;
mod edges;
mod edits;
mod extras;
mod extremes;
mod fade;
#[path = "../common/files.rs"]
mod files;
mod film;
mod fire_light;
mod flip;
mod fog_colors;
mod fog_shadows;
mod golden;
mod histories;
mod judges;
mod levels;
mod levels_within;
mod light_cache;
mod lights;
#[path = "../common/log.rs"]
mod log;
mod many;
mod materials;
mod measure;
mod media;
mod mesh_reflections;
mod mesh_shadows;
mod minimal;
mod modes;
mod motion;
mod need;
mod normals;
mod opacity_maps;
mod pages;
#[path = "../common/pages_folder.rs"]
mod pages_folder;
mod peer_ramps;
mod peers;
mod pool;
mod quality;
mod ramps;
mod rays;
mod reflections;
mod reload;
mod scatter;
mod scattered_light;
mod scene;
mod shadows;
mod sky;
mod traced;

use bevy::camera::visibility::RenderLayers;
use bevy::camera::{Hdr, ScalingMode, Viewport};
use bevy::math::{DAffine3, DMat3, DVec3};
use bevy::prelude::*;
use bevy_vdb::{
    VdbCamera, VdbGpuUsage, VdbGrid, VdbMaterial, VdbQuality, VdbRenderMode, VdbTraversal,
    VdbVolume,
};
use gpu_test::gpu_test;
use vdb_core::pack::PackKind;
use vdb_core::reference::{Blocky, Fog, Occupied, Ray, Smooth, SurfaceHit};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::CoordBox;

use common::{Picture, Stage, has_gpu};

const SIZE: UVec2 = UVec2::new(96, 64);
const SURFACE: PackKind = PackKind::Surface { iso: 0.0 };
const GREEN: LinearRgba = LinearRgba { red: 0.0, green: 1.0, blue: 0.0, alpha: 1.0 };

/// A material that shows itself, lit or not.
fn glow(color: LinearRgba) -> VdbMaterial {
    let base_color = Color::BLACK;
    VdbMaterial { base_color, emissive: color, reflectance: 0.0, ..default() }
}

fn is_green(pixel: Vec4) -> bool {
    pixel.y > 0.5 && pixel.x < 0.1 && pixel.z < 0.1
}

fn is_red(pixel: Vec4) -> bool {
    pixel.x > 0.5 && pixel.y < 0.1 && pixel.z < 0.1
}

impl Stage {
    /// A sphere of voxels, 2 world units in radius, that glows green.
    fn green_sphere(&mut self, transform: Transform) -> Entity {
        let grid = self.grid(level_set::sphere(DVec3::ZERO, 20.0), SURFACE, 0.1);
        self.world().spawn((VdbVolume(grid), glow(GREEN), transform)).id()
    }

    /// Fog in a ball about the origin, with voxels of 0.1: its density falls from 1 to 0 over `fall` voxels
    /// before its radius.
    fn ball_of_fog(&mut self, radius: f64, fall: f64) -> Handle<VdbGrid> {
        self.grid(fog::sphere(DVec3::ZERO, radius, fall), PackKind::Fog, 0.1)
    }

    /// Fog of density 1 in a cube, from `-half` to `half - 1` voxels.
    fn cube_of_fog(&mut self, half: i32, voxel: f64) -> Handle<VdbGrid> {
        let cube = CoordBox { min: IVec3::splat(-half), max: IVec3::splat(half - 1) };
        self.grid(fog::block(cube, 1.0), PackKind::Fog, voxel)
    }

    /// A matt horizontal plane of Bevy's own.
    fn matt_plane(&mut self, edge: f32, height: f32) -> Entity {
        let mesh = Plane3d::default().mesh().size(edge, edge);
        let mesh = self.world().resource_mut::<Assets<Mesh>>().add(mesh);
        let material =
            StandardMaterial { perceptual_roughness: 1.0, reflectance: 0.0, ..default() };
        let material = self.world().resource_mut::<Assets<StandardMaterial>>().add(material);
        let at = Transform::from_xyz(0.0, height, 0.0);
        self.world().spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
    }

    /// A red cube of Bevy's own, seen without light.
    fn red_cube(&mut self, edge: f32, transform: Transform) -> Entity {
        let mesh = self.world().resource_mut::<Assets<Mesh>>().add(Cuboid::from_length(edge));
        let material = StandardMaterial {
            base_color: Color::LinearRgba(LinearRgba::RED),
            unlit: true,
            ..default()
        };
        let material = self.world().resource_mut::<Assets<StandardMaterial>>().add(material);
        self.world().spawn((Mesh3d(mesh), MeshMaterial3d(material), transform)).id()
    }
}

fn looking(from: Vec3) -> Transform {
    Transform::from_translation(from).looking_at(Vec3::ZERO, Vec3::Y)
}

/// A parallel view of so many world units from bottom to top.
fn parallel(viewport_height: f32) -> Projection {
    Projection::Orthographic(OrthographicProjection {
        scaling_mode: ScalingMode::FixedVertical { viewport_height },
        ..OrthographicProjection::default_3d()
    })
}

/// The ray of a pixel of the stage's camera, in f64.
fn pixel_ray(view: Transform, x: u32, y: u32) -> (DVec3, DVec3) {
    pixel_ray_of(SIZE, view, x, y)
}

/// The same in a picture of another size.
fn pixel_ray_of(size: UVec2, view: Transform, x: u32, y: u32) -> (DVec3, DVec3) {
    let half = (45.0_f64.to_radians() * 0.5).tan();
    let aspect = f64::from(size.x) / f64::from(size.y);
    let ndc_x = (f64::from(x) + 0.5) / f64::from(size.x) * 2.0 - 1.0;
    let ndc_y = 1.0 - (f64::from(y) + 0.5) / f64::from(size.y) * 2.0;
    let dir = DVec3::new(ndc_x * half * aspect, ndc_y * half, -1.0);
    let rotation = DMat3::from_quat(view.rotation.as_dquat());
    (view.translation.as_dvec3(), rotation * dir)
}

/// Bevy's diffuse term, after Burley 2012, of a white surface.
fn burley(normal: DVec3, to_viewer: DVec3, to_light: DVec3, roughness: f64) -> f64 {
    let half = (to_viewer + to_light).normalize();
    let grazing = 0.5 + 2.0 * roughness * to_light.dot(half).powi(2);
    let scatter = |cosine: f64| 1.0 + (grazing - 1.0) * (1.0 - cosine.max(0.0)).powi(5);
    scatter(normal.dot(to_light)) * scatter(normal.dot(to_viewer)) / std::f64::consts::PI
}
