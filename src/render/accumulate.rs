//! The mean of a view's frames, while nothing changes in what it sees.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{storage_buffer_sized, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, BindGroupLayoutDescriptor, Buffer, BufferDescriptor, BufferUsages,
    ComputePipelineDescriptor, DynamicBindGroupEntries, DynamicBindGroupLayoutEntries,
    PipelineCache, ShaderStages, SpecializedComputePipeline, TextureFormat, TextureView,
};
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::texture::CachedTexture;
use bevy::shader::Shader;

use super::bind::ViewBindGroups;
use super::changes::SceneChanges;
use super::gpu_data;
use super::kept::KeptPipelines;
use super::layout::{defs, read, scene_depth, write};
use super::over_picture::run_over_picture;
use super::pipeline::{TraceKey, ViewPipelines};
use super::resources::{ViewResources, picture_texture};
use super::shaders::Shaders;
use super::warnings::Trouble;
use crate::{VdbQuality, VdbRenderMode};

/// Bytes of the shader's `Mean`, one for each pixel.
const MEAN: u64 = 32;

/// What a view has over its frames.
pub(super) struct Accumulated {
    /// Of all that it shows.
    fingerprint: u64,
    /// Frames since that has changed. The first is shown as it is, and kept nowhere, so that pictures
    /// that change with each frame cost no more than others.
    pub frame: u32,
    kept: Option<Kept>,
}

/// What is there from the second frame on.
#[derive(Clone)]
pub(super) struct Kept {
    size: UVec2,
    pub means: Buffer,
    pub color: CachedTexture,
    pub depth: CachedTexture,
}

/// Whether frames of a view are put together; if they are to be, but cannot, why not.
pub(super) fn wanted(
    quality: &VdbQuality,
    mode: VdbRenderMode,
    is_jittered: bool,
    picture: UVec2,
    device: &RenderDevice,
) -> Result<bool, Trouble> {
    let limits = device.limits();
    let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
    if quality.accumulate < 2 || !mode.is_lit() {
        Ok(false)
    } else if is_jittered {
        Err(Trouble::Jittered)
    } else if MEAN * picture.as_u64vec2().element_product() > most {
        Err(Trouble::TooManyPixels)
    } else {
        Ok(true)
    }
}

/// A number for all that a view shows.
pub(super) fn fingerprint(
    (key, is_ready): (&TraceKey, bool),
    view: &gpu_data::View,
    volumes: &[gpu_data::Volume],
    changes: &SceneChanges,
) -> u64 {
    let mut hasher = DefaultHasher::new();
    (key, is_ready, changes.of(key)).hash(&mut hasher);
    // Where its volumes are among those of all views is of no account.
    let view = gpu_data::View { volume_first: 0, ..*view };
    bytemuck::bytes_of(&view).hash(&mut hasher);
    bytemuck::cast_slice::<_, u8>(volumes).hash(&mut hasher);
    hasher.finish()
}

impl Accumulated {
    pub fn new(
        before: Option<&Self>,
        fingerprint: u64,
        picture: UVec2,
        device: &RenderDevice,
    ) -> Self {
        let same = before.filter(|before| before.fingerprint == fingerprint);
        let frame = same.map_or(0, |before| before.frame.saturating_add(1));
        let kept = before.and_then(|before| before.kept.clone());
        let mut kept = kept.filter(|kept| kept.size == picture);
        if frame > 0 {
            kept = kept.or_else(|| Some(Kept::new(picture, device)));
        }
        Self { fingerprint, frame, kept }
    }

    /// What is shown in place of this frame.
    pub fn shown(&self) -> Option<&Kept> {
        self.kept.as_ref().filter(|_| self.frame > 0)
    }

    /// What is there, shown or not.
    pub fn kept(&self) -> Option<&Kept> {
        self.kept.as_ref()
    }

    /// Tells the shaders which frame this is.
    pub fn place(&self, view: &mut gpu_data::View, scaled: bool) {
        let frame = self.frame;
        view.frame = frame;
        view.turn = golden(frame);
        // The first ray of a mean is the one that a single frame has. Where rays are fewer than pixels,
        // that one goes through no pixel's middle.
        view.shift = shift(if scaled { frame } else { frame.saturating_sub(1) });
    }
}

impl Kept {
    fn new(picture: UVec2, device: &RenderDevice) -> Self {
        let texture = |label, format| {
            let texture = device.create_texture(&picture_texture(label, format, picture));
            let default_view = texture.create_view(&default());
            CachedTexture { texture, default_view }
        };
        let means = device.create_buffer(&BufferDescriptor {
            label: Some("vdb_means"),
            size: MEAN * picture.as_u64vec2().element_product(),
            usage: BufferUsages::STORAGE,
            mapped_at_creation: false,
        });
        Self {
            size: picture,
            means,
            color: texture("vdb_color_mean", TextureFormat::Rgba16Float),
            depth: texture("vdb_depth_mean", TextureFormat::R32Float),
        }
    }
}

/// Multiples of the golden section, from 0 up to but not 1: spread evenly.
pub(super) fn golden(frame: u32) -> f32 {
    (f64::from(frame) * 0.618_033_988_749_895).fract() as f32
}

/// Places in a square from -½ to ½, which are spread over it as evenly as may be however many they are:
/// after Martin Roberts 2018, "The unreasonable effectiveness of quasirandom sequences". The first is
/// its middle.
fn shift(i: u32) -> [f32; 2] {
    // Powers of the plastic number: the real root of x³ = x + 1.
    let plastic = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    // What rounds up to ½ would be in the next pixel.
    let below_half = 0.5_f32.next_down();
    plastic.map(|a: f64| (((0.5 + f64::from(i) * a).fract() - 0.5) as f32).min(below_half))
}

#[derive(Debug, Resource)]
pub(super) struct AccumulatePipeline {
    shader: Handle<Shader>,
    /// Without and with multisampling, each with as many rays as pixels and with fewer.
    layouts: [[BindGroupLayoutDescriptor; 2]; 2],
}

/// Which variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct AccumulateKey {
    multisampled: bool,
    scaled: bool,
}

impl From<&TraceKey> for AccumulateKey {
    fn from(key: &TraceKey) -> Self {
        Self { multisampled: key.multisampled, scaled: key.scaled }
    }
}

impl AccumulatePipeline {
    pub fn new(shaders: &Shaders) -> Self {
        let layout = |multisampled: bool, scaled: bool| {
            let mut entries = DynamicBindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (
                    uniform_buffer_sized(false, None),
                    scene_depth(multisampled),
                    read(),
                    read(),
                    storage_buffer_sized(false, None),
                    write(TextureFormat::Rgba16Float),
                    write(TextureFormat::R32Float),
                ),
            );
            if scaled {
                entries = entries.extend_with_indices(((7, read()), (8, read())));
            }
            BindGroupLayoutDescriptor::new("vdb_accumulate", &entries)
        };
        let both = [false, true];
        let layouts = both.map(|samples| both.map(|scaled| layout(samples, scaled)));
        Self { shader: shaders.accumulate.clone(), layouts }
    }

    fn layout(&self, key: AccumulateKey) -> &BindGroupLayoutDescriptor {
        &self.layouts[usize::from(key.multisampled)][usize::from(key.scaled)]
    }

    /// What the pass reads and writes; where there is none, nothing.
    pub fn bind(
        &self,
        resources: &ViewResources,
        key: &TraceKey,
        scene_depth: &TextureView,
        device: &RenderDevice,
        cache: &PipelineCache,
    ) -> Option<BindGroup> {
        let kept = resources.accumulated.as_ref()?.shown()?;
        let mut entries = DynamicBindGroupEntries::sequential((
            resources.view.as_entire_binding(),
            scene_depth,
            &resources.color.default_view,
            &resources.depth.default_view,
            kept.means.as_entire_binding(),
            &kept.color.default_view,
            &kept.depth.default_view,
        ));
        if let Some(upscaled) = &resources.upscaled {
            let (color, depth) = (&upscaled.color.default_view, &upscaled.depth.default_view);
            entries = entries.extend_with_indices(((7, color), (8, depth)));
        }
        let layout = cache.get_bind_group_layout(self.layout(key.into()));
        Some(device.create_bind_group("vdb_accumulate", &layout, &entries))
    }
}

impl SpecializedComputePipeline for AccumulatePipeline {
    type Key = AccumulateKey;

    fn specialize(&self, key: AccumulateKey) -> ComputePipelineDescriptor {
        let own =
            [(true, "ACCUMULATED"), (key.multisampled, "MULTISAMPLED"), (key.scaled, "SCALED")];
        ComputePipelineDescriptor {
            label: Some("vdb_accumulate".into()),
            layout: vec![self.layout(key).clone()],
            shader: self.shader.clone(),
            shader_defs: defs(own).collect(),
            entry_point: Some("accumulate".into()),
            ..default()
        }
    }
}

/// Adds this frame to the mean, in views that have one.
pub(super) fn accumulate(
    view: ViewQuery<(&ViewResources, &ViewPipelines, &ViewBindGroups)>,
    pipelines: Res<PipelineCache>,
    kept: Res<KeptPipelines>,
    mut context: RenderContext,
) {
    let (resources, view_pipelines, bind_groups) = view.into_inner();
    let (Some(id), Some(bind_group)) = (view_pipelines.accumulate, &bind_groups.accumulate) else {
        return;
    };
    let ready = kept.compute(&pipelines, id).filter(|_| view_pipelines.is_ready);
    let Some(pipeline) = ready else { return };
    run_over_picture(&mut context, "vdb_accumulate", pipeline, bind_group, resources.picture);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_come_to_all_of_a_pixel_evenly() {
        assert_eq!(shift(0), [0.0; 2]);
        // With a half and a quarter of the rays along each axis, as few as there may be, each pixel has one of
        // its own after so many frames.
        for (edge, rays) in [(2, 4), (4, 24)] {
            let mut parts = vec![0; edge * edge];
            for i in 1..=rays {
                let [x, y] = shift(i).map(|s| ((s + 0.5) * edge as f32) as usize);
                parts[y * edge + x] += 1;
            }
            assert!(parts.iter().all(|&n| n > 0), "{edge}: {parts:?}");
        }
        for i in 0..100_000 {
            assert!(shift(i).iter().all(|s| (-0.5..0.5).contains(s)), "{i}");
            assert!((0.0..1.0).contains(&golden(i)), "{i}");
        }
    }
}
