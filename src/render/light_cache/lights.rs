//! The lights in the light cache.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::ecs::system::SystemParam;
use bevy::math::DVec3;
use bevy::pbr::{ExtractedDirectionalLight, ExtractedPointLight, GlobalClusterableObjectMeta};
use bevy::prelude::*;

use crate::render::extract::ExtractedSuns;
use crate::render::gpu::types;
use crate::render::view::CacheLayout;

/// The lights with shadows, as Bevy has prepared them.
#[derive(SystemParam)]
pub(crate) struct LightQueries<'w, 's> {
    suns: Query<'w, 's, (Entity, &'static ExtractedDirectionalLight)>,
    lamps: Query<'w, 's, (Entity, &'static ExtractedPointLight)>,
    meta: Option<Res<'w, GlobalClusterableObjectMeta>>,
    own_suns: Res<'w, ExtractedSuns>,
}

/// The lights in the cache.
pub(crate) struct CachedLights {
    /// Directions to suns.
    pub suns: Vec<Vec3>,
    /// Their illuminance on volumes, lux.
    pub sun_colors: Vec<Vec3>,
    /// Point and spot lights.
    pub lamps: Vec<Lamp>,
}

/// A point or spot light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lamp {
    pub entity: Entity,
    /// Its index among Bevy's clustered lights.
    pub index: u32,
    pub position: DVec3,
    /// World units.
    pub range: f64,
    /// Luminous intensity, candela.
    pub color: Vec3,
    /// World units.
    pub radius: f32,
    /// For a spot light, the direction in which it shines, and the scale and offset with which the root of its
    /// brightness depends on the cosine, as in Bevy.
    pub cone: Option<(Vec3, f32, f32)>,
    /// A hash of all that decides what light it sends where.
    pub appearance: u64,
}

impl LightQueries<'_, '_> {
    pub fn cached(&self) -> CachedLights {
        let mut suns: Vec<_> =
            self.suns.iter().filter(|(_, light)| light.shadow_maps_enabled).collect();
        suns.sort_unstable_by_key(|(entity, _)| *entity);
        suns.truncate(types::MAX_CACHED_SUNS);
        let direction = |light: &ExtractedDirectionalLight| Vec3::from(light.transform.back());
        let color = |light: &ExtractedDirectionalLight| {
            let own = self.own_suns.0.iter().find(|own| own.direction == direction(light));
            let factor = own.map_or(1.0, |own| own.factor);
            (factor * light.illuminance) * light.color.to_vec3()
        };
        let sun_colors = suns.iter().map(|(_, light)| color(light)).collect();
        let suns = suns.iter().map(|(_, light)| direction(light)).collect();
        let lamp = |(entity, light): (Entity, &ExtractedPointLight)| {
            let index = *self.meta.as_ref()?.entity_to_index.get(&entity)?;
            let position = light.transform.translation().as_dvec3();
            let lamp = Lamp {
                entity,
                index: index as u32,
                position,
                range: light.range.into(),
                color: light.intensity * light.color.to_vec3(),
                radius: light.radius,
                cone: cone(light),
                appearance: appearance(light),
            };
            light.shadow_maps_enabled.then_some(lamp)
        };
        let mut lamps: Vec<_> = self.lamps.iter().filter_map(lamp).collect();
        lamps.sort_unstable_by_key(|lamp| lamp.entity);
        lamps.truncate(types::MAX_CACHED_LAMPS);
        CachedLights { suns, sun_colors, lamps }
    }
}

impl CachedLights {
    pub fn is_empty(&self) -> bool {
        self.suns.is_empty() && self.lamps.is_empty()
    }

    /// The slot of a lamp: its index in [`CachedLights::lamps`].
    pub fn slot_of(&self, lamp: Entity) -> Option<usize> {
        self.lamps.iter().position(|own| own.entity == lamp)
    }
}

fn cone(light: &ExtractedPointLight) -> Option<(Vec3, f32, f32)> {
    let (inner, outer) = light.spot_light_angles?;
    let scale = 1.0 / (inner.cos() - outer.cos()).max(1e-4);
    Some((light.transform.forward().into(), scale, -outer.cos() * scale))
}

fn appearance(light: &ExtractedPointLight) -> u64 {
    let mut hasher = DefaultHasher::new();
    let add = |values: &[f32], hasher: &mut DefaultHasher| {
        values.iter().for_each(|value| value.to_bits().hash(hasher));
    };
    add(&light.color.to_f32_array(), &mut hasher);
    add(&[light.intensity, light.range, light.radius], &mut hasher);
    add(&light.transform.affine().to_cols_array(), &mut hasher);
    if let Some((inner, outer)) = light.spot_light_angles {
        add(&[inner, outer], &mut hasher);
    }
    hasher.finish()
}

impl Lamp {
    /// Whether the lamp lights any part of a box.
    pub fn reaches(&self, [min, max]: [DVec3; 2]) -> bool {
        self.position.distance(self.position.clamp(min, max)) <= self.range
    }

    /// The distance beyond which samples of a fog are never read: points within the range are
    /// interpolated from samples up to a spacing away on each axis.
    pub fn sampled_range(&self, layout: CacheLayout, cell_edge: f64) -> f32 {
        let diagonal = 3_f64.sqrt() * layout.spacing.in_cells() * cell_edge;
        (self.range + diagonal) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_reach_as_far_as_their_range() {
        let lamp = Lamp {
            entity: Entity::PLACEHOLDER,
            index: 0,
            position: DVec3::ZERO,
            range: 2.0,
            color: Vec3::ONE,
            radius: 0.0,
            cone: None,
            appearance: 0,
        };
        let at = |x: f64| [DVec3::new(x, -1.0, -1.0), DVec3::new(x + 1.0, 1.0, 1.0)];
        assert!(lamp.reaches(at(-0.5)) && lamp.reaches(at(2.0)) && lamp.reaches(at(-3.0)));
        assert!(!lamp.reaches(at(2.1)) && !lamp.reaches(at(-3.1)));
        let corner = [DVec3::splat(1.2), DVec3::splat(2.0)];
        assert!(!lamp.reaches(corner), "nearer than the range on each axis, but not in all");
    }
}
