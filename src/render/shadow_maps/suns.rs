//! Opacity maps as suns see fogs. Rays of a sun are parallel, so all of its shadow maps, of all cameras, share them.

use bevy::math::{DAffine3, DMat3, DMat4, DVec2, DVec3};
use bevy::prelude::*;
use vdb_core::view::ViewRays;

use super::casters::{Caster, set_back};
use super::opacity::{LEAST_SPACING, Reader, Wanted, voxel_edge};
use crate::VdbQuality;
use crate::asset::corners;
use crate::render::gpu::{TILE, types};
use crate::render::view::{Eye, TileRange, volume_data, world_corners};

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
        let all_corners = || self.fogs.iter().flat_map(|fog| world_corners(fog.caster.volume));
        // Near the fogs, because rays are in 32-bit floats.
        let origin = all_corners().next()?;
        let world_from_view = DAffine3::from_mat3_translation(self.axes, origin);
        // Texels are world units.
        let clip_from_view = DMat4::orthographic_rh(-1.0, 1.0, -1.0, 1.0, 1.0, 0.0);
        let size = UVec2::splat(2);
        let (world_from_view, clip_from_view) =
            set_back((world_from_view, clip_from_view), all_corners());
        let mut rays = ViewRays::new(clip_from_view)?;
        rays.t_near = 0.0;
        let eye = Eye { rays: &rays, world_from_view, size };
        let mut fogs = Vec::new();
        for SeenFog { caster, seen } in &self.fogs {
            let shown = &caster.shown;
            let data = volume_data(caster.entity, shown, eye, &VdbQuality::default(), None);
            let (Some(data), Some(bounds)) = (data, shown.index_box()) else { continue };
            let readers: Vec<_> = seen.iter().map(|seen| seen.reader(eye)).collect();
            let world = shown.world_from_index();
            let places = corners(bounds).map(|at| place(eye, world.transform_point3(at)).xy());
            let (low, high) = bounds_of(places);
            let voxel = DVec2::splat(voxel_edge(shown));
            let shown_range = readers.iter().zip(seen).flat_map(|(reader, seen)| {
                let texels = [seen.range.first, seen.range.last + 1].map(|tile| tile * TILE);
                texels.map(|texel| (texel.as_dvec2() - reader.origin.xy()) / reader.scale.xy())
            });
            let (shown_low, shown_high) = bounds_of(shown_range);
            let least = readers.iter().map(|reader| LEAST_SPACING / reader.scale.xy().abs());
            let wanted = Wanted {
                volume: fogs.len(),
                // One voxel beyond the box, where the fog stops no light, but no farther than what is shown.
                low: (low - voxel).max(shown_low),
                high: (high + voxel).min(shown_high),
                anchor: place(eye, world.translation).xy(),
                voxel,
                least: least.reduce(DVec2::min).unwrap_or(voxel),
                depths: eye.depths(world, bounds),
                readers,
            };
            fogs.push((data, wanted));
        }
        (!fogs.is_empty()).then_some(SunView { rays, world_from_view, size, fogs })
    }
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

fn bounds_of(places: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    places
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
}
