//! The auxiliary grids of a volume: emission and colours.

use std::sync::Arc;

use bevy::math::DAffine3;
use bevy::prelude::*;
use vdb_core::pack::{PackKind, PackedGrid};

use super::warnings::{Setting, Trouble};
use crate::render::gpu::{GridKey, non_negative, types};
use crate::{VdbColorGrid, VdbEmission, VdbGrid, VdbVectorGrid};

/// The auxiliary grids of a volume.
#[derive(Clone, Debug, Default)]
pub(crate) struct AuxiliaryGrids {
    /// The emission: one grid, or one per component of its colour.
    pub emission: Vec<AuxiliaryGrid>,
    /// The colour, as three grids: red, green and blue. Empty without a colour grid.
    pub colors: Vec<AuxiliaryGrid>,
    /// A problem with the emission.
    pub trouble: Option<Trouble>,
}

/// A packed grid of emission, or of a component of a colour.
#[derive(Clone, Debug)]
pub(crate) struct AuxiliaryGrid {
    pub key: GridKey,
    pub packed: Arc<PackedGrid>,
    pub local_from_index: DAffine3,
    pub kind: u32,
    pub emissive: Vec3,
    /// The scale in kelvin per unit, and the offset in kelvin.
    pub temperature: Vec2,
    pub background: f32,
}

/// The components of a vector grid: red, green and blue.
fn components(id: AssetId<VdbVectorGrid>, grid: &VdbVectorGrid, kind: u32) -> Vec<AuxiliaryGrid> {
    let parts = grid.packed().iter().zip([Vec3::X, Vec3::Y, Vec3::Z]).enumerate();
    let part = |(component, (packed, own)): (usize, (&Arc<PackedGrid>, Vec3))| AuxiliaryGrid {
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

impl AuxiliaryGrids {
    /// The auxiliary grids whose assets have been loaded.
    pub fn new(
        (emission, color): (Option<&VdbEmission>, Option<&VdbColorGrid>),
        (grids, vectors): (&Assets<VdbGrid>, &Assets<VdbVectorGrid>),
    ) -> Self {
        let mut auxiliary = Self::default();
        if let Some(emission) = emission {
            auxiliary.trouble = wrong_setting(emission).map(Trouble::Setting);
            auxiliary.add_emission(&emission.nearest_valid(), grids, vectors);
        }
        if let Some(VdbColorGrid(handle)) = color
            && let Some(grid) = vectors.get(handle)
        {
            auxiliary.colors = components(handle.id(), grid, types::KIND_COLOR);
        }
        auxiliary
    }

    /// Of the emission only a share.
    pub fn with_share(mut self, share: f32) -> Self {
        for part in &mut self.emission {
            part.emissive *= share;
        }
        self
    }

    /// Adds the grids of an emission with valid fields.
    fn add_emission(
        &mut self,
        emission: &VdbEmission,
        grids: &Assets<VdbGrid>,
        vectors: &Assets<VdbVectorGrid>,
    ) {
        let (grid, kind, emissive, temperature) = match emission {
            VdbEmission::Temperature { grid, scale, offset, strength } => {
                let temperature = Vec2::new(*scale, *offset);
                (grid, types::KIND_BLACKBODY, Vec3::splat(*strength), temperature)
            }
            VdbEmission::Scalar { grid, color } => {
                (grid, types::KIND_EMISSION, color.to_vec3(), Vec2::ZERO)
            }
            VdbEmission::Color { grid, strength } => {
                if let Some(found) = vectors.get(grid) {
                    self.emission = components(grid.id(), found, types::KIND_EMISSION);
                    for part in &mut self.emission {
                        part.emissive *= *strength;
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
        self.emission.push(AuxiliaryGrid {
            key: grid.id().into(),
            packed: found.outline(),
            local_from_index: found.world_from_index(),
            kind,
            emissive,
            temperature,
            background: 0.0,
        });
    }

    /// All auxiliary grids.
    pub fn all(&self) -> impl Iterator<Item = &AuxiliaryGrid> {
        self.emission.iter().chain(&self.colors)
    }

    /// Whether there is emission.
    pub fn is_emissive(&self) -> bool {
        self.emission.iter().any(|part| part.packed.occupied.is_some())
    }
}

/// The first invalid field.
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
            for emission in [fire(x, x, x), scalar, colors] {
                assert_eq!(wrong_setting(&emission.nearest_valid()), None, "{emission:?}");
            }
        }
        assert_eq!(wrong_setting(&fire(1.0, f32::NAN, 1.0)), Some(Setting::EmissionOffset));
        assert_eq!(fire(1.0, -273.15, 0.5).nearest_valid(), fire(1.0, -273.15, 0.5));
    }
}
