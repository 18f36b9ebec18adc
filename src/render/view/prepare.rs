//! Preparation of views, once it is known which pipelines are ready: the data of their shaders.

use bevy::diagnostic::FrameCount;
use bevy::math::DMat4;
use bevy::prelude::*;
use bevy::render::camera::{ExtractedCamera, TemporalJitter};
use bevy::render::render_resource::{BufferInitDescriptor, BufferUsages, RawBufferVec};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::view::ExtractedView;

use super::bvh;
use super::key::ViewKey;
use super::media::{DrawnMedia, hide_surplus, is_medium};
use super::settings::rays;
use super::state::{PreparedView, ResolvedView, ViewState};
use super::tiles::TileLayout;
use super::uniform::{overlay_bits, random_offset, view_data};
use crate::quality::features::Features;
use crate::render::extract::{
    ExtractedClipPlanes, ExtractedSuns, ExtractedVolume, ExtractedVolumes,
};
use crate::render::gpu::{non_negative, types};
use crate::{VdbCamera, VdbRenderMode};

/// The largest exposure. With the bounds of materials, it keeps products within f32, because WGSL
/// may assume that there are no infinities.
const MAX_EXPOSURE: f32 = 1e12;

/// The least value that is shown in white.
const MIN_MAXIMUM: f32 = 1e-30;

/// The volumes of all views of the frame.
#[derive(Resource)]
pub(crate) struct VolumeBuffer(pub RawBufferVec<types::Volume>);

impl Default for VolumeBuffer {
    fn default() -> Self {
        Self(RawBufferVec::new(BufferUsages::STORAGE))
    }
}

/// The resources for preparing views.
type Scene<'w> = (
    Res<'w, ExtractedVolumes>,
    (Res<'w, ExtractedSuns>, Res<'w, ExtractedClipPlanes>),
    Res<'w, FrameCount>,
);

/// Chooses the pipelines of each view, and prepares the data of its shaders.
pub(super) fn prepare_views(
    mut views: Query<(&mut ViewState, &ExtractedView, &ExtractedCamera, Option<&TemporalJitter>)>,
    scene: Scene,
) {
    for (mut state, view, camera, jitter) in &mut views {
        let before = state.prepared.take();
        let Some(resolved) = state.resolved.take() else { continue };
        state.pipelines.note(&resolved.asked);
        let chosen = choose(&resolved, before.as_ref());
        state.prepared = Some(prepare(resolved, chosen, (view, camera, jitter), &scene));
    }
}

/// The key of the pipelines chosen for a view.
struct Chosen {
    key: ViewKey,
    is_ready: bool,
    is_fallback: bool,
    /// The media that a fallback has drawn.
    drawn: DrawnMedia,
}

/// Chooses the required pipelines or, until they have been compiled, others that can replace them:
/// those that have just been compiled, or those of the previous frame. No volume vanishes because
/// another one appears.
fn choose(resolved: &ResolvedView, before: Option<&PreparedView>) -> Chosen {
    let (wanted, present) = (resolved.key, resolved.settings.lights_present);
    let asked = &resolved.asked;
    let before = before.filter(|before| before.is_ready);
    let drawn = before.map(drawn_media).unwrap_or_default();
    let other = match before {
        _ if asked.are_ready => Some(asked.key),
        Some(before) if before.key != wanted => Some(before.key),
        _ => None,
    };
    match other.filter(|key| *key != wanted && key.can_replace(&wanted, present)) {
        Some(key) => Chosen { key, is_ready: true, is_fallback: true, drawn },
        None => Chosen {
            key: wanted,
            is_ready: asked.are_ready && asked.key == wanted,
            is_fallback: false,
            drawn: default(),
        },
    }
}

/// The media that a view displays.
fn drawn_media(view: &PreparedView) -> DrawnMedia {
    let displayed = view.entries.iter().zip(&view.volumes).take(view.displayed());
    let media = displayed.filter(|(_, volume)| is_medium(volume.kind));
    media.map(|(entry, volume)| (entry.owner, volume.kind)).collect()
}

fn prepare(
    resolved: ResolvedView,
    chosen: Chosen,
    (view, camera, jitter): (&ExtractedView, &ExtractedCamera, Option<&TemporalJitter>),
    (all, (suns, clip_planes), frame): &Scene,
) -> PreparedView {
    let ResolvedView { settings, rays: view_rays, world_from_view, clip_from_view, .. } = &resolved;
    let (key, quality) = (chosen.key, &settings.quality);
    let picture = settings.picture;
    let size = if key.has(Features::SCALED) { rays(picture, quality.resolution) } else { picture };
    let (mut volumes, most_tiles) = fill_list(&resolved, &key, size, all);
    let list = &resolved.list;
    if let Some(slots) = key.media
        && !key.has(Features::UNCACHED_FOGS)
    {
        let owners = list.entries.iter().map(|entry| entry.owner);
        let displayed = key.displayed(list.seen, list.entries.len());
        hide_surplus(owners.zip(&mut volumes).take(displayed), &chosen.drawn, slots);
    }
    let layout = TileLayout::new(size, list.seen as u32);
    let eye = world_from_view.transform_point3(view_rays.eye);
    let data = types::View {
        exposure: non_negative(camera.exposure).min(MAX_EXPOSURE),
        volume_count: list.seen as u32,
        offscreen_count: (list.entries.len() - list.seen) as u32,
        size: size.to_array(),
        origin: view.viewport.xy().to_array(),
        mode_scale: mode_scale(&settings.camera),
        reflections: settings.reflections,
        slabs: quality.fog_slabs,
        picture: picture.to_array(),
        shadow_range: quality.shadow_range.min(types::FARTHEST),
        reflection_range: quality.reflection_range.min(types::FARTHEST),
        overlays: overlay_bits(settings.camera.overlays),
        tile_words: layout.tile_words,
        group_bits: layout.group_bits,
        has_tile_starts: u32::from(layout.has_starts),
        random_offset: random_offset(jitter, **frame),
        frame: jitter.map_or(0, |_| frame.0),
        max_frames: quality.accumulate,
        edge_samples: quality.edge_samples,
        clip_planes: clip_planes.data(cut_by(&volumes), eye),
        ..view_data(view_rays, *world_from_view, suns)
    };
    let fogs = [types::KIND_FOG, types::KIND_EMISSION, types::KIND_BLACKBODY];
    PreparedView {
        key,
        is_ready: chosen.is_ready,
        is_fallback: chosen.is_fallback,
        data,
        volumes,
        eye,
        layout,
        most_tiles,
        clip_from_view: *clip_from_view,
        has_surfaces: list.kinds_seen.has([types::KIND_SURFACE, types::KIND_SMOOTH]),
        // Steps are also shown where there is no surface, and a pixel may show a surface in less
        // than half of the accumulated frames, or beside its middle.
        has_fog: (list.kinds_seen.has(fogs) && settings.shows_fog())
            || settings.camera.mode.traits().shows_background
            || key.has(Features::ACCUMULATED)
            || key.has(Features::EDGES),
        uniform: None,
        entries: resolved.list.entries,
    }
}

/// The clip planes of volumes, a bit each.
pub(crate) fn cut_by(volumes: &[types::Volume]) -> u32 {
    volumes.iter().fold(0, |all, volume| all | volume.clip_planes)
}

/// What the render mode shows in its last colour.
fn mode_scale(camera: &VdbCamera) -> f32 {
    match camera.mode {
        VdbRenderMode::Maximum => non_negative(camera.maximum_scale).max(MIN_MAXIMUM),
        _ => non_negative(camera.steps_scale).max(1.0),
    }
}

/// The volume list as the chosen pipelines can read it, and the largest number of tiles of an
/// entry.
fn fill_list(
    resolved: &ResolvedView,
    key: &ViewKey,
    size: UVec2,
    all: &ExtractedVolumes,
) -> (Vec<types::Volume>, u32) {
    let list = &resolved.list;
    let mut volumes = list.data.clone();
    let clip_from_world =
        resolved.clip_from_view.as_dmat4() * DMat4::from(resolved.world_from_view.inverse());
    let owned: Vec<&ExtractedVolume> =
        list.entries.iter().filter_map(|entry| all.0.get(&entry.owner)).collect();
    let mut most_tiles = 0;
    for (i, (data, entry)) in volumes.iter_mut().zip(&list.entries).enumerate() {
        data.kind = key.kind_for(data.kind, entry.sample_format);
        let is_left_out = (data.ramp != 0 && !key.has(Features::RAMPS))
            // Shaders that do not tell levels apart show the one for the nearest point.
            || (data.t_first > -types::FARTHEST && !key.has(Features::LEVELS));
        if is_left_out {
            data.kind = types::KIND_NONE;
        }
        if !owned.get(i).is_some_and(|volume| key.reads_colors(&volume.auxiliary.colors)) {
            data.color_grids = types::NO_COLOR;
        }
        if i < list.seen {
            let range = entry.tile_range(clip_from_world, size);
            most_tiles = most_tiles.max(range.count());
            [data.tiles_first, data.tiles_last] = range.words();
        }
    }
    if key.has(Features::MANY) {
        let eye = resolved.world_from_view.transform_point3(resolved.rays.eye);
        bvh::fill(&mut volumes[..owned.len()], &owned, eye);
    }
    (volumes, most_tiles)
}

/// Uploads the uniforms and the volume lists of views.
pub(super) fn upload_views(
    mut views: Query<&mut ViewState>,
    mut volume_buffer: ResMut<VolumeBuffer>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    volume_buffer.0.clear();
    for mut state in &mut views {
        let Some(prepared) = &mut state.prepared else { continue };
        let first = volume_buffer.0.len() as u32;
        prepared.data.volume_first = first;
        for volume in &mut prepared.volumes {
            if volume.color_grids != types::NO_COLOR {
                volume.color_grids += first;
            }
        }
        volume_buffer.0.extend(prepared.volumes.iter().copied());
        prepared.uniform = Some(device.create_buffer_with_data(&BufferInitDescriptor {
            label: Some("vdb_view"),
            contents: bytemuck::bytes_of(&prepared.data),
            usage: BufferUsages::UNIFORM,
        }));
    }
    volume_buffer.0.write_buffer(&device, &queue);
}
