//! The scene, the same in a window and off-screen: files, volumes, light, ground, camera.

use std::path::{Path, PathBuf};

use bevy::asset::io::AssetReaderError;
use bevy::asset::{AssetLoadError, AssetPath, LoadState, RenderAssetUsages, UnapprovedPathMode};
use bevy::camera::Hdr;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::CascadeShadowConfigBuilder;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
use bevy_vdb::prelude::*;
use bevy_vdb::{VdbLoaderError, VdbLoaderSettings};

use crate::args::Args;
use crate::framing::View;
use crate::sequences::{self, Opening, Played};
use crate::volumes::Bounds;
use crate::{paged, select, volumes};

/// The sun, in lux, slightly warm. With Bevy's default exposure and the sky, a white surface that faces it is just
/// below white after tonemapping.
pub const SUN_ILLUMINANCE: f32 = 3_600.0;
pub const SUN_COLOR: LinearRgba = LinearRgba::rgb(1.0, 0.94, 0.86);

/// The uniform sky, in cd/m², slightly blue: bright enough to see what lies in shadows. White fog under a uniform sky
/// alone has no shading at all, so a bright sky makes clouds look flat.
pub const SKY_LUMINANCE: f32 = 340.0;
pub const SKY_COLOR: LinearRgba = LinearRgba::rgb(0.8, 0.9, 1.0);

/// The background colour before tonemapping.
pub const BACKGROUND: LinearRgba = LinearRgba::rgb(0.042, 0.062, 0.092);

/// Loads the files, and spawns the scene once they have been loaded.
pub struct ViewerPlugin(pub Args);

/// The options of the command line, or for files opened later.
#[derive(Resource)]
pub struct Settings(pub Args);

/// A message: display these files instead of the current ones.
#[derive(Clone, Debug, Message)]
pub struct Open(pub Vec<PathBuf>);

/// The progress of loading.
#[derive(Default, Resource)]
pub struct Status {
    waiting: Vec<(PathBuf, Handle<VdbFile>)>,
    pub opening: Vec<Opening>,
    /// Surfaces in pages.
    pub paged: Vec<(PathBuf, Handle<VdbPages>)>,
    pub arrived: Vec<Arrived>,
    /// Files and grids that cannot be displayed, with the reason.
    pub errors: Vec<String>,
    /// Whether a frame that cannot be shown is among them, or was.
    pub has_complained: bool,
    /// The bounds of sequences over time.
    pub reach: Option<Bounds>,
    /// The view; set once all files have been loaded or have failed.
    pub view: Option<View>,
}

/// A file that has been loaded, or a sequence with a frame of it.
pub struct Arrived {
    pub path: PathBuf,
    pub file: Handle<VdbFile>,
    pub played: Option<Played>,
}

/// Marks entities that are despawned when other files are opened.
#[derive(Component)]
pub struct OfFiles;

/// Loads files from `assets/` of this package, where they are reloaded when they change, and from
/// anywhere else by absolute path.
pub fn asset_plugin() -> AssetPlugin {
    AssetPlugin {
        file_path: asset_root().display().to_string(),
        unapproved_path_mode: UnapprovedPathMode::Allow,
        ..default()
    }
}

pub fn asset_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets")
}

/// The camera of the viewer, without `Camera` and `Transform`.
pub fn camera(args: &Args) -> impl Bundle {
    (
        Camera3d::default(),
        Hdr,
        Msaa::Sample4,
        tonemapping(args.mode),
        VdbCamera {
            mode: args.mode,
            overlays: args.overlays,
            multiple_scattering: args.scatters_again,
            ..default()
        },
        AmbientLight { color: SKY_COLOR.into(), brightness: SKY_LUMINANCE, ..default() },
    )
}

/// The tonemapping of a render mode: a curve that only changes bright colours for light, and none
/// for data.
pub fn tonemapping(mode: VdbRenderMode) -> Tonemapping {
    if mode.is_lit() { Tonemapping::KhronosPbrNeutral } else { Tonemapping::None }
}

impl Plugin for ViewerPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins(VdbRenderPlugin)
            .insert_resource(ClearColor(BACKGROUND.into()))
            .insert_resource(Settings(self.0.clone()))
            .init_resource::<Status>()
            .add_message::<Open>()
            .add_systems(Startup, (load, light))
            .add_systems(
                Update,
                (
                    open,
                    (sequences::follow, arrive)
                        .chain()
                        .run_if(|status: Res<Status>| status.view.is_none()),
                )
                    .chain(),
            );
    }
}

fn load(assets: Res<AssetServer>, settings: Res<Settings>, mut status: ResMut<Status>) {
    for file in &settings.0.files {
        if paged::is_paged(file) {
            status.paged.push(paged::load(&assets, file));
            continue;
        }
        if sequences::is_sequence(file) {
            match sequences::load(&assets, file) {
                Ok(opening) => status.opening.push(opening),
                Err(why) => status.errors.push(why),
            }
            continue;
        }
        let path = file.strip_prefix(asset_root()).unwrap_or(file).to_owned();
        let only = settings.0.loaded();
        let smooth = settings.0.smooth;
        let handle = assets
            .load_builder()
            .with_settings(move |settings: &mut VdbLoaderSettings| {
                settings.grids = (!only.is_empty()).then(|| only.clone());
                settings.smooth = smooth;
            })
            .load(AssetPath::from_path_buf(path));
        status.waiting.push((file.clone(), handle));
    }
}

/// Clears the scene, and loads other files.
fn open(
    mut commands: Commands,
    mut messages: MessageReader<Open>,
    old: Query<Entity, With<OfFiles>>,
    assets: Res<AssetServer>,
    mut settings: ResMut<Settings>,
    mut status: ResMut<Status>,
) {
    // Files that are dropped together may arrive one by one.
    let files: Vec<PathBuf> = messages.read().flat_map(|Open(files)| files.clone()).collect();
    if files.is_empty() {
        return;
    }
    old.iter().for_each(|entity| commands.entity(entity).despawn());
    // Options about grids and the camera belong to the previous files.
    let args = &mut settings.0;
    *args = args.of_other_files(files);
    *status = Status::default();
    load(assets, settings.into(), status);
}

fn light(mut commands: Commands, settings: Res<Settings>) {
    let args = &settings.0;
    let sun = DirectionalLight {
        color: SUN_COLOR.into(),
        illuminance: SUN_ILLUMINANCE,
        shadow_maps_enabled: args.shadows,
        ..default()
    };
    let towards = args.sun.as_vec3();
    let up = if towards.cross(Vec3::Y).length() < 1e-3 { Vec3::Z } else { Vec3::Y };
    commands.spawn((Name::new("sun"), sun, Transform::default().looking_to(-towards, up)));
}

/// Waits for the files, then spawns the volumes and places the camera.
fn arrive(
    mut commands: Commands,
    assets: Res<AssetServer>,
    (files, pages): (Res<Assets<VdbFile>>, Res<Assets<VdbPages>>),
    (mut grids, vectors): (ResMut<Assets<VdbGrid>>, Res<Assets<VdbVectorGrid>>),
    settings: Res<Settings>,
    mut status: ResMut<Status>,
    (meshes, materials, images): (
        Option<ResMut<Assets<Mesh>>>,
        Option<ResMut<Assets<StandardMaterial>>>,
        Option<ResMut<Assets<Image>>>,
    ),
    cameras: Query<Entity, With<Camera3d>>,
    suns: Query<Entity, With<DirectionalLight>>,
) {
    let status = &mut *status;
    for (path, handle) in std::mem::take(&mut status.waiting) {
        match assets.load_state(&handle) {
            LoadState::Failed(error) => {
                status.errors.push(format!("{}: {}", path.display(), reason(&error)));
            }
            LoadState::Loaded => {
                status.arrived.push(Arrived { path, file: handle, played: None });
            }
            _ => status.waiting.push((path, handle)),
        }
    }
    let are_paged = paged::have_arrived(&assets, status);
    if !status.waiting.is_empty() || !status.opening.is_empty() || !are_paged {
        return;
    }
    let mut bounds = paged::spawn(&mut commands, status, &pages);
    let args = &settings.0;
    let there: Vec<(&Path, &VdbFile, Option<&Played>)> = status
        .arrived
        .iter()
        .filter_map(|own| Some((own.path.as_path(), files.get(&own.file)?, own.played.as_ref())))
        .collect();
    let mut errors = Vec::new();
    if !there.is_empty() {
        for (option, name) in select::missing(args, &there) {
            errors.push(format!("{option} {name}: no file has such a grid"));
        }
    }
    for (path, file, played) in there {
        let file = (path, file, played);
        match volumes::spawn(&mut commands, args, file, (&files, &mut grids, &vectors)) {
            Err(why) => errors.push(why),
            Ok(own) => {
                bounds = volumes::union(bounds, own);
                if played.is_some() {
                    status.reach = volumes::union(status.reach, own);
                }
            }
        }
    }
    status.errors.extend(errors);
    // Without a visible grid, the camera looks at the origin.
    let view = View::new(&settings.0, bounds.unwrap_or((DVec3::NEG_ONE, DVec3::ONE)));
    for camera in &cameras {
        let projection = PerspectiveProjection {
            fov: view.fov_y as f32,
            near: view.near as f32,
            far: (view.near * 1e7) as f32,
            ..default()
        };
        let projection = Projection::Perspective(projection);
        commands.entity(camera).insert((view.transform(), projection));
    }
    for sun in &suns {
        commands.entity(sun).insert(cascades(&view));
    }
    if let (true, Some(meshes), Some(materials), Some(images)) =
        (settings.0.ground, meshes, materials, images)
    {
        spawn_ground(&mut commands, meshes, materials, images, &view);
    }
    status.view = Some(view);
}

/// The cascades of Bevy's shadow maps, which cover the ground.
fn cascades(view: &View) -> bevy::light::CascadeShadowConfig {
    let near = view.near as f32;
    let far = (view.eye.distance(view.target) + 4.0 * view.radius()) as f32;
    let far = far.max(2.0 * near);
    let first = near + (far - near) / 8.0;
    // Bevy panics if the bounds are not ascending, which happens if they exceed f32.
    if !(near < first && first < far && far.is_finite()) {
        return default();
    }
    CascadeShadowConfigBuilder {
        minimum_distance: near,
        first_cascade_far_bound: first,
        maximum_distance: far,
        ..default()
    }
    .build()
}

/// Spawns the ground below the volumes, and a ball beside their bounding box.
fn spawn_ground(
    commands: &mut Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut images: ResMut<Assets<Image>>,
    view: &View,
) {
    let (low, high) = view.bounds;
    let middle = (low + high) / 2.0;
    let matte = |color| StandardMaterial {
        base_color: color,
        perceptual_roughness: 0.9,
        reflectance: 0.2,
        ..default()
    };
    // Fades into the background, so that no edge cuts through the image. Opaque, because what is transparent
    // is drawn over volumes.
    let ground = StandardMaterial {
        base_color_texture: Some(images.add(disc(|distance| 1.0 - distance))),
        emissive: BACKGROUND,
        emissive_exposure_weight: 0.0,
        emissive_texture: Some(images.add(disc(|distance| distance))),
        reflectance: 0.0,
        ..matte(Color::srgb(0.45, 0.46, 0.48))
    };
    let below = Transform::from_translation(DVec3::new(middle.x, low.y, middle.z).as_vec3())
        .with_scale(Vec3::splat(2.0 * GROUND_RADIUS * view.radius() as f32));
    commands.spawn((
        OfFiles,
        Mesh3d(meshes.add(Plane3d::default().mesh().size(1.0, 1.0))),
        MeshMaterial3d(materials.add(ground)),
        below,
    ));
    let radius = 0.22 * view.radius();
    let ball = meshes.add(Sphere::new(1.0).mesh().uv(64, 32));
    let beside = DVec3::new(high.x, low.y + radius, middle.z).as_vec3();
    let beside = Transform::from_translation(beside).with_scale(Vec3::splat(radius as f32));
    commands.spawn((
        OfFiles,
        Mesh3d(ball),
        MeshMaterial3d(materials.add(matte(Color::srgb(0.85, 0.42, 0.12)))),
        beside,
    ));
}

/// The radius of the ground relative to that of the scene.
const GROUND_RADIUS: f32 = 8.0;

/// A grey image of a smooth function of the distance from the middle, which is 1 at the edges.
fn disc(value: impl Fn(f32) -> f32) -> Image {
    const SIZE: u32 = 256;
    let pixel = |i: u32| {
        let at = UVec2::new(i % SIZE, i / SIZE).as_vec2() + 0.5;
        let distance = (2.0 * at / SIZE as f32 - 1.0).length().min(1.0);
        let smooth = distance * distance * (3.0 - 2.0 * distance);
        let grey = (255.0 * value(smooth)).round() as u8;
        [grey, grey, grey, 255]
    };
    let size = Extent3d { width: SIZE, height: SIZE, depth_or_array_layers: 1 };
    let data = (0..SIZE * SIZE).flat_map(pixel).collect();
    let format = TextureFormat::Rgba8Unorm;
    Image::new(size, TextureDimension::D2, data, format, RenderAssetUsages::RENDER_WORLD)
}

/// The reason why a file was not loaded, without the text that Bevy adds.
pub fn reason(error: &AssetLoadError) -> String {
    match error {
        AssetLoadError::AssetLoaderError(error) => match error.error().downcast_ref() {
            Some(error) => VdbLoaderError::to_string(error),
            None => error.error().to_string(),
        },
        AssetLoadError::AssetReaderError(AssetReaderError::NotFound(_)) => {
            "no such file or folder".into()
        }
        AssetLoadError::AssetReaderError(AssetReaderError::Io(error)) => error.to_string(),
        other => {
            let text = other.to_string();
            // What Bevy puts before the reason why a folder is no sequence.
            text.split_once("`add_async`: ").map_or(text.as_str(), |(_, why)| why).to_owned()
        }
    }
}
