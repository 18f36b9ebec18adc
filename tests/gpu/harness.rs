//! The shaders on whatever adapter there is, without Bevy: composed by `naga_oil` as Bevy does.

use std::borrow::Cow;

use bytemuck::{Pod, Zeroable};
use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue, ShaderLanguage,
};
use vdb_core::pack::{PackedGrid, walk};
use wgpu::util::DeviceExt;

pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
}

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct ProbeRay {
    pub cell: [i32; 3],
    pub t_min: f32,
    pub frac: [f32; 3],
    pub t_max: f32,
    pub dir: [f32; 3],
    pub pad: f32,
}

#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct ProbeHit {
    pub cell: [i32; 3],
    pub axis: u32,
    pub t: f32,
    pub hit: u32,
    pub optical_length: f32,
    pub steps: u32,
    pub gradient: [f32; 3],
    pub pad: f32,
}

impl From<walk::Ray> for ProbeRay {
    fn from(ray: walk::Ray) -> Self {
        Self {
            cell: ray.cell.to_array(),
            t_min: ray.t_min,
            frac: ray.frac.to_array(),
            t_max: ray.t_max,
            dir: ray.dir.to_array(),
            pad: 0.0,
        }
    }
}

/// As in `types.wgsl`; the crate's own mirror of it is private and has a test of its own.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Grid {
    crown_origin: [i32; 3],
    crown_levels: u32,
    occupied_min: [i32; 3],
    nodes: u32,
    occupied_max: [i32; 3],
    uppers: u32,
    lowers: u32,
    masks: u32,
    values: u32,
    palette: u32,
}

impl Gpu {
    /// The adapter of this machine. `None`, said aloud, only where the environment asks for it:
    /// elsewhere a missing adapter is a failure, or it would pass for a success.
    pub fn find() -> Option<Self> {
        let instance = wgpu::Instance::default();
        let options = wgpu::RequestAdapterOptions::default();
        match block_on(instance.request_adapter(&options)) {
            Ok(adapter) => {
                println!("adapter: {}", adapter.get_info().name);
                let request = wgpu::DeviceDescriptor {
                    required_limits: adapter.limits(),
                    ..Default::default()
                };
                let (device, queue) = block_on(adapter.request_device(&request)).expect("a device");
                Some(Self { device, queue })
            }
            Err(error) if std::env::var_os("BEVY_VDB_SKIP_GPU").is_some() => {
                eprintln!("SKIPPED, as BEVY_VDB_SKIP_GPU says: no GPU adapter ({error})");
                None
            }
            Err(error) => panic!(
                "no GPU adapter ({error}); install Mesa's software driver (Debian: \
                 mesa-vulkan-drivers), or set BEVY_VDB_SKIP_GPU=1 to leave out these tests"
            ),
        }
    }

    /// Walks rays, in local lattice coordinates of the grid, through it.
    pub fn probe(&self, grid: &PackedGrid, rays: &[ProbeRay], entry: &str) -> Vec<ProbeHit> {
        let source = wgpu::ShaderSource::Naga(Cow::Owned(compose(
            include_str!("probe.wgsl"),
            &["COUNT_STEPS"],
        )));
        let module =
            self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        });
        let bounds = grid.occupied.expect("a grid with something in it");
        let header = Grid {
            crown_origin: grid.crown_origin.to_array(),
            crown_levels: grid.crown_levels,
            occupied_min: bounds.min.to_array(),
            nodes: 0,
            occupied_max: bounds.max.to_array(),
            uppers: grid.uppers,
            lowers: grid.lowers,
            masks: 0,
            values: 0,
            palette: grid.palette,
        };
        let masks = if grid.masks.is_empty() { &[0][..] } else { &grid.masks };
        let storage = |bytes: &[u8]| {
            self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: None,
                contents: bytes,
                usage: wgpu::BufferUsages::STORAGE,
            })
        };
        let size =
            size_of_val(rays) as u64 / size_of::<ProbeRay>() as u64 * size_of::<ProbeHit>() as u64;
        let make = |usage| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let out = make(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
        let back = make(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let buffers = [
            storage(bytemuck::bytes_of(&header)),
            storage(bytemuck::cast_slice(&grid.nodes)),
            storage(bytemuck::cast_slice(masks)),
            storage(bytemuck::cast_slice(&grid.values)),
            storage(bytemuck::cast_slice(rays)),
            out.clone(),
        ];
        // A layout made from the shader has what the entry point uses, and no more.
        let used: &[u32] = match entry {
            "probe_surface" => &[0, 1, 2, 4, 5],
            _ => &[0, 1, 2, 3, 4, 5],
        };
        let entries: Vec<_> = used
            .iter()
            .map(|&binding| wgpu::BindGroupEntry {
                binding,
                resource: buffers[binding as usize].as_entire_binding(),
            })
            .collect();
        let bind_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bind_group, &[]);
            pass.dispatch_workgroups((rays.len() as u32).div_ceil(64), 1, 1);
        }
        encoder.copy_buffer_to_buffer(&out, 0, &back, 0, size);
        self.queue.submit([encoder.finish()]);
        back.slice(..).map_async(wgpu::MapMode::Read, |result| result.expect("mapping"));
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the GPU finishes");
        bytemuck::cast_slice(&back.slice(..).get_mapped_range()).to_vec()
    }
}

/// How many rays a test walks: `count`, times what `BEVY_VDB_RAYS` says, for a GPU with time.
pub fn ray_count(count: usize) -> usize {
    let times = std::env::var("BEVY_VDB_RAYS").ok();
    count * times.map_or(1, |times| times.parse().expect("BEVY_VDB_RAYS is a number"))
}

/// The modules of the crate that others import, in an order in which each finds those before it.
const MODULES: [&str; 10] =
    ["types", "bindings", "tree", "exact", "hdda", "anchor", "smooth", "fog", "lights", "surface"];

/// A shader of the crate.
pub fn source(name: &str) -> String {
    let path = format!("{}/assets/shaders/{name}.wgsl", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// One module out of a shader and all that it imports.
pub fn compose(source_text: &str, defs: &[&str]) -> naga::Module {
    let mut composer = Composer::default();
    for module in MODULES {
        let text = source(module);
        let added = composer.add_composable_module(ComposableModuleDescriptor {
            source: &text,
            file_path: module,
            language: ShaderLanguage::Wgsl,
            ..Default::default()
        });
        if let Err(error) = added.map(drop) {
            panic!("{}", error.emit_to_string(&composer));
        }
    }
    let made = composer.make_naga_module(NagaModuleDescriptor {
        source: source_text,
        file_path: "entry",
        shader_defs: defs
            .iter()
            .map(|def| ((*def).to_owned(), ShaderDefValue::Bool(true)))
            .collect(),
        ..Default::default()
    });
    match made {
        Ok(module) => module,
        Err(error) => panic!("{}", error.emit_to_string(&composer)),
    }
}

fn block_on<F: Future>(future: F) -> F::Output {
    bevy::tasks::block_on(future)
}
