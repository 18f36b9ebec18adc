//! The features that a view's shaders are specialised on: one table, from which pipeline keys,
//! shader defs, diagnostics and cost measurements are derived.

use bitflags::bitflags;

use crate::{VdbCamera, VdbOverlays, VdbQuality, VdbTraversal};

bitflags! {
    /// The features that a view's shaders are compiled with.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub(crate) struct Features: u64 {
        const VOXELS = 1 << 0;
        const SMOOTH = 1 << 1;
        const FOG = 1 << 2;
        const FOG_STEPS = 1 << 3;
        const EMISSION = 1 << 4;
        const BLACKBODY = 1 << 5;
        const COLORS = 1 << 6;
        const MULTIPLE_SCATTERING = 1 << 7;
        const MANY = 1 << 8;
        const BEAMS = 1 << 9;
        const HDDA = 1 << 10;
        const DDA = 1 << 11;
        const MARCH = 1 << 12;
        const LIGHT = 1 << 13;
        const SHADOWS = 1 << 14;
        const SOFT_SHADOWS = 1 << 15;
        const LAMPS = 1 << 16;
        const ENVIRONMENT = 1 << 17;
        const DISTANCE_FOG = 1 << 18;
        const REFLECTIONS = 1 << 19;
        const MOTION_VECTORS = 1 << 20;
        const OVERLAYS = 1 << 21;
        const SCALED = 1 << 22;
        const ACCUMULATED = 1 << 23;
        const MULTISAMPLED = 1 << 24;
        const PAGES = 1 << 25;
        const WIDE_GRIDS = 1 << 26;
        const LIGHT_CACHE = 1 << 27;
        const CACHED_LAMPS = 1 << 28;
        const UNCACHED_LIGHTS = 1 << 29;
        const OTHER_LIGHTS = 1 << 30;
        const MESH_CASTERS = 1 << 31;
        const UNCACHED_FOGS = 1 << 32;
        const LAMP_LIGHT = 1 << 33;
        const VELOCITIES = 1 << 34;
        const SMOOTH_NORMALS = 1 << 35;
        const EDGES = 1 << 36;
        const FOG_COLORS = 1 << 37;
        const RAMPS = 1 << 38;
        const REFLECTION_PROBES = 1 << 39;
        const IRRADIANCE_VOLUMES = 1 << 40;
        const MATERIALS = 1 << 41;
        const FOG_MATERIALS = 1 << 42;
        const MESH_REFLECTIONS = 1 << 43;
        const DENOISED = 1 << 44;
        const RECT_LIGHTS = 1 << 45;
        const FIRE_LIGHTS = 1 << 46;
        const LEVELS = 1 << 47;
        const CLIPPED = 1 << 48;
        const SCATTERED_LIGHT = 1 << 49;
        const TINTED_FOG = 1 << 50;
        const REFLECTION_HISTORY = 1 << 51;
    }
}

/// A row of the table.
#[derive(Debug)]
pub(crate) struct Feature {
    pub flag: Features,
    /// The shader defs that enable the feature.
    pub defs: &'static [&'static str],
    /// The name in [`VdbFeatureReport`](crate::VdbFeatureReport).
    pub name: &'static str,
    /// The setting or component that requires it.
    pub why: &'static str,
    /// How to draw a camera without it, to measure its cost.
    pub without: Option<Without>,
}

/// How to draw a camera without a feature.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Without {
    /// With other settings.
    Settings(fn(&mut VdbCamera, &mut VdbQuality)),
    /// Without the grids that need it.
    Grids,
}

const fn row(
    flag: Features,
    defs: &'static [&'static str],
    name: &'static str,
    why: &'static str,
) -> Feature {
    Feature { flag, defs, name, why, without: None }
}

impl Feature {
    const fn without(mut self, change: fn(&mut VdbCamera, &mut VdbQuality)) -> Self {
        self.without = Some(Without::Settings(change));
        self
    }

    const fn without_grids(mut self) -> Self {
        self.without = Some(Without::Grids);
        self
    }
}

/// All features, in the order of reports.
pub(crate) const FEATURES: [Feature; 52] = [
    row(Features::VOXELS, &["VDB_SURFACES"], "voxels", "a surface is shown voxel by voxel")
        .without_grids(),
    row(Features::SMOOTH, &["VDB_SMOOTH"], "smooth surfaces", "a surface is shown between samples")
        .without_grids(),
    row(Features::FOG, &["VDB_FOGS"], "fog", "a fog is in view, casts shadows or is reflected")
        .without_grids(),
    row(
        Features::FOG_STEPS,
        &["VDB_FOG_STEPS"],
        "sampled fog",
        "VdbQuality::fog_step is more than 0, and not all fog is lit by the light cache",
    ),
    row(
        Features::EMISSION,
        &["VDB_EMISSION", "VDB_EMITS"],
        "emission",
        "a volume has a VdbEmission",
    )
    .without_grids(),
    row(
        Features::BLACKBODY,
        &["VDB_BLACKBODY"],
        "black bodies",
        "the emission is VdbEmission::Temperature",
    ),
    row(Features::COLORS, &["VDB_COLORS"], "colours", "a surface has a VdbColorGrid"),
    row(
        Features::MULTIPLE_SCATTERING,
        &["VDB_MULTIPLE_SCATTERING"],
        "multiple scattering",
        "VdbCamera::multiple_scattering, and there is a fog",
    )
    .without(|camera, _| camera.multiple_scattering = false),
    row(
        Features::MANY,
        &["VDB_MANY"],
        "bounding volume hierarchy",
        "shadow or reflection rays can meet many volumes",
    ),
    row(
        Features::BEAMS,
        &["VDB_BEAMS"],
        "beam optimisation",
        "VdbTraversal::HddaSkip: the rays of a tile share a start",
    )
    .without(|_, quality| quality.traversal = VdbTraversal::Hdda),
    row(Features::HDDA, &["VDB_HDDA"], "hierarchical DDA", "VdbTraversal::Hdda"),
    row(Features::DDA, &["VDB_DDA"], "DDA", "VdbTraversal::Dda"),
    row(Features::MARCH, &["VDB_MARCH", "VDB_DDA"], "ray marching", "VdbTraversal::March"),
    row(Features::LIGHT, &["VDB_LIT"], "light", "the mode shows light"),
    row(Features::SHADOWS, &["VDB_SHADOWS"], "shadows", "a light has shadow_maps_enabled")
        .without(|_, quality| quality.shadows = false),
    row(
        Features::SOFT_SHADOWS,
        &["VDB_SOFT_SUNS"],
        "soft shadows",
        "VdbSun::angular_diameter is more than 0",
    ),
    row(Features::LAMPS, &["VDB_LOCAL_LIGHTS"], "local lights", "there are point or spot lights"),
    row(
        Features::ENVIRONMENT,
        &["ENVIRONMENT_MAP"],
        "environment map",
        "the camera has an EnvironmentMapLight",
    ),
    row(Features::DISTANCE_FOG, &["DISTANCE_FOG"], "distance fog", "the camera has a DistanceFog"),
    row(
        Features::REFLECTIONS,
        &["VDB_REFLECTIONS"],
        "reflections",
        "VdbQuality::reflections is more than 0",
    )
    .without(|_, quality| quality.reflections = 0),
    row(
        Features::MOTION_VECTORS,
        &["VDB_MOTION_VECTORS"],
        "motion vectors",
        "the camera has a MotionVectorPrepass, which TAA requires",
    ),
    row(Features::OVERLAYS, &["VDB_OVERLAYS"], "overlays", "VdbCamera::overlays")
        .without(|camera, _| camera.overlays = VdbOverlays::default()),
    row(
        Features::SCALED,
        &["VDB_SCALED"],
        "fewer rays than pixels",
        "VdbQuality::resolution is less than 1",
    )
    .without(|_, quality| quality.resolution = 1.0),
    row(
        Features::ACCUMULATED,
        &["VDB_ACCUMULATED"],
        "accumulation",
        "VdbQuality::accumulate is more than 1",
    )
    .without(|_, quality| quality.accumulate = 0),
    row(Features::MULTISAMPLED, &["MULTISAMPLED"], "multisampled depth", "the camera has MSAA"),
    row(Features::PAGES, &["VDB_PAGED"], "pages", "grids exceed one binding of the GPU"),
    row(
        Features::WIDE_GRIDS,
        &["VDB_WIDE_GRIDS"],
        "wide grids",
        "a grid is more than 2^22 voxels wide",
    ),
    row(
        Features::LIGHT_CACHE,
        &["VDB_LIGHT_CACHE"],
        "light cache",
        "VdbQuality::fog_light_error is more than 0, and a light with shadow_maps_enabled lights fog",
    ),
    row(
        Features::CACHED_LAMPS,
        &["VDB_CACHED_LAMPS"],
        "lamps in the light cache",
        "with the light cache, a point or spot light has shadow_maps_enabled",
    ),
    row(
        Features::UNCACHED_LIGHTS,
        &["VDB_UNCACHED_LIGHTS"],
        "lights beside the cache",
        "with the light cache, more than 4 suns or 32 point and spot lights cast shadows, or it is full",
    ),
    row(
        Features::OTHER_LIGHTS,
        &["VDB_OTHER_LIGHTS"],
        "other lights in cached fog",
        "with the light cache, a light has no shadow_maps_enabled, or is not in the cache",
    ),
    row(
        Features::MESH_CASTERS,
        &["VDB_MESH_CASTERS"],
        "shadows of meshes in cached light",
        "with the light cache, there is a mesh without NotShadowCaster",
    ),
    row(
        Features::UNCACHED_FOGS,
        &["VDB_UNCACHED_FOGS"],
        "fogs beside the cache",
        "with the light cache, a fog is too dense or too large for it and rays are more accurate, it is \
         full, or there are more than 8 fogs or more than 8 emission grids",
    ),
    row(
        Features::LAMP_LIGHT,
        &["VDB_LAMP_LIGHT"],
        "scattered light of lamps",
        "lamps are in the light cache, and the scene has no surface or mesh that casts shadows",
    ),
    row(
        Features::VELOCITIES,
        &["VDB_VELOCITIES"],
        "velocities in motion vectors",
        "with motion vectors, a volume in view has a VdbVelocity",
    ),
    row(
        Features::SMOOTH_NORMALS,
        &["VDB_SMOOTH_NORMALS"],
        "smooth normals",
        "VdbQuality::smooth_normals, and a smooth surface is in view or is reflected",
    )
    .without(|_, quality| quality.smooth_normals = false),
    row(
        Features::EDGES,
        &["VDB_EDGES"],
        "rays on edges",
        "VdbQuality::edge_samples is more than 0, and a surface is in view",
    )
    .without(|_, quality| quality.edge_samples = 0),
    row(
        Features::FOG_COLORS,
        &["VDB_FOG_COLORS", "VDB_VARYING_ALBEDO"],
        "colours in fog",
        "a fog has a VdbColorGrid",
    ),
    row(
        Features::RAMPS,
        &["VDB_RAMPS", "VDB_VARYING_ALBEDO", "VDB_EMITS"],
        "ramps",
        "a fog has a VdbRamp",
    ),
    row(
        Features::REFLECTION_PROBES,
        &["ENVIRONMENT_MAP"],
        "reflection probes",
        "a surface and a LightProbe with an EnvironmentMapLight are in view",
    ),
    row(
        Features::IRRADIANCE_VOLUMES,
        &["IRRADIANCE_VOLUME", "IRRADIANCE_VOLUMES_ARE_USABLE"],
        "irradiance volumes",
        "a surface and a LightProbe with an IrradianceVolume are in view",
    ),
    row(
        Features::MATERIALS,
        &["VDB_MATERIALS"],
        "custom materials",
        "a surface has a VdbMaterialExtension",
    ),
    row(
        Features::FOG_MATERIALS,
        &["VDB_FOG_MATERIALS", "VDB_VARYING_ALBEDO"],
        "custom materials in fog",
        "a fog has a VdbMaterialExtension",
    ),
    row(
        Features::MESH_REFLECTIONS,
        &["VDB_MESH_REFLECTIONS"],
        "reflections of meshes",
        "VdbQuality::mesh_reflections, reflections is more than 0, a surface and a mesh are in view, \
         and the camera has Hdr or no tonemapping",
    )
    .without(|_, quality| quality.mesh_reflections = false),
    row(
        Features::DENOISED,
        &["VDB_DENOISE"],
        "denoised reflections",
        "VdbQuality::denoise, reflections is more than 0, and a rough surface is in view",
    )
    .without(|_, quality| quality.denoise = false),
    row(
        Features::RECT_LIGHTS,
        &["VDB_RECT_LIGHTS", "AREA_LIGHT_LUTS"],
        "rectangle lights",
        "there are rectangle lights, and Bevy has its feature area_light_luts",
    ),
    row(
        Features::FIRE_LIGHTS,
        &["VDB_FIRE_LIGHTS"],
        "highlights of fires by reflection",
        "VdbQuality::reflections is more than 0, and there are a surface and a fire with a \
         VdbEmissionLight",
    ),
    row(
        Features::LEVELS,
        &["VDB_LEVELS"],
        "levels of detail within volumes",
        "VdbQuality::detail is more than 0, and a surface reaches from near to far",
    )
    .without(|_, quality| quality.detail = 0.0),
    row(Features::CLIPPED, &["VDB_CLIP"], "clip planes", "a volume has a VdbClippedBy"),
    row(
        Features::SCATTERED_LIGHT,
        &["VDB_SCATTERED"],
        "scattered light",
        "with multiple scattering, a light has shadow_maps_enabled",
    ),
    row(
        Features::TINTED_FOG,
        &["VDB_VARYING_ALBEDO"],
        "tinted fog",
        "with scattered light, the base_color of a fog is not grey",
    ),
    row(
        Features::REFLECTION_HISTORY,
        &["VDB_REFLECTION_HISTORY"],
        "reflections of earlier frames",
        "reflections are denoised, frames are not accumulated, and the device has a storage texture to spare",
    ),
];

impl Features {
    /// The features whose shaders bind the table of custom materials.
    pub const OWN_MATERIALS: Self = Self::MATERIALS.union(Self::FOG_MATERIALS);

    /// The features if `on`, otherwise none.
    pub fn when(self, on: bool) -> Self {
        if on { self } else { Self::empty() }
    }

    /// The rows of these features in the table.
    pub fn rows(self) -> impl Iterator<Item = &'static Feature> {
        FEATURES.iter().filter(move |feature| self.contains(feature.flag))
    }

    /// The shader defs of these features.
    pub fn defs(self) -> impl Iterator<Item = &'static str> {
        self.rows().flat_map(|feature| feature.defs).copied()
    }

    /// Changes settings so that a camera is drawn without these features.
    pub fn leave_out(self, camera: &mut VdbCamera, quality: &mut VdbQuality) {
        for feature in self.rows() {
            if let Some(Without::Settings(change)) = feature.without {
                change(camera, quality);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_has_one_row() {
        let all: Vec<Features> = FEATURES.iter().map(|feature| feature.flag).collect();
        assert_eq!(all, Features::all().iter().collect::<Vec<_>>());
        let names: std::collections::HashSet<_> =
            FEATURES.iter().map(|feature| feature.name).collect();
        assert_eq!(names.len(), FEATURES.len());
    }
}
