//! Opacity maps: the optical depths of fogs along the rays of lights. There is a ray for each voxel across, so the
//! texels of a shadow map, many of which may show the same voxels, need none of their own.

use bevy::math::{DVec2, DVec3};
use bevy::prelude::*;

use super::casters::Caster;
use crate::render::gpu::{TILE, types};
use crate::render::view::{Eye, Shown, TileRange};

/// The most rays of all maps together, which limits their memory: each takes 72 bytes. If voxels are so small that
/// more would be needed, the rays of the largest maps are farther apart.
pub(super) const MAX_RAYS: f64 = (1 << 20) as f64;

/// The least distance between rays, in texels of the shadow map: shadow map filtering hides anything finer.
pub(super) const LEAST_SPACING: f64 = 2.0;

/// The most rays along each axis of a map. With [`MAX_RAYS`], this keeps the texture within WebGPU's limits.
const MAX_EDGE: f64 = 2048.0;

/// The least width and height of the texture.
const LEAST_EDGE: u32 = 64;

/// The map of one fog as one light sees it, before it has a place in the texture.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Wanted {
    /// The index of the volume by whose rays it is filled. Distances are in the texels of that view.
    pub volume: usize,
    /// The corners of what it has to cover.
    pub low: DVec2,
    pub high: DVec2,
    /// A point that stays where it is in the fog. Rays keep their distance from it when the corners move.
    pub anchor: DVec2,
    /// The distance between rays, as long as there are not too many: a voxel, or the least that is useful.
    pub spacing: DVec2,
    /// The depths of the fog's box, as far as the light reaches.
    pub depths: [f64; 2],
    pub readers: Vec<Reader>,
    /// Identifies what the fog consists of: see [`Caster::content`](super::casters::Caster::content).
    pub content: u64,
}

/// A volume in a shadow map that reads an opacity map filled by another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reader {
    pub volume: usize,
    /// The texel and the depth in the shadow map to which those of the other view correspond: `origin + scale · (x, y, t)`.
    pub origin: DVec3,
    pub scale: DVec3,
}

impl Wanted {
    /// A map for the texels of a shadow map that may show a fog, which is filled by the rays of that shadow map;
    /// `None` if the light does not reach it.
    pub fn new(
        volume: usize,
        caster: &Caster,
        (eye, light_range): (Eye, f64),
        range: TileRange,
    ) -> Option<Self> {
        let shown = &caster.shown;
        let [near, far] = eye.depths(shown.world_from_index(), shown.index_box()?);
        (near < light_range).then(|| Self {
            volume,
            low: (range.first * TILE).as_dvec2(),
            high: ((range.last + 1) * TILE).as_dvec2(),
            anchor: DVec2::ZERO,
            // Voxels cover the fewest texels where they are farthest.
            spacing: (voxel_edge(shown) / eye.pixel_edges(far)).max(DVec2::splat(LEAST_SPACING)),
            depths: [near, far.min(light_range)],
            readers: Vec::new(),
            content: caster.content,
        })
    }

    /// The distance between rays.
    fn spacing(&self, factor: f64) -> DVec2 {
        (factor * self.spacing).min(self.high - self.low)
    }

    /// The first ray, and the number of rays along each axis.
    fn rays(&self, factor: f64) -> [DVec2; 2] {
        let spacing = self.spacing(factor);
        let first = self.anchor + ((self.low - self.anchor) / spacing).floor() * spacing;
        [first, ((self.high - first) / spacing).ceil() + 1.0]
    }

    /// The smallest factor, in steps of √2 so that rays rarely move, that keeps the number of rays within
    /// `most_rays`, and within [`MAX_EDGE`] on each axis.
    fn factor(&self, most_rays: f64) -> f64 {
        let mut factor = 1.0;
        while !self.fits(factor, most_rays) && factor < 1e6 {
            factor *= std::f64::consts::SQRT_2;
        }
        factor
    }

    /// Whether a map has at most this many rays, and at most [`MAX_EDGE`] on each axis.
    pub fn fits(&self, factor: f64, most_rays: f64) -> bool {
        let [_, rays] = self.rays(factor);
        rays.max_element() <= MAX_EDGE && rays.element_product() <= most_rays
    }
}

/// The factor by which the rays of each map are farther apart than they should be. Only the largest maps lose rays.
fn factors(wanted: &[&Wanted]) -> Vec<f64> {
    let mut most_rays = MAX_EDGE * MAX_EDGE;
    loop {
        let factors: Vec<_> = wanted.iter().map(|map| map.factor(most_rays)).collect();
        let rays = wanted.iter().zip(&factors).map(|(map, factor)| map.rays(*factor)[1]);
        // However many maps there are, each has a few rays.
        if rays.map(DVec2::element_product).sum::<f64>() <= MAX_RAYS || most_rays <= 16.0 {
            return factors;
        }
        most_rays *= 0.5;
    }
}

/// A power of two or ¾ of one, so that the texture is rarely reallocated.
fn rounded(edge: u32) -> u32 {
    let power = edge.next_power_of_two();
    if edge <= power / 4 * 3 { power / 4 * 3 } else { power }.max(LEAST_EDGE)
}

/// The room for a map along an axis: a little more than it needs, so that the maps of fogs that change their size do
/// not displace those of others in every frame.
fn room(rays: u32) -> u32 {
    rays.next_multiple_of((rays.next_power_of_two() / 16).max(1))
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
        let has_extent = |map: &&Wanted| map.high.cmpgt(map.low).all();
        let wanted: Vec<_> = wanted.iter().filter(has_extent).collect();
        let factors = factors(&wanted).into_iter();
        let mut sized: Vec<_> = wanted
            .into_iter()
            .zip(factors)
            .map(|(map, factor)| (map, factor, map.rays(factor)[1].as_uvec2()))
            .map(|(map, factor, rays)| (map, factor, rays, UVec2::new(room(rays.x), room(rays.y))))
            .collect();
        sized.sort_by_key(|(.., room)| std::cmp::Reverse(room.y));
        let area: u32 = sized.iter().map(|(.., room)| room.element_product()).sum();
        let widest = sized.iter().map(|(.., room)| room.x).max().unwrap_or_default();
        let width = rounded(widest.max(area.isqrt()));
        let mut maps = vec![types::OpacityMap::default(); volumes];
        let (mut at, mut next_row) = (UVec2::ZERO, 0);
        for (map, factor, rays, room) in sized {
            if at.x + room.x > width {
                at = UVec2::new(0, next_row);
            }
            next_row = next_row.max(at.y + room.y);
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
            at.x += room.x;
        }
        Self { maps, size: UVec2::new(width, rounded(next_row)) }
    }
}

#[cfg(test)]
mod tests {
    use vdb_core::synth::Random;

    use super::*;

    fn wanted_map(volume: usize, low: DVec2, high: DVec2, voxel: f64) -> Wanted {
        Wanted {
            volume,
            low,
            high,
            anchor: DVec2::new(5.3, -2.1),
            spacing: DVec2::splat(voxel.max(LEAST_SPACING)),
            depths: [1.0, 2.0],
            readers: Vec::new(),
            content: 0,
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
                    wanted_map(i, low, low + extent, random.unit() * 20.0)
                })
                .collect();
            let places = Places::new(&wanted, maps);
            assert!(places.size.max_element() <= 8192, "{}", places.size);
            let rays: u32 = places.maps.iter().map(|map| map.size[0] * map.size[1]).sum();
            assert!(f64::from(rays) <= MAX_RAYS, "{rays}");
            assert!(places.size.element_product() < 4 * rays + 64 * 64, "{}, {rays}", places.size);
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
        let at_zero = |volume, voxel| Wanted {
            anchor: DVec2::ZERO,
            ..wanted_map(volume, DVec2::ZERO, side, voxel)
        };
        let places = |voxel| Places::new(&[at_zero(0, voxel)], 1).maps[0];
        assert_eq!((places(16.0).spacing, places(16.0).size), ([16.0; 2], [129; 2]));
        // Not more than shadow map filtering would show.
        assert_eq!(places(0.1).spacing, [2.0 * 2.0_f32.sqrt(); 2]);
        // However large a voxel, there are two rays along each axis.
        assert_eq!(places(1e9).size, [2; 2]);
        // Large maps leave small ones what they want.
        let small = wanted_map(4, DVec2::ZERO, side / 64.0, 2.0);
        let all: Vec<_> = (0..4).map(|i| at_zero(i, 1.0)).chain([small]).collect();
        let maps = Places::new(&all, 5).maps;
        assert_eq!(maps[4].spacing, [2.0; 2]);
        assert!(maps[0].spacing[0] > 4.0, "{:?}", maps[0]);
        // What a light does not show needs no place.
        let empty = wanted_map(0, side, side, 1.0);
        assert_eq!(Places::new(&[empty], 1).maps[0].size, [0; 2]);
        // Another shadow map reads the same rays, in texels half as large and at other depths.
        let mut shared = at_zero(1, 16.0);
        let (origin, scale) = (DVec3::new(5.0, 6.0, 7.0), DVec3::new(2.0, 2.0, 1.0));
        shared.readers.push(Reader { volume: 0, origin, scale });
        let aside = Wanted { low: DVec2::new(32.0, 48.0), ..shared.clone() };
        assert_eq!(Places::new(&[aside], 2).maps[0].first_texel, [69.0, 102.0]);
        let [read, filled] = Places::new(&[shared], 2).maps[..] else { panic!("two maps") };
        assert_eq!((filled.first_texel, filled.spacing), ([0.0; 2], [16.0; 2]));
        assert_eq!((read.first_texel, read.spacing), ([5.0, 6.0], [32.0; 2]));
        assert_eq!((read.t_first, read.t_last), (8.0, 9.0));
        assert_eq!((read.origin, read.size), (filled.origin, filled.size));
    }

    /// A map that becomes slightly larger does not displace others, which would have to be filled again.
    #[test]
    fn maps_keep_their_places_while_others_grow() {
        let places = |extent: f64| {
            // The largest comes first, before others in its row.
            let extents = [400.0 + extent, 300.0, 200.0, 100.0];
            let wanted = extents.into_iter().enumerate();
            let wanted =
                wanted.map(|(i, edge)| wanted_map(i, DVec2::ZERO, DVec2::splat(edge), 1.0));
            Places::new(&wanted.collect::<Vec<_>>(), 4)
        };
        let first = places(0.0);
        for extent in [-8.0, -3.0, 3.0] {
            let now = places(extent);
            assert_eq!(now.size, first.size);
            assert_ne!(now.maps[0].size, first.maps[0].size);
            for i in [1, 2, 3] {
                assert_eq!(now.maps[i], first.maps[i], "{i}, {extent}");
            }
        }
    }

    /// While what is shown of a fog moves and grows, its rays stay where they are in it.
    #[test]
    fn rays_stay_where_they_are() {
        let anchor = DVec2::new(0.4, 0.3);
        let mut all = std::collections::BTreeSet::new();
        for i in 0..100 {
            let low = DVec2::splat(f64::from(i) * -7.77);
            let high = DVec2::splat(2080.0 + f64::from(i) * 1.37);
            let map = Places::new(&[Wanted { anchor, ..wanted_map(0, low, high, 3.0) }], 1).maps[0];
            let steps = (Vec2::from(map.first_texel) - anchor.as_vec2()) / Vec2::from(map.spacing);
            assert!((steps - steps.round()).abs().max_element() < 1e-3, "{map:?}");
            all.insert(map.spacing[0].to_bits());
        }
        assert_eq!(all.len(), 1, "{all:?}");
    }
}
