//! Opacity maps: the optical depths of fogs along the rays of lights. There is a ray for each voxel across, so the
//! texels of a shadow map, of which many may show the same voxels, need none of their own.

use bevy::math::{DVec2, DVec3};
use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
    TextureViewDescriptor, TextureViewDimension,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::{CachedTexture, TextureCache};

use crate::render::gpu::{TILE, types};
use crate::render::view::{Eye, Shown, TileRange};

pub(super) const FORMAT: TextureFormat = TextureFormat::Rgba16Float;

/// The layers of the texture: one for the ends of slices, and one for four slices each.
const LAYERS: u32 = 9;

/// The most rays of all maps together, which limits their memory: each takes 72 bytes. If voxels are so small that
/// more would be needed, rays are farther apart.
const MAX_RAYS: f64 = (1 << 20) as f64;

/// The least distance between rays, in texels of the shadow map: shadow map filtering hides anything finer.
pub(super) const LEAST_SPACING: f64 = 2.0;

/// The most rays along each axis of a map, so that the texture is within WebGPU's limits.
const MAX_EDGE: f64 = 2048.0;

/// Texels by which the width and the height of the texture grow, so that it is seldom a new one.
const GROWTH: u32 = 64;

/// The map of one fog as one light sees it, before it has a place in the texture.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Wanted {
    /// The index of the volume by whose rays it is filled. Distances are in the texels of that view.
    pub volume: usize,
    /// The corners of what it has to cover.
    pub low: DVec2,
    pub high: DVec2,
    /// The distance between rays if there is one for each voxel, and the least that is useful.
    pub voxel: DVec2,
    pub least: DVec2,
    /// The depths of the fog's box.
    pub depths: [f64; 2],
    pub readers: Vec<Reader>,
}

/// A volume in a shadow map that reads an opacity map filled by another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reader {
    pub volume: usize,
    /// The texel and the depth in the shadow map that those of the other view are at: `origin + scale · (x, y, t)`.
    pub origin: DVec3,
    pub scale: DVec3,
}

impl Wanted {
    /// A map for the texels of a shadow map that may show a fog, which is filled by the rays of that shadow map.
    pub fn new(volume: usize, shown: &Shown, eye: Eye, range: TileRange) -> Option<Self> {
        let depths = eye.depths(shown.world_from_index(), shown.index_box()?);
        Some(Self {
            volume,
            low: (range.first * TILE).as_dvec2(),
            high: ((range.last + 1) * TILE).as_dvec2(),
            // Voxels cover the fewest texels where they are farthest.
            voxel: voxel_edge(shown) / eye.pixel_edges(depths[1]),
            least: DVec2::splat(LEAST_SPACING),
            depths,
            readers: Vec::new(),
        })
    }

    /// The distance between rays if it is a multiple of the least that is useful.
    fn spacing(&self, factor: f64) -> DVec2 {
        let extent = self.high - self.low;
        let least = self.least.max(extent / (MAX_EDGE - 3.0));
        (factor * self.voxel.max(least)).min(extent)
    }

    /// The first ray, which is at a multiple of the spacing so that rays stay where they are when the corners
    /// move, and the number of rays along each axis.
    fn rays(&self, factor: f64) -> [DVec2; 2] {
        let spacing = self.spacing(factor);
        let first = (self.low / spacing).floor() * spacing;
        [first, ((self.high - first) / spacing).ceil() + 1.0]
    }
}

/// The shortest edge of a fog's voxels in world units.
pub(super) fn voxel_edge(shown: &Shown) -> f64 {
    let axes = shown.world_from_index().matrix3;
    let edges = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis.length());
    edges.into_iter().fold(f64::INFINITY, f64::min)
}

/// Where maps are in a texture, and its size in texels.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Places {
    pub maps: Vec<types::OpacityMap>,
    pub size: UVec2,
}

impl Places {
    /// Finds a place for each map, in rows of maps from the tallest to the lowest. There is an entry for each of
    /// `volumes` volumes.
    pub fn new(wanted: &[Wanted], volumes: usize) -> Self {
        let all_rays = |factor: f64| {
            wanted.iter().map(|map| map.rays(factor)[1].element_product()).sum::<f64>()
        };
        let mut factor = 1.0;
        // Each map needs at least 2×2 rays, however far apart.
        while all_rays(factor) > MAX_RAYS && factor < 1e6 {
            factor *= std::f64::consts::SQRT_2;
        }
        let mut sized: Vec<_> =
            wanted.iter().map(|map| (map, map.rays(factor)[1].as_uvec2())).collect();
        sized.sort_by_key(|(_, rays)| std::cmp::Reverse(rays.y));
        let area: u32 = sized.iter().map(|(_, rays)| rays.element_product()).sum();
        let widest = sized.iter().map(|(_, rays)| rays.x).max().unwrap_or_default();
        let width = widest.max(area.isqrt()).next_multiple_of(GROWTH);
        let mut maps = vec![types::OpacityMap::default(); volumes];
        let (mut at, mut next_row) = (UVec2::ZERO, 0);
        for (map, rays) in sized {
            if at.x + rays.x > width {
                at = UVec2::new(0, next_row);
            }
            next_row = next_row.max(at.y + rays.y);
            let own = |volume, origin: DVec3, scale: DVec3| {
                let [first, _] = map.rays(factor);
                let [t_first, t_last] = map.depths.map(|t| (origin.z + scale.z * t) as f32);
                let map = types::OpacityMap {
                    origin: at.to_array(),
                    size: rays.to_array(),
                    first_texel: (origin.xy() + scale.xy() * first).as_vec2().to_array(),
                    spacing: (scale.xy() * map.spacing(factor)).as_vec2().to_array(),
                    t_first,
                    t_last,
                };
                (volume, map)
            };
            let readers = map.readers.iter();
            let all = readers.map(|reader| own(reader.volume, reader.origin, reader.scale));
            for (volume, own) in all.chain([own(map.volume, DVec3::ZERO, DVec3::ONE)]) {
                maps[volume] = own;
            }
            at.x += rays.x;
        }
        Self { maps, size: UVec2::new(width, next_row.next_multiple_of(GROWTH)) }
    }
}

/// The texture of all maps.
pub(super) struct OpacityTexture {
    pub texture: CachedTexture,
    pub view: TextureView,
}

impl OpacityTexture {
    pub fn new(size: UVec2, textures: &mut TextureCache, device: &RenderDevice) -> Self {
        let texture = textures.get(
            device,
            TextureDescriptor {
                label: Some("vdb_opacity"),
                size: Extent3d { width: size.x, height: size.y, depth_or_array_layers: LAYERS },
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format: FORMAT,
                usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
        );
        let view = texture.texture.create_view(&TextureViewDescriptor {
            dimension: Some(TextureViewDimension::D2Array),
            ..default()
        });
        Self { texture, view }
    }
}

#[cfg(test)]
mod tests {
    use vdb_core::synth::Random;

    use super::*;

    fn wanted(volume: usize, low: DVec2, high: DVec2, voxel: f64) -> Wanted {
        Wanted {
            volume,
            low,
            high,
            voxel: DVec2::splat(voxel),
            least: DVec2::splat(LEAST_SPACING),
            depths: [1.0, 2.0],
            readers: Vec::new(),
        }
    }

    /// Maps are apart, within the texture, and cover what they have to.
    #[test]
    fn maps_have_places_of_their_own() {
        let mut random = Random::new(7);
        for maps in [1, 2, 30, 400] {
            let wanted: Vec<_> = (0..maps)
                .map(|i| {
                    let low = DVec2::new(random.unit(), random.unit()) * 1000.0 - 300.0;
                    let extent = DVec2::new(random.unit(), random.unit()) * 2000.0 + 1.0;
                    wanted(i, low, low + extent, random.unit() * 20.0)
                })
                .collect();
            let places = Places::new(&wanted, maps);
            assert!(places.size.max_element() <= 8192, "{}", places.size);
            let rays: u32 = places.maps.iter().map(|map| map.size[0] * map.size[1]).sum();
            assert!(f64::from(rays) <= MAX_RAYS, "{rays}");
            assert!(places.size.element_product() < 3 * rays + 2 * 64 * 64 * 64, "{places:?}");
            for (i, (own, map)) in wanted.iter().zip(&places.maps).enumerate() {
                let [origin, size] = [map.origin, map.size].map(UVec2::from);
                assert!((origin + size).cmple(places.size).all(), "{map:?}");
                let [first, spacing] = [map.first_texel, map.spacing].map(Vec2::from);
                let last = first + spacing * (size.as_vec2() - 1.0);
                assert!(first.as_dvec2().cmple(own.low + 1e-3).all(), "{own:?} {map:?}");
                assert!(last.as_dvec2().cmpge(own.high - 1e-2).all(), "{own:?} {map:?}");
                for other in &places.maps[..i] {
                    let [start, extent] = [other.origin, other.size].map(UVec2::from);
                    let is_apart = (origin + size).cmple(start) | (start + extent).cmple(origin);
                    assert!(is_apart.any(), "{map:?} {other:?}");
                }
            }
        }
    }

    #[test]
    fn there_is_a_ray_for_each_voxel_as_far_as_memory_allows() {
        let side = DVec2::splat(2048.0);
        let places = |voxel| Places::new(&[wanted(0, DVec2::ZERO, side, voxel)], 1).maps[0];
        assert_eq!((places(16.0).spacing, places(16.0).size), ([16.0; 2], [129; 2]));
        // Not more than shadow map filtering would show.
        assert_eq!(places(0.1).spacing, places(4.0).spacing.map(|_| 2.0 * 2.0_f32.sqrt()));
        // However large a voxel, there are two rays along each axis.
        assert_eq!(places(1e9).size, [2; 2]);
        // Another shadow map reads the same rays, in texels half as large and at other depths.
        let mut shared = wanted(1, DVec2::ZERO, side, 16.0);
        let (origin, scale) = (DVec3::new(5.0, 6.0, 7.0), DVec3::new(2.0, 2.0, 1.0));
        shared.readers.push(Reader { volume: 0, origin, scale });
        let [read, filled] = Places::new(&[shared], 2).maps[..] else { panic!("two maps") };
        assert_eq!((filled.first_texel, filled.spacing), ([0.0; 2], [16.0; 2]));
        assert_eq!((read.first_texel, read.spacing), ([5.0, 6.0], [32.0; 2]));
        assert_eq!((read.t_first, read.t_last), (8.0, 9.0));
        assert_eq!((read.origin, read.size), (filled.origin, filled.size));
    }
}
