//! A photo studio as an environment map: polished metal needs something to reflect.

use std::f32::consts::TAU;

use bevy::asset::RenderAssetUsages;
use bevy::light::{EnvironmentMapLight, Skybox};
use bevy::math::ops;
use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, TextureDimension, TextureFormat, TextureViewDescriptor, TextureViewDimension,
};

/// The edge of the sharpest and of the most blurred mip level, in pixels.
const EDGES: [u32; 2] = [256, 8];

/// A softbox: a lamp behind a large screen.
struct Screen {
    /// Unit vectors to the right, upwards and towards the screen.
    axes: [Vec3; 3],
    /// Half the width and height, divided by the distance.
    half: Vec2,
    color: Vec3,
}

/// The room; its radiance is relative to that of its grey walls.
struct Studio([Screen; 4]);

impl Studio {
    fn new() -> Self {
        let screen = |towards: [f32; 3], half: [f32; 2], color: [f32; 3]| {
            let at = Transform::default().looking_to(Vec3::from(towards), Vec3::Y);
            let axes = [at.right(), at.up(), at.forward()].map(Vec3::from);
            Screen { axes, half: half.into(), color: color.into() }
        };
        Self([
            screen([-1.0, 0.9, 0.6], [0.45, 0.6], [24.0, 22.0, 19.0]),
            screen([1.2, 0.6, 0.3], [0.14, 0.75], [15.0, 18.0, 24.0]),
            screen([0.1, 1.0, -0.35], [1.1, 0.22], [18.0, 18.0, 18.0]),
            screen([0.35, 0.25, 1.0], [0.3, 0.2], [10.0, 7.0, 4.5]),
        ])
    }

    fn radiance(&self, dir: Vec3) -> Vec3 {
        let wall = 0.55 + 0.45 * dir.y;
        let mut seen = Vec3::new(0.95, 1.0, 1.1) * if dir.y < 0.0 { 0.35 * wall } else { wall };
        for screen in &self.0 {
            let [across, up, depth] = screen.axes.map(|axis| dir.dot(axis));
            if depth > 0.0 {
                let rim = (Vec2::new(across, up) / depth).abs() / screen.half;
                seen += screen.color * (25.0 - 24.0 * rim.max_element()).clamp(0.0, 1.0);
            }
        }
        seen
    }
}

/// The distribution of sampled directions: GGX half vectors for rough mirrors (Walter et al. 2007),
/// or cosine-weighted directions for diffuse reflection.
#[derive(Clone, Copy)]
enum Lobe {
    Mirror { alpha: f32 },
    Cosine,
}

/// The mean radiance around a direction.
fn mean(studio: &Studio, around: Vec3, lobe: Lobe, samples: u32) -> Vec3 {
    let (x, y) = around.any_orthonormal_pair();
    let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
    for i in 0..samples {
        let u = (i as f32 + 0.5) / samples as f32;
        let angle = TAU * (i as f32 * 0.618_034).fract();
        let cosine_squared = match lobe {
            Lobe::Mirror { alpha } => (1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u),
            Lobe::Cosine => 1.0 - u,
        };
        let (cosine, sine) = (cosine_squared.sqrt(), (1.0 - cosine_squared).max(0.0).sqrt());
        let (sin, cos) = ops::sin_cos(angle);
        let drawn = sine * (cos * x + sin * y) + cosine * around;
        let (dir, part) = match lobe {
            Lobe::Mirror { .. } => {
                let dir = 2.0 * cosine * drawn - around;
                (dir, dir.dot(around).max(0.0))
            }
            Lobe::Cosine => (drawn, 1.0),
        };
        sum += part * studio.radiance(dir);
        weight += part;
    }
    sum / weight
}

/// A cube map whose smaller mip levels are for rougher surfaces.
fn cube(edges: [u32; 2], of: impl Fn(Vec3, f32) -> Vec3) -> Image {
    let steps = edges[0].ilog2() - edges[1].ilog2();
    let mut data = Vec::new();
    for face in 0..6 {
        for step in 0..=steps {
            let edge = edges[0] >> step;
            let roughness = step as f32 / steps.max(1) as f32;
            for pixel in 0..edge * edge {
                let at = UVec2::new(pixel % edge, pixel / edge).as_vec2() + 0.5;
                let Vec2 { x: u, y: v } = 2.0 * at / edge as f32 - 1.0;
                // Cube maps are left-handed, so z is negated.
                let dir = match face {
                    0 => Vec3::new(1.0, -v, u),
                    1 => Vec3::new(-1.0, -v, -u),
                    2 => Vec3::new(u, 1.0, -v),
                    3 => Vec3::new(u, -1.0, v),
                    4 => Vec3::new(u, -v, -1.0),
                    _ => Vec3::new(-u, -v, 1.0),
                };
                let color = of(dir.normalize(), roughness).extend(1.0).to_array();
                data.extend(
                    color.map(half::f16::from_f32).map(half::f16::to_le_bytes).as_flattened(),
                );
            }
        }
    }
    let size = Extent3d { width: edges[0], height: edges[0], depth_or_array_layers: 6 };
    let mut image = Image::new_uninit(
        size,
        TextureDimension::D2,
        TextureFormat::Rgba16Float,
        RenderAssetUsages::RENDER_WORLD,
    );
    image.data = Some(data);
    image.texture_descriptor.mip_level_count = steps + 1;
    image.texture_view_descriptor =
        Some(TextureViewDescriptor { dimension: Some(TextureViewDimension::Cube), ..default() });
    image
}

/// The studio as a light and as a background; `luminance` is that of the grey walls in cd/m².
pub fn studio(images: &mut Assets<Image>, luminance: f32) -> (EnvironmentMapLight, Skybox) {
    let studio = Studio::new();
    let mirrored = cube(EDGES, |dir, roughness| match roughness {
        0.0 => studio.radiance(dir),
        _ => mean(&studio, dir, Lobe::Mirror { alpha: roughness * roughness }, 48),
    });
    let scattered = cube([8, 8], |dir, _| mean(&studio, dir, Lobe::Cosine, 512));
    let specular_map = images.add(mirrored);
    let light = EnvironmentMapLight {
        diffuse_map: images.add(scattered),
        specular_map: specular_map.clone(),
        intensity: luminance,
        ..default()
    };
    let background = Skybox { image: Some(specular_map), brightness: luminance, ..default() };
    (light, background)
}
