//! The further grids of a volume: what shines in it, and what colours it. Each is an entry of its own in
//! the list of volumes, with rays of its own, in f64 on the CPU as those of every volume: so grids of other
//! transforms need no more than those that share one. What shines stands beside the volumes that a view
//! sees, and is walked as they are; colours stand behind all that rays meet, and are only looked up.

use std::sync::Arc;

use bevy::math::{DAffine3, DMat4};
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::view::{CannotShow, GpuRays, LatticeRays, ViewRays};

use super::extract::{ExtractedVolume, non_negative};
use super::gpu_data;
use super::gpu_tree::{GridKey, VdbTreePool};
use super::tiles::TileRange;
use super::volume::affine;
use super::warnings::{Setting, Trouble, Warned};
use crate::{VdbColorGrid, VdbEmission, VdbGrid, VdbVectorGrid};

/// Emission coefficients and their factors, with which no sum along a ray exceeds f32.
const MOST_EMISSION: f32 = 1e15;
/// Kelvin, and kelvin per unit.
const MOST_KELVIN: f32 = 1e9;

/// The grids of a volume besides its own.
#[derive(Clone, Debug, Default)]
pub(super) struct Extras {
    /// What shines: one grid, or one a component of the colour.
    pub emission: Vec<Part>,
    /// The colour of a surface: red, green, blue; or none.
    pub colors: Vec<Part>,
    /// What is wrong with them.
    trouble: Option<Trouble>,
}

/// One packed grid beside a volume's own.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub key: GridKey,
    pub packed: Arc<PackedGrid>,
    pub local_from_index: DAffine3,
    kind: u32,
    emissive: Vec3,
    /// Kelvin per unit, and added.
    temperature: Vec2,
    background: f32,
}

impl Part {
    fn world_from_index(&self, volume: &ExtractedVolume) -> DAffine3 {
        affine(volume.world_from_local) * self.local_from_index
    }

    /// The tiles of a picture of so many pixels that show it.
    pub fn tile_range(
        &self,
        volume: &ExtractedVolume,
        clip_from_world: DMat4,
        size: UVec2,
    ) -> TileRange {
        let Some(occupied) = self.packed.occupied else { return TileRange::NONE };
        let origin = self.packed.base.as_dvec3() + self.packed.kind.lattice_origin();
        let min = origin + occupied.min.as_dvec3();
        let max = origin + occupied.max.as_dvec3() + 1.0;
        let clip_from_index = clip_from_world * DMat4::from(self.world_from_index(volume));
        TileRange::of_box(clip_from_index, min, max, size)
    }
}

/// The parts of one vector grid, red, green and blue.
fn components(id: AssetId<VdbVectorGrid>, grid: &VdbVectorGrid, kind: u32) -> Vec<Part> {
    let parts = grid.packed().iter().zip([Vec3::X, Vec3::Y, Vec3::Z]).enumerate();
    let part = |(component, (packed, own)): (usize, (&Arc<PackedGrid>, Vec3))| Part {
        key: GridKey::component(id, component as u32),
        packed: packed.clone(),
        local_from_index: grid.world_from_index(),
        kind,
        emissive: own,
        temperature: Vec2::ZERO,
        background: non_negative(grid.tree().background()[component]),
    };
    parts.map(part).collect()
}

impl Extras {
    /// What there is of them.
    pub fn new(
        (emission, color): (Option<&VdbEmission>, Option<&VdbColorGrid>),
        (grids, vectors): (&Assets<VdbGrid>, &Assets<VdbVectorGrid>),
        is_surface: bool,
    ) -> Self {
        let mut extras = Self::default();
        if let Some(emission) = emission {
            extras.trouble = wrong_setting(emission).map(Trouble::Setting);
            extras.add_emission(emission, grids, vectors);
        }
        if let Some(VdbColorGrid(handle)) = color
            && let Some(grid) = vectors.get(handle)
            && is_surface
        {
            extras.colors = components(handle.id(), grid, gpu_data::KIND_COLOR);
        }
        extras
    }

    fn add_emission(
        &mut self,
        emission: &VdbEmission,
        grids: &Assets<VdbGrid>,
        vectors: &Assets<VdbVectorGrid>,
    ) {
        let (grid, kind, emissive, temperature) = match emission {
            VdbEmission::Temperature { grid, scale, offset, strength } => {
                let offset = if offset.is_nan() { 0.0 } else { *offset };
                let temperature = Vec2::new(
                    non_negative(*scale).min(MOST_KELVIN),
                    offset.clamp(-MOST_KELVIN, MOST_KELVIN),
                );
                (grid, gpu_data::KIND_BLACKBODY, Vec3::splat(*strength), temperature)
            }
            VdbEmission::Scalar { grid, color } => {
                (grid, gpu_data::KIND_EMISSION, color.to_vec3(), Vec2::ZERO)
            }
            VdbEmission::Color { grid, strength } => {
                if let Some(found) = vectors.get(grid) {
                    self.emission = components(grid.id(), found, gpu_data::KIND_EMISSION);
                    for part in &mut self.emission {
                        part.emissive *= capped(*strength);
                    }
                }
                return;
            }
        };
        let Some(found) = grids.get(grid) else { return };
        if found.kind() != PackKind::Fog {
            self.trouble = Some(Trouble::NoDensity);
            return;
        }
        self.emission.push(Part {
            key: grid.id().into(),
            packed: found.outline(),
            local_from_index: found.world_from_index(),
            kind,
            emissive: emissive.map(capped),
            temperature,
            background: 0.0,
        });
    }

    /// All grids.
    pub fn parts(&self) -> impl Iterator<Item = &Part> {
        self.emission.iter().chain(&self.colors)
    }

    /// Whether anything shines.
    pub fn shines(&self) -> bool {
        self.emission.iter().any(|part| part.packed.occupied.is_some())
    }
}

fn capped(x: f32) -> f32 {
    non_negative(x).min(MOST_EMISSION)
}

/// The first setting that makes no sense.
fn wrong_setting(emission: &VdbEmission) -> Option<Setting> {
    let sound = |x: f32| x >= 0.0 && x.is_finite();
    match emission {
        VdbEmission::Temperature { scale, .. } if !sound(*scale) => Some(Setting::EmissionScale),
        VdbEmission::Temperature { offset, .. } if !offset.is_finite() => {
            Some(Setting::EmissionOffset)
        }
        VdbEmission::Temperature { strength, .. } | VdbEmission::Color { strength, .. } => {
            (!sound(*strength)).then_some(Setting::EmissionStrength)
        }
        VdbEmission::Scalar { color, .. } => {
            let sound = [color.red, color.green, color.blue].into_iter().all(sound);
            (!sound).then_some(Setting::EmissionColor)
        }
    }
}

/// A view, as entries of its list of volumes ask for it.
pub(super) type View<'a> = (&'a ViewRays, DAffine3);

/// The entry of one grid.
fn part_data(
    part: &Part,
    volume: &ExtractedVolume,
    grid: u32,
    (rays, world_from_view): View,
) -> Result<gpu_data::Volume, CannotShow> {
    let world_from_index = part.world_from_index(volume);
    let rays = LatticeRays::new(rays, world_from_view, world_from_index, &part.packed)?;
    let lattice = world_from_index.inverse().matrix3;
    let array = |v: bevy::math::DVec3| v.as_vec3().to_array();
    Ok(gpu_data::Volume {
        rays: GpuRays::from(&rays),
        grid,
        kind: part.kind,
        lattice_x: array(lattice.x_axis),
        lattice_y: array(lattice.y_axis),
        lattice_z: array(lattice.z_axis),
        emissive: part.emissive.to_array(),
        temperature_scale: part.temperature.x,
        temperature_offset: part.temperature.y,
        background: part.background,
        color_grids: gpu_data::NO_COLOR,
        ..default()
    })
}

/// The entries of what shines in a volume; says what is wrong if there is someone to tell.
pub(super) fn emission_data<'a>(
    entity: MainEntity,
    volume: &'a ExtractedVolume,
    pool: &VdbTreePool,
    view: View,
    mut warned: Option<&mut Warned>,
) -> Vec<(gpu_data::Volume, &'a Part)> {
    let mut note = |trouble| {
        if let Some(text) =
            warned.as_deref_mut().and_then(|warned| warned.note(entity, &volume.name, trouble))
        {
            warn!("{text}");
        }
    };
    volume.extras.trouble.into_iter().for_each(&mut note);
    let mut entries = Vec::new();
    for part in volume.extras.emission.iter().filter(|part| part.packed.occupied.is_some()) {
        let Some(grid) = pool.index(part.key) else { continue };
        match part_data(part, volume, grid, view) {
            Ok(data) => entries.push((data, part)),
            Err(why) => note(Trouble::NotShown(why)),
        }
    }
    entries
}

/// The three entries of a volume's colour, where it has one.
pub(super) fn color_data(
    volume: &ExtractedVolume,
    pool: &VdbTreePool,
    view: View,
) -> Option<[gpu_data::Volume; 3]> {
    let entry = |i: usize| {
        let part = volume.extras.colors.get(i)?;
        part_data(part, volume, pool.index(part.key)?, view).ok()
    };
    Some([entry(0)?, entry(1)?, entry(2)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn emission_that_makes_no_sense_is_found() {
        let grid = Handle::<VdbGrid>::default();
        let fire = |scale, offset, strength| VdbEmission::Temperature {
            grid: grid.clone(),
            scale,
            offset,
            strength,
        };
        assert_eq!(wrong_setting(&fire(1.0, -273.15, 0.0)), None);
        for x in [f32::NAN, f32::INFINITY, -1.0] {
            assert_eq!(wrong_setting(&fire(x, 0.0, 1.0)), Some(Setting::EmissionScale));
            assert_eq!(wrong_setting(&fire(1.0, 0.0, x)), Some(Setting::EmissionStrength));
            let color = LinearRgba::rgb(1.0, x, 0.0);
            let scalar = VdbEmission::Scalar { grid: grid.clone(), color };
            assert_eq!(wrong_setting(&scalar), Some(Setting::EmissionColor));
            let colors = VdbEmission::Color { grid: default(), strength: x };
            assert_eq!(wrong_setting(&colors), Some(Setting::EmissionStrength));
            assert!((0.0..=MOST_EMISSION).contains(&capped(x)));
        }
        assert_eq!(wrong_setting(&fire(1.0, f32::NAN, 1.0)), Some(Setting::EmissionOffset));
    }
}
