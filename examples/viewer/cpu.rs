//! Rendering with the reference tracer, for machines without a GPU adapter.

use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::reference::Occupied;
use bevy_vdb::vdb_core::reference::picture::{
    Look, Picture, Scene, SunLight, Volume, VolumeKind, render,
};

use crate::app::{BACKGROUND, SKY_COLOR, SKY_LUMINANCE, SUN_COLOR, SUN_ILLUMINANCE, Status};
use crate::args::Args;
use crate::framing::View;

/// Refuses options that the reference tracer does not support, before anything is loaded.
pub fn check(args: &Args) -> Result<(), String> {
    match args.mode {
        VdbRenderMode::Lit | VdbRenderMode::Depth => {}
        _ => return Err("on the CPU, only the modes lit and depth are available".into()),
    }
    if args.files.iter().any(|file| crate::paged::is_paged(file)) {
        return Err(
            "on the CPU, surfaces in pages cannot be drawn; load the file as a whole".into()
        );
    }
    if args.ground {
        eprintln!("viewer: the CPU tracer does not support meshes: --ground is ignored");
    }
    Ok(())
}

/// Renders the volumes of the app.
pub fn draw(app: &mut App, args: &Args) -> Result<Vec<[u8; 3]>, String> {
    let view = app.world().resource::<Status>().view.ok_or("nothing has been loaded")?;
    let mut extras =
        app.world_mut().query_filtered::<(), Or<(With<VdbEmission>, With<VdbColorGrid>)>>();
    if extras.iter(app.world()).next().is_some() {
        eprintln!("viewer: the CPU tracer does not support emission and colour grids");
    }
    let mut volumes = app.world_mut().query::<(&VdbVolume, &VdbMaterial, &Visibility)>();
    let world = app.world();
    let grids = world.resource::<Assets<VdbGrid>>();
    let drawn = |(volume, material): (&VdbVolume, &VdbMaterial)| {
        let grid = grids.get(&volume.0)?;
        let Some(tree) = grid.tree() else {
            return Some(Err("cooked files cannot be drawn on the CPU; open the .vdb file"));
        };
        let (world_from_index, kind) = (grid.world_from_index(), kind(grid, material));
        Some(Ok(Volume { tree: &**tree, world_from_index, kind }))
    };
    let volumes = volumes
        .iter(world)
        .filter(|(.., visibility)| **visibility != Visibility::Hidden)
        .filter_map(|(volume, material, _)| drawn((volume, material)))
        .collect::<Result<_, _>>()?;
    let exposure = bevy::camera::Exposure::default().exposure();
    let scene = Scene {
        volumes,
        sun: SunLight {
            direction: args.sun,
            radiance: exposure * SUN_ILLUMINANCE / std::f32::consts::PI * SUN_COLOR.to_vec3(),
        },
        ambient: exposure * SKY_LUMINANCE * SKY_COLOR.to_vec3(),
        background: BACKGROUND.to_vec4(),
        shadows: args.shadows,
        look: Look::Standard {
            perceptual_roughness: VdbMaterial::default().perceptual_roughness.into(),
            reflectance: VdbMaterial::default().reflectance.into(),
        },
    };
    let picture = render(&scene, &view.camera(), args.size);
    Ok(match args.mode {
        VdbRenderMode::Depth => depth(&picture, &view, args.size),
        _ => picture.color.iter().map(|color| encode(pbr_neutral(color.truncate()))).collect(),
    })
}

fn kind(grid: &VdbGrid, material: &VdbMaterial) -> VolumeKind {
    let albedo = material.base_color.to_linear().to_vec3();
    match grid.kind() {
        PackKind::Surface { iso } => {
            VolumeKind::Blocky { occupied: Occupied::BelowIso(iso), albedo }
        }
        PackKind::Smooth { iso } => VolumeKind::Smooth { iso, albedo },
        PackKind::Fog => VolumeKind::Fog {
            extinction: f64::from(material.density_scale),
            albedo,
            emission: Vec3::ZERO,
            anisotropy: f64::from(material.anisotropy),
        },
    }
}

/// The values of Bevy's depth buffer: the distance of the near plane divided by that of the
/// surface, both along the view axis.
fn depth(picture: &Picture, view: &View, size: UVec2) -> Vec<[u8; 3]> {
    let camera = view.camera();
    let forward = (view.target - view.eye).normalize();
    let pixels = picture.depth.iter().enumerate().map(|(i, distance)| {
        if distance.is_infinite() {
            return encode(BACKGROUND.to_vec3());
        }
        let pixel = UVec2::new(i as u32 % size.x, i as u32 / size.x);
        let along = f64::from(*distance) * camera.ray(pixel, size).1.dot(forward);
        encode(Vec3::splat((view.near / along) as f32))
    });
    pixels.collect()
}

/// The equivalent of Bevy's `tonemapping_pbr_neutral`.
fn pbr_neutral(color: Vec3) -> Vec3 {
    const START: f32 = 0.8 - 0.04;
    const DESATURATION: f32 = 0.15;
    let least = color.min_element();
    let color = color - if least < 0.08 { least - 6.25 * least * least } else { 0.04 };
    let peak = color.max_element();
    if peak < START {
        return color;
    }
    let room = 1.0 - START;
    let new_peak = 1.0 - room * room / (peak + room - START);
    let mix = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    (color * new_peak / peak).lerp(Vec3::splat(new_peak), mix)
}

/// Converts a linear colour to sRGB with 8 bits per channel.
fn encode(color: Vec3) -> [u8; 3] {
    Srgba::from(LinearRgba::from_vec3(color)).to_u8_array_no_alpha()
}
