//! The mean of a view's frames.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::prelude::*;
use bevy::render::render_resource::{Buffer, BufferDescriptor, BufferUsages, TextureFormat};
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::CachedTexture;

use crate::quality::features::Features;
use crate::render::extract::{ExtractedMaterials, SceneChanges};
use crate::render::gpu::{golden, lasting_texture, types};
use crate::render::view::{MEAN_BYTES, PreparedView, ViewKey};

/// The accumulation state of a view.
pub(crate) struct Accumulated {
    /// The hash of everything in view.
    fingerprint: u64,
    /// The number of frames since the fingerprint last changed. The first frame is displayed
    /// directly and not stored, so a view that changes every frame costs nothing extra.
    pub frame: u32,
    mean: Option<Mean>,
}

/// The mean, from the second frame on.
pub(crate) struct Mean {
    size: UVec2,
    pub buffer: Buffer,
    pub color: CachedTexture,
    pub depth: CachedTexture,
}

/// A hash of everything in view.
pub(super) fn fingerprint(
    prepared: &PreparedView,
    changes: &SceneChanges,
    materials: &ExtractedMaterials,
    replaced_pipelines: u64,
) -> u64 {
    let mut hasher = DefaultHasher::new();
    replaced_pipelines.hash(&mut hasher);
    if prepared.key.features.intersects(Features::OWN_MATERIALS) {
        materials.changes.hash(&mut hasher);
    }
    (prepared.key, prepared.is_ready, changes_of(&prepared.key, changes)).hash(&mut hasher);
    bytemuck::bytes_of(&prepared.data).hash(&mut hasher);
    bytemuck::cast_slice::<_, u8>(&prepared.volumes).hash(&mut hasher);
    prepared.entries.iter().for_each(|entry| entry.lattice.ramp.hash(&mut hasher));
    hasher.finish()
}

/// The counters of scene changes that affect a view.
fn changes_of(key: &ViewKey, changes: &SceneChanges) -> [u64; 3] {
    let seen = |feature, count| if key.has(feature) { count } else { 0 };
    [changes.grids, seen(Features::LIGHT, changes.lights), seen(Features::SHADOWS, changes.casters)]
}

impl Accumulated {
    /// The state of the next frame.
    pub fn next(
        before: Option<Self>,
        fingerprint: u64,
        picture: UVec2,
        device: &RenderDevice,
    ) -> Self {
        let (mut frame, mut mean) = (0, None);
        if let Some(before) = before {
            if before.fingerprint == fingerprint {
                frame = before.frame.saturating_add(1);
            }
            mean = before.mean.filter(|mean| mean.size == picture);
        }
        if frame > 0 {
            mean = mean.or_else(|| Some(Mean::new(picture, device)));
        }
        Self { fingerprint, frame, mean }
    }

    /// The mean, if it is displayed instead of this frame.
    pub fn shown(&self) -> Option<&Mean> {
        self.mean.as_ref().filter(|_| self.frame > 0)
    }

    /// The mean, displayed or not.
    pub fn mean(&self) -> Option<&Mean> {
        self.mean.as_ref()
    }

    /// Sets the number of the frame, its random offset and its subpixel jitter for the shaders.
    pub fn place(&self, view: &mut types::View, is_scaled: bool) {
        let frame = self.frame;
        view.frame = frame;
        view.random_offset = golden(frame);
        // The first ray of a mean goes through the centre, like that of a single frame. With fewer
        // rays than pixels, the centre of a ray's footprint is not the centre of a pixel, so it is
        // not repeated.
        view.jitter = shift(if is_scaled { frame } else { frame.saturating_sub(1) });
    }
}

impl Mean {
    fn new(picture: UVec2, device: &RenderDevice) -> Self {
        let texture = |label, format| lasting_texture(label, format, picture, device);
        let buffer = device.create_buffer(&BufferDescriptor {
            label: Some("vdb_means"),
            size: MEAN_BYTES * picture.as_u64vec2().element_product(),
            usage: BufferUsages::STORAGE,
            mapped_at_creation: false,
        });
        Self {
            size: picture,
            buffer,
            color: texture("vdb_color_mean", TextureFormat::Rgba16Float),
            depth: texture("vdb_depth_mean", TextureFormat::R32Float),
        }
    }
}

/// A low-discrepancy sequence of points in a square from -½ to ½, starting at its centre: Martin
/// Roberts 2018, "The unreasonable effectiveness of quasirandom sequences".
fn shift(i: u32) -> [f32; 2] {
    // Powers of the plastic number: the real root of x³ = x + 1.
    let plastic = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    // A value rounded up to ½ would be in the next pixel.
    let below_half = 0.5_f32.next_down();
    plastic.map(|a: f64| (((0.5 + f64::from(i) * a).fract() - 0.5) as f32).min(below_half))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_come_to_all_of_a_pixel_evenly() {
        assert_eq!(shift(0), [0.0; 2]);
        // With half and a quarter of the rays along each axis, the smallest resolution, every pixel
        // has had a ray of its own after this many frames.
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
