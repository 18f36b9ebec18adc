//! Hashes of Bevy's lights and meshes by value: floats by their bits, assets by their ids.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::light::{IrradianceVolume, ParallaxCorrection};
use bevy::mesh::morph::MeshMorphWeights;
use bevy::pbr::{DistanceFog, FogFalloff};
use bevy::prelude::*;

/// A value that may consist of floats.
pub(super) trait HashValue {
    fn add_to(&self, hasher: &mut DefaultHasher);
}

/// The hash of a value.
pub(super) fn hash_of(value: &impl HashValue) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.add_to(&mut hasher);
    hasher.finish()
}

macro_rules! hash_as_is {
    ($($Type:ty),*) => {$(
        impl HashValue for $Type {
            fn add_to(&self, hasher: &mut DefaultHasher) {
                self.hash(hasher);
            }
        }
    )*};
}

/// Hashes all named fields. Structs are destructured completely, so that a new field of Bevy's does
/// not compile, except those with `..`.
macro_rules! hash_fields {
    ($($Struct:ident { $($field:ident),* $(; $rest:tt)? })*) => {$(
        impl HashValue for $Struct {
            fn add_to(&self, hasher: &mut DefaultHasher) {
                let Self { $($field,)* $($rest)? } = self;
                $($field.add_to(hasher);)*
            }
        }
    )*};
}

hash_as_is!(bool, Entity);

// Lights have a further field with Bevy's feature `experimental_pbr_pcss`, which any crate of an app
// may enable. It makes shadows on meshes softer; volumes do not have it.
hash_fields! {
    DirectionalLight {
        color, illuminance, shadow_maps_enabled, contact_shadows_enabled,
        affects_lightmapped_mesh_diffuse, shadow_depth_bias, shadow_normal_bias; ..
    }
    PointLight {
        color, intensity, range, radius, shadow_maps_enabled, contact_shadows_enabled,
        affects_lightmapped_mesh_diffuse, shadow_depth_bias, shadow_normal_bias,
        shadow_map_near_z; ..
    }
    SpotLight {
        color, intensity, range, radius, shadow_maps_enabled, contact_shadows_enabled,
        affects_lightmapped_mesh_diffuse, shadow_depth_bias, shadow_normal_bias, shadow_map_near_z,
        outer_angle, inner_angle; ..
    }
    RectLight { color, intensity, range, width, height }
    EnvironmentMapLight {
        diffuse_map, specular_map, intensity, rotation, affects_lightmapped_mesh_diffuse
    }
    IrradianceVolume { voxels, intensity, affects_lightmapped_meshes }
    LightProbe { falloff }
    AmbientLight { color, brightness, affects_lightmapped_meshes }
    GlobalAmbientLight { color, brightness, affects_lightmapped_meshes }
    DistanceFog { color, directional_light_color, directional_light_exponent, falloff }
}

impl HashValue for f32 {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.to_bits().hash(hasher);
    }
}

/// The colour that Bevy sends to the GPU.
impl HashValue for Color {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.to_linear().to_f32_array().map(f32::to_bits).hash(hasher);
    }
}

impl HashValue for Vec3 {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.to_array().map(f32::to_bits).hash(hasher);
    }
}

impl HashValue for Quat {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.to_array().map(f32::to_bits).hash(hasher);
    }
}

impl HashValue for GlobalTransform {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.affine().to_cols_array().map(f32::to_bits).hash(hasher);
    }
}

impl HashValue for InheritedVisibility {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.get().hash(hasher);
    }
}

impl<A: Asset> HashValue for Handle<A> {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.id().hash(hasher);
    }
}

impl HashValue for Mesh3d {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        let Self(mesh) = self;
        mesh.add_to(hasher);
    }
}

impl HashValue for MeshMorphWeights {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        std::mem::discriminant(self).hash(hasher);
        match self {
            Self::Value { weights } => weights.add_to(hasher),
            Self::Reference(entity) => entity.add_to(hasher),
        }
    }
}

impl HashValue for FogFalloff {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        std::mem::discriminant(self).hash(hasher);
        match self {
            Self::Linear { start, end } => (start, end).add_to(hasher),
            Self::Exponential { density } | Self::ExponentialSquared { density } => {
                density.add_to(hasher);
            }
            Self::Atmospheric { extinction, inscattering } => {
                (extinction, inscattering).add_to(hasher);
            }
        }
    }
}

impl HashValue for ParallaxCorrection {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        std::mem::discriminant(self).hash(hasher);
        match self {
            Self::None | Self::Auto => {}
            Self::Custom(bounds) => bounds.add_to(hasher),
        }
    }
}

impl<T: HashValue> HashValue for &T {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        T::add_to(self, hasher);
    }
}

impl<T: HashValue> HashValue for Option<T> {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.is_some().hash(hasher);
        self.iter().for_each(|value| value.add_to(hasher));
    }
}

impl<T: HashValue> HashValue for Vec<T> {
    fn add_to(&self, hasher: &mut DefaultHasher) {
        self.len().hash(hasher);
        self.iter().for_each(|value| value.add_to(hasher));
    }
}

macro_rules! hash_tuples {
    ($(($($Part:ident)*))*) => {$(
        impl<$($Part: HashValue),*> HashValue for ($($Part,)*) {
            fn add_to(&self, hasher: &mut DefaultHasher) {
                #[allow(non_snake_case)]
                let ($($Part,)*) = self;
                $($Part.add_to(hasher);)*
            }
        }
    )*};
}
hash_tuples! { (A B) (A B C) (A B C D) }

#[cfg(test)]
mod tests {
    use bevy::asset::uuid_handle;
    use bevy::reflect::PartialReflect;
    use bevy::reflect::structs::Struct;

    use super::*;

    /// Changes a value of one of the types that fields have.
    fn change(field: &mut dyn PartialReflect) {
        if let Some(number) = field.try_downcast_mut::<f32>() {
            // The next float.
            *number = f32::from_bits(number.to_bits() + 1);
        } else if let Some(flag) = field.try_downcast_mut::<bool>() {
            *flag = !*flag;
        } else if let Some(color) = field.try_downcast_mut::<Color>() {
            *color = Color::srgb(0.1, 0.2, 0.3);
        } else if let Some(image) = field.try_downcast_mut::<Handle<Image>>() {
            *image = uuid_handle!("6b1c8f62-9b53-4b1c-8b0f-4d3a1f6f2a01");
        } else if let Some(rotation) = field.try_downcast_mut::<Quat>() {
            *rotation = Quat::from_rotation_y(0.5);
        } else if let Some(falloff) = field.try_downcast_mut::<Vec3>() {
            *falloff = Vec3::new(0.0, 0.5, 0.0);
        } else if let Some(falloff) = field.try_downcast_mut::<FogFalloff>() {
            *falloff = FogFalloff::Exponential { density: 0.25 };
        } else {
            panic!("a field of type {}", field.reflect_type_path());
        }
    }

    /// Changes each field that Bevy reports for a type, whatever `hash_fields` lists.
    fn each_field_counts<T: HashValue + Struct + Clone>(value: &T) {
        for i in 0..value.field_len() {
            let name = value.name_at(i).unwrap();
            // Of the feature `experimental_pbr_pcss`.
            if name.starts_with("soft_shadow") {
                continue;
            }
            let mut changed = value.clone();
            change(changed.field_at_mut(i).unwrap());
            let path = value.reflect_type_path();
            assert_ne!(hash_of(value), hash_of(&changed), "{path}::{name} does not count");
        }
        assert_eq!(hash_of(value), hash_of(&value.clone()));
    }

    #[test]
    fn each_field_of_lights_and_fog_counts() {
        each_field_counts(&DirectionalLight::default());
        each_field_counts(&PointLight::default());
        each_field_counts(&SpotLight::default());
        each_field_counts(&RectLight::default());
        each_field_counts(&EnvironmentMapLight::default());
        each_field_counts(&LightProbe::default());
        each_field_counts(&IrradianceVolume::default());
        each_field_counts(&AmbientLight::default());
        each_field_counts(&GlobalAmbientLight::default());
        each_field_counts(&DistanceFog::default());
    }

    fn all_differ<T: HashValue>(values: &[T]) {
        let hashes: Vec<_> = values.iter().map(hash_of).collect();
        for (i, hash) in hashes.iter().enumerate() {
            assert!(!hashes[..i].contains(hash), "the value at {i} counts as one before it");
        }
    }

    #[test]
    fn variants_and_their_fields_count() {
        let atmospheric =
            |extinction, inscattering| FogFalloff::Atmospheric { extinction, inscattering };
        let mut falloffs = vec![
            FogFalloff::Linear { start: 0.0, end: 1.0 },
            FogFalloff::Linear { start: 0.5, end: 1.0 },
            FogFalloff::Linear { start: 0.0, end: 1.5 },
            FogFalloff::Exponential { density: 1.0 },
            FogFalloff::Exponential { density: 1.5 },
            FogFalloff::ExponentialSquared { density: 1.0 },
            atmospheric(Vec3::ZERO, Vec3::ZERO),
        ];
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            falloffs.extend([atmospheric(axis, Vec3::ZERO), atmospheric(Vec3::ZERO, axis)]);
        }
        all_differ(&falloffs);
        all_differ(&[
            ParallaxCorrection::None,
            ParallaxCorrection::Auto,
            ParallaxCorrection::Custom(Vec3::ONE),
            ParallaxCorrection::Custom(Vec3::X),
        ]);
        let weights = |weights: &[f32]| MeshMorphWeights::Value { weights: weights.to_vec() };
        let mut world = World::new();
        let [one, two] = [(); 2].map(|()| world.spawn_empty().id());
        all_differ(&[
            weights(&[]),
            weights(&[0.0]),
            weights(&[0.0, 0.0]),
            weights(&[0.0, 1.0]),
            MeshMorphWeights::Reference(one),
            MeshMorphWeights::Reference(two),
        ]);
    }

    #[test]
    fn places_count() {
        let matrices = (0..12).map(|i| {
            let mut matrix = Mat4::IDENTITY;
            matrix.col_mut(i / 3)[i % 3] += 0.25;
            GlobalTransform::from(matrix)
        });
        all_differ(&matrices.chain([GlobalTransform::IDENTITY]).collect::<Vec<_>>());
        all_differ(&[InheritedVisibility::VISIBLE, InheritedVisibility::HIDDEN]);
        let other = uuid_handle!("6b1c8f62-9b53-4b1c-8b0f-4d3a1f6f2a01");
        all_differ(&[Mesh3d::default(), Mesh3d(other)]);
    }

    #[test]
    fn a_light_of_another_kind_counts() {
        let (sun, lamp) = (DirectionalLight::default(), PointLight::default());
        assert_ne!(
            hash_of(&(Some(&sun), None::<&PointLight>)),
            hash_of(&(None::<&DirectionalLight>, Some(&lamp)))
        );
        all_differ(&[None, Some(0.0_f32)]);
        all_differ(&[(0.0_f32, 1.0_f32), (1.0, 0.0)]);
    }
}
