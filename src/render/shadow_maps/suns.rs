//! Opacity maps as suns see fogs. Rays of a sun are parallel, so all of its shadow maps, of all cameras, share them.

use bevy::math::{DAffine3, DMat3, DMat4, DVec2, DVec3};
use bevy::prelude::*;
use vdb_core::view::ViewRays;

use super::casters::Caster;
use super::opacity::{LEAST_SPACING, MAX_RAYS, Reader, Wanted, voxel_edge};
use crate::VdbQuality;
use crate::asset::{bounds_of, corners};
use crate::render::gpu::{TILE, types};
use crate::render::view::{Eye, TileRange, volume_data, world_corners};

/// The most rays of a map that covers a whole fog, whatever cameras see of it.
const MAX_WHOLE_RAYS: f64 = MAX_RAYS / 4.0;

/// What cameras see of a larger one changes in blocks of this many rays along each axis.
const SHOWN_BLOCK: f64 = 64.0;

/// The fogs in the shadow maps of suns.
#[derive(Default)]
pub(super) struct Suns<'a>(Vec<Sun<'a>>);

struct Sun<'a> {
    light: Entity,
    /// The axes of its rays.
    axes: DMat3,
    fogs: Vec<SeenFog<'a>>,
}

struct SeenFog<'a> {
    caster: &'a Caster<'a>,
    seen: Vec<Seen>,
}

/// A fog in a shadow map.
struct Seen {
    /// Its index in the volumes.
    volume: usize,
    range: TileRange,
    rays: ViewRays,
    world_from_view: DAffine3,
    size: UVec2,
}

impl<'a> Suns<'a> {
    /// Adds a fog in one of a sun's shadow maps.
    pub fn add(
        &mut self,
        light: Entity,
        (caster, volume): (&'a Caster<'a>, usize),
        (eye, range): (Eye, TileRange),
    ) {
        let index = self.0.iter().position(|sun| sun.light == light).unwrap_or_else(|| {
            let axes = eye.world_from_view.matrix3;
            let axes = DMat3::from_cols_array_2d(
                &[axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis.normalize().to_array()),
            );
            self.0.push(Sun { light, axes, fogs: Vec::new() });
            self.0.len() - 1
        });
        let fogs = &mut self.0[index].fogs;
        let seen = Seen {
            volume,
            range,
            rays: *eye.rays,
            world_from_view: eye.world_from_view,
            size: eye.size,
        };
        match fogs.iter_mut().find(|fog| fog.caster.entity == caster.entity) {
            Some(fog) => fog.seen.push(seen),
            None => fogs.push(SeenFog { caster, seen: vec![seen] }),
        }
    }

    /// The view of each sun, by whose rays opacity maps are filled.
    pub fn views(&self) -> impl Iterator<Item = SunView> {
        self.0.iter().filter_map(Sun::view)
    }
}

/// A view from a sun, which shows all fogs that its shadow maps show.
pub(super) struct SunView {
    pub rays: ViewRays,
    pub world_from_view: DAffine3,
    pub size: UVec2,
    /// Each fog, and the opacity map for it, whose volume is an index relative to the view's first.
    pub fogs: Vec<(types::Volume, Wanted)>,
}

impl Sun<'_> {
    fn view(&self) -> Option<SunView> {
        let corners = self.fogs.iter().flat_map(|fog| world_corners(fog.caster.volume));
        let origin = origin(bounds_of(corners.map(|at| self.axes.transpose() * at)))?;
        let world_from_view = DAffine3::from_mat3_translation(self.axes, self.axes * origin);
        // Texels are world units.
        let clip_from_view = DMat4::orthographic_rh(-1.0, 1.0, -1.0, 1.0, 1.0, 0.0);
        let size = UVec2::splat(2);
        let mut rays = ViewRays::new(clip_from_view)?;
        rays.t_near = 0.0;
        let eye = Eye { rays: &rays, world_from_view, size };
        let mut fogs = Vec::new();
        for fog in &self.fogs {
            let shown = &fog.caster.shown;
            let data = volume_data(fog.caster.entity, shown, eye, &VdbQuality::default(), None);
            let wanted = fog.wanted(fogs.len(), eye);
            fogs.extend(data.zip(wanted));
        }
        (!fogs.is_empty()).then_some(SunView { rays, world_from_view, size, fogs })
    }
}

/// The origin of a view from a sun, whose rays begin in front of a box; both in the axes of the rays. It is not far from
/// the box, because rays are in 32-bit floats, and rounded so coarsely that it rarely moves when the box does.
fn origin((low, high): (DVec3, DVec3)) -> Option<DVec3> {
    let unit = (high - low).max_element().log2().ceil().exp2();
    let origin = (low.xy() / unit).floor().extend((high.z / unit).ceil()) * unit;
    origin.is_finite().then_some(origin)
}

impl SeenFog<'_> {
    /// The map of the fog, for a view from the sun in which its volume has this index.
    fn wanted(&self, volume: usize, eye: Eye) -> Option<Wanted> {
        let shown = &self.caster.shown;
        let (bounds, world) = (shown.index_box()?, shown.world_from_index());
        let readers: Vec<_> = self.seen.iter().map(|seen| seen.reader(eye)).collect();
        let voxel = voxel_edge(shown);
        let least = readers.iter().map(|reader| LEAST_SPACING / reader.scale.xy().abs());
        let least = least.map(DVec2::min_element).fold(f64::INFINITY, f64::min);
        let (low, high) =
            bounds_of(corners(bounds).map(|at| place(eye, world.transform_point3(at))));
        let mut wanted = Wanted {
            volume,
            // One voxel beyond the box, where the fog stops no light.
            low: low.xy() - voxel,
            high: high.xy() + voxel,
            anchor: place(eye, world.translation).xy(),
            spacing: DVec2::splat(voxel * in_steps_of_root_two(least / voxel)),
            depths: eye.depths(world, bounds),
            readers,
            content: self.caster.content,
        };
        if !wanted.fits(1.0, MAX_WHOLE_RAYS) {
            let shown = wanted.readers.iter().zip(&self.seen).flat_map(|(reader, seen)| {
                let texels = [seen.range.first, seen.range.last + 1].map(|tile| tile * TILE);
                let texels = texels.map(|texel| texel.as_dvec2().extend(0.0));
                texels.map(|texel| (texel - reader.origin) / reader.scale)
            });
            let (low, high) = bounds_of(shown);
            let (anchor, block) = (wanted.anchor, SHOWN_BLOCK * wanted.spacing);
            let low = anchor + ((low.xy() - anchor) / block).floor() * block;
            let high = anchor + ((high.xy() - anchor) / block).ceil() * block;
            wanted.low = wanted.low.max(low);
            wanted.high = wanted.high.min(high);
        }
        Some(wanted)
    }
}

/// The largest power of √2 that is not more than a factor, and at least 1. Rays therefore stay where they are when the
/// factor changes by rounding.
fn in_steps_of_root_two(factor: f64) -> f64 {
    (0.5 * (2.0 * factor.max(1.0).log2() + 1e-6).floor()).exp2()
}

impl Seen {
    /// How places in another view of the same sun are places in this shadow map.
    fn reader(&self, other: Eye) -> Reader {
        let eye = Eye { rays: &self.rays, world_from_view: self.world_from_view, size: self.size };
        let at = |x, y, t| {
            let rays = other.rays;
            let in_view = rays.eye + (x - 1.0) * rays.eye_x + (1.0 - y) * rays.eye_y + t * rays.dir;
            place(eye, other.world_from_view.transform_point3(in_view))
        };
        let origin = at(0.0, 0.0, 0.0);
        Reader { volume: self.volume, origin, scale: at(1.0, 1.0, 1.0) - origin }
    }
}

/// The pixel and the depth at which a view with parallel rays shows a point.
fn place(eye: Eye, world: DVec3) -> DVec3 {
    let rays = eye.rays;
    let at = eye.world_from_view.inverse().transform_point3(world) - rays.eye;
    let ndc = DVec2::new(at.x / rays.eye_x.x, at.y / rays.eye_y.y);
    ((0.5 + 0.5 * ndc * DVec2::new(1.0, -1.0)) * eye.size.as_dvec2()).extend(-at.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_origin_is_near_the_fogs_and_rarely_moves() {
        let size = DVec3::new(3.0, 5.0, 2.0);
        let mut all = std::collections::BTreeSet::new();
        for i in 0..1000 {
            let low = DVec3::new(100.0, -20.0, 7.0) + f64::from(i) * DVec3::new(0.01, 0.003, -0.01);
            let at = origin((low, low + size)).unwrap();
            let from = low - at;
            assert!(from.xy().cmpge(DVec2::ZERO).all() && from.z + size.z <= 0.0, "{low} {at}");
            assert!(from.abs().max_element() <= 16.0, "{low} {at}");
            all.insert(at.to_array().map(f64::to_bits));
        }
        assert!(all.len() <= 6, "{}", all.len());
        // Nothing has an extent, or there is nothing.
        assert_eq!(origin((size, size)), None);
        assert_eq!(origin(bounds_of([].into_iter())), None);
    }

    #[test]
    fn distances_of_rays_are_in_steps_of_root_two() {
        for (factor, steps) in
            [(0.3, 1.0), (1.4, 1.0), (1.5, 2.0_f64.sqrt()), (7.9, 32.0_f64.sqrt())]
        {
            assert!((in_steps_of_root_two(factor) - steps).abs() < 1e-12, "{factor}");
        }
        // Whichever way it is rounded.
        for rounding in [-1e-9, 0.0, 1e-9] {
            assert_eq!(in_steps_of_root_two(2.0 + rounding), 2.0);
        }
        assert_eq!(in_steps_of_root_two(f64::INFINITY), f64::INFINITY);
    }
}
