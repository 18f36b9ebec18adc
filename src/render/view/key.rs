//! The key that a view's pipelines are specialised on, and the rules by which pipelines of one key
//! can replace those of another.

use super::media::MediaSlots;
use crate::VdbRenderMode;
use crate::quality::features::Features;
use crate::render::extract::AuxiliaryGrid;
use crate::render::gpu::types;

/// The key that a view's pipelines are specialised on; each pass uses the parts that it depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct ViewKey {
    pub features: Features,
    pub mode: VdbRenderMode,
    /// The number of suns in the light cache, if there is one.
    pub cached_suns: Option<u32>,
    /// The media that are marched together on a ray, in views with the light cache.
    pub media: Option<MediaSlots>,
    /// The kinds of custom materials, a bit each.
    pub materials: u32,
    /// The shader def of Bevy's shadow filtering, in views with shadows.
    pub shadow_filter: Option<&'static str>,
    /// log₂ of the number of words per page, if the pool has several pages.
    pub page_bits: Option<u32>,
    /// The sample format, if all grids have the same.
    pub sample_format: Option<u32>,
}

impl ViewKey {
    pub fn has(&self, feature: Features) -> bool {
        self.features.contains(feature)
    }

    /// The number of entries that are displayed: of those out of view, which come last, only
    /// reflections are.
    pub fn displayed(&self, seen: usize, all: usize) -> usize {
        if self.has(Features::REFLECTIONS) { all } else { seen }
    }

    /// Whether pipelines of this key can be used while those of `wanted` are being compiled.
    /// `present` are the features of the lights in the scene, regardless of the render mode.
    pub fn can_replace(&self, wanted: &Self, present: Features) -> bool {
        let fixed = Features::MULTISAMPLED | Features::MOTION_VECTORS;
        let bound = Features::ENVIRONMENT
            | Features::DISTANCE_FOG
            | Features::REFLECTION_PROBES
            | Features::IRRADIANCE_VOLUMES;
        let is_safe = self.has(Features::WIDE_GRIDS) || !wanted.has(Features::WIDE_GRIDS);
        is_safe
            && self.features & fixed == wanted.features & fixed
            && self.page_bits == wanted.page_bits
            && present.contains(self.features & bound)
    }

    /// The kind of an entry for the shaders: `kind`, or [`types::KIND_NONE`] if they cannot read a
    /// grid of this kind or sample format.
    pub fn kind_for(&self, kind: u32, format: Option<u32>) -> u32 {
        let is_known = kind != types::KIND_BLACKBODY || self.has(Features::BLACKBODY);
        if is_known && self.reads(format) { kind } else { types::KIND_NONE }
    }

    /// Whether the shaders can read the grids of a volume's colour.
    pub fn reads_colors(&self, colors: &[AuxiliaryGrid]) -> bool {
        colors.iter().all(|grid| self.reads(grid.packed.sample_format()))
    }

    fn reads(&self, format: Option<u32>) -> bool {
        self.sample_format.is_none() || format.is_none() || self.sample_format == format
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_fallback_cannot_read_is_left_out() {
        let features = Features::VOXELS | Features::FOG | Features::LIGHT | Features::EMISSION;
        let any = ViewKey { features, ..Default::default() };
        let one = ViewKey {
            features: features | Features::BLACKBODY,
            sample_format: Some(1),
            ..Default::default()
        };
        use types::{KIND_BLACKBODY, KIND_EMISSION, KIND_FOG, KIND_NONE, KIND_SURFACE};
        for (key, kind, format, expected) in [
            // Without the feature, kelvin would be read as luminance.
            (any, KIND_BLACKBODY, Some(2), KIND_NONE),
            (one, KIND_BLACKBODY, Some(1), KIND_BLACKBODY),
            (any, KIND_EMISSION, Some(2), KIND_EMISSION),
            (one, KIND_EMISSION, Some(2), KIND_NONE),
            (any, KIND_FOG, Some(2), KIND_FOG),
            (one, KIND_FOG, Some(2), KIND_NONE),
            (one, KIND_SURFACE, None, KIND_SURFACE),
        ] {
            assert_eq!(key.kind_for(kind, format), expected, "{kind} {format:?}");
        }
    }

    #[test]
    fn a_fallback_needs_the_light_that_it_was_compiled_for() {
        let lit = |features| ViewKey { features: Features::LIGHT | features, ..Default::default() };
        let (plain, with_maps) = (lit(Features::empty()), lit(Features::ENVIRONMENT));
        assert!(with_maps.can_replace(&plain, Features::ENVIRONMENT));
        assert!(!with_maps.can_replace(&plain, Features::empty()));
        assert!(plain.can_replace(&with_maps, Features::empty()));
        assert!(!plain.can_replace(&lit(Features::MOTION_VECTORS), Features::empty()));
    }

    #[test]
    fn a_fallback_ends_its_loops_in_wide_grids() {
        let plain = ViewKey::default();
        let wide = ViewKey { features: Features::WIDE_GRIDS, ..Default::default() };
        assert!(wide.can_replace(&plain, Features::empty()));
        assert!(!plain.can_replace(&wide, Features::empty()));
    }
}
