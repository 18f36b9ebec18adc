//! The lights whose scattered light is solved for.

use std::hash::{Hash, Hasher};

use bevy::math::DVec3;
use bevy::prelude::*;
use bytemuck::{Pod, Zeroable};

use super::lattice::CellLattice;
use crate::render::gpu::types::{MAX_CACHED_LAMPS, MAX_CACHED_SUNS};
use crate::render::light_cache::{CachedLights, Lamp};

/// The most lights.
pub(super) const MAX_SOURCES: usize = MAX_CACHED_SUNS + MAX_CACHED_LAMPS;

/// The struct `Light` of `scattered_light/octants.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Source {
    pub position: [f32; 3],
    pub inverse_square_range: f32,
    pub color: [f32; 3],
    pub radius: f32,
    pub axis: [f32; 3],
    pub slot: u32,
    pub cone_scale: f32,
    pub cone_offset: f32,
    pub pads: [u32; 2],
}

/// Lights that reach a lattice.
pub(super) struct Sources<'a> {
    suns: Vec<(usize, Vec3, Vec3)>,
    lamps: Vec<(usize, &'a Lamp)>,
}

impl<'a> Sources<'a> {
    /// The lights with shadows that reach a box in the world.
    pub fn new(lights: &'a CachedLights, bounds: [DVec3; 2]) -> Self {
        let suns = lights.suns.iter().zip(&lights.sun_colors).enumerate();
        let lamps = lights.lamps.iter().enumerate();
        Self {
            suns: suns
                .map(|(slot, (direction, color))| (slot, *direction, *color))
                .filter(|(.., color)| *color != Vec3::ZERO)
                .collect(),
            lamps: lamps.filter(|(_, lamp)| lamp.reaches(bounds)).collect(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.suns.is_empty() && self.lamps.is_empty()
    }

    fn colors(&self) -> impl Iterator<Item = Vec3> {
        self.suns.iter().map(|sun| sun.2).chain(self.lamps.iter().map(|(_, lamp)| lamp.color))
    }

    /// The colour that all lights have, with a mean of 1; `None` if they differ.
    pub fn common_color(&self) -> Option<Vec3> {
        let normal = |color: Vec3| 3.0 * color / color.element_sum().max(1e-30);
        let first = normal(self.colors().next()?);
        self.colors().all(|color| normal(color).abs_diff_eq(first, 1e-4)).then_some(first)
    }

    /// An illuminance that is rarely exceeded in a lattice, so that 16-bit floats hold the light there relative to
    /// it.
    fn brightness(&self, lattice: &CellLattice) -> f32 {
        let middle = lattice.corner + lattice.axes * (0.5 * lattice.edge * lattice.size.as_dvec3());
        // From a lamp inside, light is at most that at the distance of two cells.
        let least = 2.0 * lattice.edge;
        let reach = 0.5 * lattice.edge * lattice.size.as_dvec3().length();
        let suns = self.suns.iter().map(|sun| sun.2.max_element());
        let lamps = self.lamps.iter().map(|(_, lamp)| {
            let distance = (lamp.position.distance(middle) - reach).max(least) as f32;
            lamp.color.max_element() / (distance * distance)
        });
        suns.chain(lamps).fold(0.0_f32, f32::max).clamp(1e-20, 1e20)
    }

    /// The lights relative to an eye, and a scale: each channel of a light is divided by it, so that 16-bit floats
    /// hold the result. If all lights have a `common` colour, all channels are the same.
    pub fn relative(
        &self,
        lattice: &CellLattice,
        eye: DVec3,
        common: Option<Vec3>,
    ) -> (Vec<Source>, Vec3) {
        let brightness = self.brightness(lattice);
        let color = |color: Vec3| match common {
            Some(_) => Vec3::splat(color.element_sum() / 3.0 / brightness),
            None => color / brightness,
        };
        let sun = |(slot, direction, own): &(usize, Vec3, Vec3)| Source {
            position: direction.to_array(),
            inverse_square_range: -1.0,
            color: color(*own).to_array(),
            slot: *slot as u32,
            ..default()
        };
        let lamp = |(slot, lamp): &(usize, &Lamp)| {
            let (axis, cone_scale, cone_offset) = lamp.cone.unwrap_or((Vec3::ZERO, 0.0, 1.0));
            Source {
                position: (lamp.position - eye).as_vec3().to_array(),
                inverse_square_range: (1.0 / (lamp.range * lamp.range)) as f32,
                color: color(lamp.color).to_array(),
                radius: lamp.radius,
                axis: axis.to_array(),
                slot: *slot as u32,
                cone_scale,
                cone_offset,
                ..default()
            }
        };
        let all = self.suns.iter().map(sun).chain(self.lamps.iter().map(lamp));
        (all.collect(), common.unwrap_or(Vec3::ONE) * brightness)
    }

    /// Adds all that decides what light there is.
    pub fn hash(&self, hasher: &mut impl Hasher) {
        for (_, direction, color) in &self.suns {
            let numbers = direction.to_array().into_iter().chain(color.to_array());
            numbers.for_each(|number| number.to_bits().hash(hasher));
        }
        self.lamps.iter().for_each(|(_, lamp)| lamp.appearance.hash(hasher));
    }
}
