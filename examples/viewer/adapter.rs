//! Checks for a GPU or a software driver such as Mesa's lavapipe, because Bevy panics without one.

use std::fmt;

use bevy::math::UVec2;
use bevy::render::settings::{Backends, WgpuSettings};
use bevy::tasks::block_on;

/// Advice if there is no adapter.
pub const ADVICE: &str = "Install a Vulkan driver: the driver of the GPU, or Mesa's, which can \
also run without a GPU (Debian, Ubuntu: sudo apt-get install mesa-vulkan-drivers libvulkan1).";

#[derive(Clone, Debug)]
pub enum Error {
    /// There is no adapter.
    None(String),
    /// The adapter cannot run compute shaders.
    NoCompute(String),
    /// The image is larger than the adapter's largest texture.
    TooLarge { size: UVec2, adapter: String, most: u32 },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None(why) => write!(f, "no GPU adapter found ({why})"),
            Self::NoCompute(adapter) => write!(f, "{adapter} cannot run compute shaders"),
            Self::TooLarge { size, adapter, most } => {
                write!(f, "--size {}x{}: {adapter} supports at most {most}x{most}", size.x, size.y)
            }
        }
    }
}

/// Requests an adapter like Bevy, and checks that it supports images of a size.
pub fn find(size: Option<UVec2>) -> Result<(), Error> {
    let settings = WgpuSettings::default();
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: settings.backends.unwrap_or(Backends::all()),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let options = wgpu::RequestAdapterOptions {
        power_preference: settings.power_preference,
        ..Default::default()
    };
    let adapter = block_on(instance.request_adapter(&options))
        .map_err(|error| Error::None(error.to_string()))?;
    let name = adapter.get_info().name;
    let flags = adapter.get_downlevel_capabilities().flags;
    if !flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS) {
        return Err(Error::NoCompute(name));
    }
    let most = adapter.limits().max_texture_dimension_2d;
    match size {
        Some(size) if size.max_element() > most => {
            Err(Error::TooLarge { size, adapter: name, most })
        }
        _ => Ok(()),
    }
}
