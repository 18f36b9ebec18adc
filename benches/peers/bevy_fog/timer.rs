//! The GPU's clock before and after Bevy's fog: that pass has no span in `RenderDiagnosticsPlugin`.

use bevy::core_pipeline::core_3d::main_transparent_pass_3d;
use bevy::core_pipeline::schedule::{Core3d, Core3dSystems};
use bevy::prelude::*;
use bevy::render::renderer::{RenderContext, RenderDevice, RenderQueue};

/// Two timestamps a frame.
#[derive(Resource)]
struct Timer {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    back: wgpu::Buffer,
    /// Milliseconds a tick.
    period: f64,
}

/// Adds the timer to the render world.
///
/// # Errors
/// When the adapter cannot tell the time.
pub fn add(render_app: &mut SubApp, adapter: &str) -> Result<(), String> {
    let device = render_app.world().resource::<RenderDevice>().wgpu_device();
    let wanted = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS;
    if !device.features().contains(wanted) {
        return Err(format!(
            "{adapter} has no timestamp queries between passes; take a driver that has them (any \
             Vulkan driver of a desktop GPU, Mesa's lavapipe)"
        ));
    }
    let buffer = |usage| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: 16,
            usage,
            mapped_at_creation: false,
        })
    };
    let timer = Timer {
        queries: device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("fog"),
            ty: wgpu::QueryType::Timestamp,
            count: 2,
        }),
        resolved: buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
        back: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
        period: f64::from(render_app.world().resource::<RenderQueue>().get_timestamp_period())
            * 1e-6,
    };
    render_app.insert_resource(timer);
    // Bevy's fog comes between the two sets. Command buffers are submitted in the order of systems.
    render_app.add_systems(
        Core3d,
        (
            begin.in_set(Core3dSystems::MainPass).after(main_transparent_pass_3d),
            end.in_set(Core3dSystems::EarlyPostProcess),
        ),
    );
    Ok(())
}

fn begin(timer: Res<Timer>, mut context: RenderContext) {
    context.command_encoder().write_timestamp(&timer.queries, 0);
}

fn end(timer: Res<Timer>, mut context: RenderContext) {
    let encoder = context.command_encoder();
    encoder.write_timestamp(&timer.queries, 1);
    encoder.resolve_query_set(&timer.queries, 0..2, &timer.resolved, 0);
    encoder.copy_buffer_to_buffer(&timer.resolved, 0, &timer.back, 0, 16);
}

/// What the last frame's fog took, in milliseconds; waits for it.
///
/// # Errors
/// When the GPU does not finish.
pub fn elapsed(render_world: &World) -> Result<f64, String> {
    let (timer, device) =
        (render_world.resource::<Timer>(), render_world.resource::<RenderDevice>());
    let slice = timer.back.slice(..);
    // A failure comes back from the poll or leaves the buffer unmapped, where reading tells.
    slice.map_async(wgpu::MapMode::Read, |_| {});
    device
        .wgpu_device()
        .poll(wgpu::PollType::wait_indefinitely())
        .map_err(|error| error.to_string())?;
    let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&slice.get_mapped_range());
    timer.back.unmap();
    Ok(ticks[1].saturating_sub(ticks[0]) as f64 * timer.period)
}
