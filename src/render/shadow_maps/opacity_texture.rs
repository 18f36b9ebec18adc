//! The texture of opacity maps. It is kept from frame to frame, and a map in it is filled again only when what it
//! shows has changed.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::atomic::{AtomicBool, Ordering};

use bevy::platform::collections::HashSet;
use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages,
    TextureView, TextureViewDescriptor, TextureViewDimension,
};
use bevy::render::renderer::RenderDevice;

use super::cast::Cast;
use super::opacity::Places;
use crate::render::gpu::types;

pub(super) const FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// The layers of the texture: one for the ends of slices, and one for four slices each.
const LAYERS: u32 = 9;

/// The texture, and what the maps in it were made from.
#[derive(Default, Resource)]
pub(super) struct OpacityTexture {
    texture: Option<(Texture, TextureView)>,
    maps: FilledMaps,
}

impl OpacityTexture {
    pub fn get(&self) -> Option<(&Texture, &TextureView)> {
        self.texture.as_ref().map(|(texture, view)| (texture, view))
    }

    /// Makes room for the maps of a frame. Returns those that have to be filled; the others are empty. `pipelines` is
    /// a number that changes when those that fill maps do.
    pub fn plan(
        &mut self,
        cast: &Cast,
        places: &Places,
        pipelines: u64,
        device: &RenderDevice,
    ) -> Vec<types::OpacityMap> {
        let extent = |texture: &Texture| UVec2::new(texture.width(), texture.height());
        if self.texture.as_ref().is_none_or(|(texture, _)| extent(texture) != places.size) {
            self.maps = default();
            self.texture = Some(new_texture(places.size, device));
        }
        let mut missing = vec![types::OpacityMap::default(); places.maps.len()];
        let wanted = cast.opacity_maps().map(|(view, volume, content)| {
            let map = places.maps[volume];
            (volume, fingerprint(view, &cast.volumes[volume], &map, (content, pipelines)))
        });
        for volume in self.maps.plan(wanted) {
            missing[volume] = places.maps[volume];
        }
        missing
    }

    /// Notes that the maps that had to be filled are.
    pub fn set_filled(&self) {
        self.maps.has_run.store(true, Ordering::Relaxed);
    }
}

/// A number that changes whenever a map may: with its place, with the fog or with the view by whose rays it is filled.
fn fingerprint(
    view: &types::View,
    fog: &types::Volume,
    map: &types::OpacityMap,
    others: (u64, u64),
) -> u64 {
    let view = types::View { volume_first: 0, volume_count: 0, ..*view };
    let mut hasher = DefaultHasher::new();
    bytemuck::bytes_of(&view).hash(&mut hasher);
    bytemuck::bytes_of(fog).hash(&mut hasher);
    bytemuck::bytes_of(map).hash(&mut hasher);
    others.hash(&mut hasher);
    hasher.finish()
}

/// The fingerprints of maps.
#[derive(Default)]
struct FilledMaps {
    /// Of those in the texture.
    filled: HashSet<u64>,
    /// Of those of the last frame, and whether they have been filled.
    planned: HashSet<u64>,
    has_run: AtomicBool,
}

impl FilledMaps {
    /// Begins a frame with these maps. Returns those that have to be filled.
    fn plan(&mut self, wanted: impl Iterator<Item = (usize, u64)>) -> Vec<usize> {
        if std::mem::take(self.has_run.get_mut()) {
            std::mem::swap(&mut self.filled, &mut self.planned);
        } else {
            // Not every camera draws: its window may be minimized. Maps that were in the last frame have kept their
            // places; others may not have.
            self.filled.retain(|map| self.planned.contains(map));
        }
        self.planned.clear();
        let missing = wanted.filter(|(_, map)| {
            self.planned.insert(*map);
            !self.filled.contains(map)
        });
        missing.map(|(volume, _)| volume).collect()
    }
}

fn new_texture(size: UVec2, device: &RenderDevice) -> (Texture, TextureView) {
    let texture = device.create_texture(&TextureDescriptor {
        label: Some("vdb_opacity"),
        size: Extent3d { width: size.x, height: size.y, depth_or_array_layers: LAYERS },
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format: FORMAT,
        usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    let view = texture.create_view(&TextureViewDescriptor {
        dimension: Some(TextureViewDimension::D2Array),
        ..default()
    });
    (texture, view)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(maps: &mut FilledMaps, wanted: &[u64]) -> Vec<usize> {
        maps.plan(wanted.iter().copied().enumerate())
    }

    fn run(maps: &FilledMaps) {
        maps.has_run.store(true, Ordering::Relaxed);
    }

    #[test]
    fn maps_are_filled_once() {
        let mut maps = FilledMaps::default();
        assert_eq!(plan(&mut maps, &[7, 8]), [0, 1]);
        assert_eq!(plan(&mut maps, &[7, 8]), [0, 1], "nothing was drawn");
        run(&maps);
        for _ in 0..3 {
            assert_eq!(plan(&mut maps, &[8, 7]), [0; 0]);
        }
        assert_eq!(plan(&mut maps, &[7, 9, 8]), [1], "another one");
        assert_eq!(plan(&mut maps, &[7, 9, 8]), [1], "it was not drawn");
        run(&maps);
        assert_eq!(plan(&mut maps, &[9]), [0; 0]);
        // Others may have taken its place since.
        assert_eq!(plan(&mut maps, &[9, 7]), [1]);
        assert_eq!(plan(&mut maps, &[8, 9]), [0], "neither was filled when it was last wanted");
    }

    #[test]
    fn whatever_a_map_shows_is_in_its_fingerprint() {
        let (view, fog, map) = <(types::View, types::Volume, types::OpacityMap)>::default();
        let first = fingerprint(&view, &fog, &map, (1, 1));
        let same = types::View { volume_first: 3, volume_count: 2, ..view };
        assert_eq!(fingerprint(&same, &fog, &map, (1, 1)), first);
        let turned = types::View { dir: [1.0; 3], ..view };
        let denser = types::Volume { density_scale: 2.0, ..fog };
        let elsewhere = types::OpacityMap { origin: [8, 0], ..map };
        for other in [
            fingerprint(&turned, &fog, &map, (1, 1)),
            fingerprint(&view, &denser, &map, (1, 1)),
            fingerprint(&view, &fog, &elsewhere, (1, 1)),
            fingerprint(&view, &fog, &map, (2, 1)),
            fingerprint(&view, &fog, &map, (1, 2)),
        ] {
            assert_ne!(other, first);
        }
    }
}
