//! Work that keeps a GPU at its full clock: between frames as short as these it would sink, and the same
//! setting take twice as long now as then.

use std::time::Instant;

use bevy::prelude::*;
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::{Render, RenderApp, RenderSystems};
use wgpu::{BufferUsages, PollType, SubmissionIndex};

/// Milliseconds of work before each frame: longer than a CPU takes to make one ready, so that the GPU is
/// never without work.
const MS: f64 = 10.0;

const SOURCE: &str = "
@group(0) @binding(0) var<storage, read_write> out: array<f32>;
@group(0) @binding(1) var<uniform> turns: vec4<u32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    var x = f32(id.x);
    for (var i = 0u; i < turns.x; i++) {
        x = fma(x, 0.999, 0.5);
    }
    out[id.x & 1023u] = x;
}";

#[derive(Resource)]
struct Work {
    pipeline: wgpu::ComputePipeline,
    bind_group: wgpu::BindGroup,
    turns: wgpu::Buffer,
    before: Option<SubmissionIndex>,
}

/// Adds that work to all frames of an app, unless its adapter is a CPU.
pub fn keep_warm(app: &mut App) {
    let render = app.sub_app_mut(RenderApp);
    let Some(device) = render.world().get_resource::<RenderDevice>().cloned() else { return };
    let info = render.world().resource::<bevy::render::renderer::RenderAdapterInfo>();
    if info.device_type == wgpu::DeviceType::Cpu {
        return;
    }
    let queue = render.world().resource::<RenderQueue>().clone();
    let mut work = Work::new(device.wgpu_device());
    work.calibrate(device.wgpu_device(), &queue);
    render.insert_resource(work);
    render.add_systems(Render, run.in_set(RenderSystems::PrepareResources));
}

fn run(mut work: ResMut<Work>, device: Res<RenderDevice>, queue: Res<RenderQueue>) {
    work.submit(device.wgpu_device(), &queue);
}

impl Work {
    fn new(device: &wgpu::Device) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("warm"),
            source: wgpu::ShaderSource::Wgsl(SOURCE.into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("warm"),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: default(),
            cache: None,
        });
        let buffer = |size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("warm"),
                size,
                usage: usage | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let (out, turns) = (buffer(4096, BufferUsages::STORAGE), buffer(16, BufferUsages::UNIFORM));
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("warm"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: out.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: turns.as_entire_binding() },
            ],
        });
        Self { pipeline, bind_group, turns, before: None }
    }

    /// Finds how many turns take as long as wanted.
    fn calibrate(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        let mut turns = 1_u32 << 10;
        loop {
            queue.write_buffer(&self.turns, 0, bytemuck::cast_slice(&[turns, 0, 0, 0]));
            // The first is of an idle GPU.
            (0..20).for_each(|_| self.submit(device, queue));
            let start = Instant::now();
            (0..10).for_each(|_| self.submit(device, queue));
            let ms = 100.0 * start.elapsed().as_secs_f64();
            if ms >= MS || turns > 1 << 24 {
                return;
            }
            turns = (f64::from(turns) * (1.1 * MS / ms.max(0.1)).clamp(1.1, 16.0)) as u32;
        }
    }

    /// Once that of the frame before is done: so never more than two frames are under way.
    fn submit(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        if let Some(before) = self.before.take() {
            let wait = PollType::Wait { submission_index: Some(before), timeout: None };
            // A device that is lost is told of by the frame.
            let _ = device.poll(wait);
        }
        let mut encoder = device.create_command_encoder(&default());
        {
            let mut pass = encoder.begin_compute_pass(&default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bind_group, &[]);
            pass.dispatch_workgroups(4096, 1, 1);
        }
        self.before = Some(queue.submit([encoder.finish()]));
    }
}
