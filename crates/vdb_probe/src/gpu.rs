//! A GPU device, and compute kernels on it.

use std::borrow::Cow;

use naga::valid::{Capabilities, GlobalUse, ValidationFlags, Validator};
use thiserror::Error;
use wgpu::util::DeviceExt;

use crate::shaders::{Alterations, Defs, compose_altered};

/// A headless GPU device.
#[derive(Debug)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    timestamps: bool,
}

/// There is no adapter, or it provides no device.
#[derive(Debug, Error)]
#[error(
    "no GPU adapter ({0}); install Mesa's software driver (Debian: mesa-vulkan-drivers), or set \
     BEVY_VDB_SKIP_GPU=1 to skip what needs one"
)]
pub struct NoGpu(String);

/// The bind group used by all kernels: in Bevy, groups 0 and 1 are its own.
const GROUP: u32 = 2;

/// A compute pipeline with one bind group.
#[derive(Debug)]
pub struct Kernel {
    pipeline: wgpu::ComputePipeline,
    /// The bindings that its entry point uses.
    bindings: Vec<u32>,
}

impl Gpu {
    /// Opens the adapter of this machine, with its own limits.
    ///
    /// # Errors
    /// If there is no adapter.
    pub fn new() -> Result<Self, NoGpu> {
        let instance = wgpu::Instance::default();
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let no_gpu = |error: &dyn std::fmt::Display| NoGpu(error.to_string());
        let adapter =
            pollster::block_on(instance.request_adapter(&options)).map_err(|e| no_gpu(&e))?;
        let wanted = wgpu::Features::TIMESTAMP_QUERY & adapter.features();
        let request = wgpu::DeviceDescriptor {
            required_features: wanted,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&request)).map_err(|e| no_gpu(&e))?;
        let timestamps = !wanted.is_empty();
        Ok(Self { device, queue, info: adapter.get_info(), timestamps })
    }

    /// Opens the adapter for tests. Returns `None`, with a message, only if the environment permits
    /// it (`BEVY_VDB_SKIP_GPU`); otherwise a missing adapter is a failure, since it could be
    /// mistaken for success.
    ///
    /// # Panics
    /// If there is no adapter and the environment does not permit that.
    pub fn find() -> Option<Self> {
        match Self::new() {
            Ok(gpu) => Some(gpu),
            Err(error) if std::env::var_os("BEVY_VDB_SKIP_GPU").is_some() => {
                eprintln!("SKIPPED, as BEVY_VDB_SKIP_GPU says: {error}");
                None
            }
            Err(error) => panic!("{error}"),
        }
    }

    /// The name of the adapter and of its driver.
    pub fn name(&self) -> String {
        let info = &self.info;
        match info.driver_info.as_str() {
            "" => info.name.clone(),
            driver => format!("{} ({} {driver})", info.name, info.driver),
        }
    }

    /// What the adapter says about itself and its driver.
    pub fn info(&self) -> &wgpu::AdapterInfo {
        &self.info
    }

    /// Whether the adapter is a software renderer.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// Whether [`Gpu::time`] is supported.
    pub fn has_timestamps(&self) -> bool {
        self.timestamps
    }

    /// The largest size in bytes of a buffer that a shader can access through one binding.
    pub fn max_binding(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// Compiles an entry point.
    ///
    /// # Panics
    /// If the source is invalid, with naga's message.
    pub fn kernel(&self, source: &str, entry: &str, defs: Defs) -> Kernel {
        self.altered_kernel(source, entry, defs, &[])
    }

    /// Compiles an entry point, with alterations of the modules that it imports.
    pub(crate) fn altered_kernel(
        &self,
        source: &str,
        entry: &str,
        defs: Defs,
        alterations: Alterations,
    ) -> Kernel {
        let module = compose_altered(source, defs, alterations);
        let info = Validator::new(ValidationFlags::all(), Capabilities::all())
            .validate(&module)
            .unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)));
        let number = module.entry_points.iter().position(|point| point.name == entry);
        let number = number.unwrap_or_else(|| panic!("no entry point {entry}"));
        let used = info.get_entry_point(number);
        let globals = module.global_variables.iter();
        let bindings = globals
            .filter(|(handle, _)| used[*handle] != GlobalUse::empty())
            .filter_map(|(_, global)| global.binding.as_ref().map(|binding| binding.binding))
            .collect();
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some(entry),
            source: wgpu::ShaderSource::Naga(Cow::Owned(module)),
        };
        #[allow(unsafe_code)]
        // SAFETY: the same as in Bevy, which compiles the crate's shaders likewise. Every index is
        // in range by construction (words come from the packer, and pixels and rays are compared
        // with their number), and every loop terminates (`hdda.wgsl` explains why).
        let module = unsafe {
            let checks = wgpu::ShaderRuntimeChecks::unchecked();
            self.device.create_shader_module_trusted(descriptor, checks)
        };
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: None,
            module: &module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        });
        Kernel { pipeline, bindings }
    }

    /// A buffer for shaders to read.
    pub fn storage(&self, bytes: &[u8]) -> wgpu::Buffer {
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            // A binding must not be empty, but a grid that consists of tiles has no masks.
            contents: if bytes.is_empty() { &[0; 16] } else { bytes },
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        })
    }

    /// A small buffer of constants.
    pub fn uniform(&self, bytes: &[u8]) -> wgpu::Buffer {
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytes,
            usage: wgpu::BufferUsages::UNIFORM,
        })
    }

    /// A buffer for shaders to write.
    pub fn output(&self, bytes: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes.max(16),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        })
    }

    fn bind(&self, kernel: &Kernel, buffers: &[(u32, &wgpu::Buffer)]) -> wgpu::BindGroup {
        let entries: Vec<_> = kernel
            .bindings
            .iter()
            .map(|&binding| {
                let buffer = buffers.iter().find(|(number, _)| *number == binding);
                let (_, buffer) = buffer.unwrap_or_else(|| panic!("no buffer for {binding}"));
                wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() }
            })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &kernel.pipeline.get_bind_group_layout(GROUP),
            entries: &entries,
        })
    }

    /// Runs a kernel once.
    pub fn run(&self, kernel: &Kernel, buffers: &[(u32, &wgpu::Buffer)], groups: [u32; 3]) {
        let bind_group = self.bind(kernel, buffers);
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let step = Step { kernel, buffers, groups };
        dispatch(&mut encoder, &[(&step, &bind_group)], None);
        self.queue.submit([encoder.finish()]);
    }

    /// Reads back a buffer created by [`Gpu::output`].
    ///
    /// # Panics
    /// If the device is lost.
    pub fn read(&self, buffer: &wgpu::Buffer, bytes: u64) -> Vec<u8> {
        let back = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &back, 0, bytes);
        self.queue.submit([encoder.finish()]);
        back.slice(..).map_async(wgpu::MapMode::Read, |result| result.expect("mapping"));
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the GPU finishes");
        back.slice(..).get_mapped_range().to_vec()
    }

    /// The GPU time, in milliseconds, of running kernels one after the other, for each of `runs`
    /// runs.
    ///
    /// # Panics
    /// If the adapter has no timestamps.
    pub fn time(&self, steps: &[Step], runs: u32) -> Vec<f64> {
        assert!(self.timestamps, "{} has no timestamps", self.info.name);
        let queries = self.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: None,
            ty: wgpu::QueryType::Timestamp,
            count: 2,
        });
        let resolved = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 16,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let groups: Vec<_> =
            steps.iter().map(|step| self.bind(step.kernel, step.buffers)).collect();
        let passes: Vec<_> = steps.iter().zip(&groups).collect();
        let period = f64::from(self.queue.get_timestamp_period());
        (0..runs)
            .map(|_| {
                let mut encoder = self.device.create_command_encoder(&Default::default());
                dispatch(&mut encoder, &passes, Some(&queries));
                encoder.resolve_query_set(&queries, 0..2, &resolved, 0);
                self.queue.submit([encoder.finish()]);
                let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&self.read(&resolved, 16));
                (ticks[1] - ticks[0]) as f64 * period * 1e-6
            })
            .collect()
    }
}

/// A dispatch of a kernel.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// The kernel.
    pub kernel: &'a Kernel,
    /// The buffers with their binding numbers.
    pub buffers: &'a [(u32, &'a wgpu::Buffer)],
    /// The number of workgroups.
    pub groups: [u32; 3],
}

/// Dispatches all kernels in one pass; wgpu inserts barriers where one reads the output of another.
fn dispatch(
    encoder: &mut wgpu::CommandEncoder,
    steps: &[(&Step, &wgpu::BindGroup)],
    queries: Option<&wgpu::QuerySet>,
) {
    let timestamp_writes = queries.map(|query_set| wgpu::ComputePassTimestampWrites {
        query_set,
        beginning_of_pass_write_index: Some(0),
        end_of_pass_write_index: Some(1),
    });
    let descriptor = wgpu::ComputePassDescriptor { label: None, timestamp_writes };
    let mut pass = encoder.begin_compute_pass(&descriptor);
    for (step, bind_group) in steps {
        pass.set_pipeline(&step.kernel.pipeline);
        pass.set_bind_group(GROUP, *bind_group, &[]);
        let [x, y, z] = step.groups;
        pass.dispatch_workgroups(x, y, z);
    }
}
