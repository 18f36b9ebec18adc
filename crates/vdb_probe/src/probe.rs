//! Inputs and outputs of single rays.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use bytemuck::{Pod, Zeroable};
use vdb_core::pack::{PackedGrid, traverse};
use vdb_core::view::GpuRays;

use crate::gpu::{Gpu, Kernel};
use crate::shaders::{Alterations, Defs, compose_altered, to_wgsl};

/// A ray in local lattice coordinates of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ProbeRay {
    /// The cell of the origin.
    pub cell: [i32; 3],
    /// The start of the ray.
    pub t_min: f32,
    /// The position of the origin in its cell.
    pub frac: [f32; 3],
    /// The end of the ray.
    pub t_max: f32,
    /// Cells per unit of `t`.
    pub dir: [f32; 3],
    pad: f32,
}

impl From<traverse::Ray> for ProbeRay {
    fn from(ray: traverse::Ray) -> Self {
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

/// The result of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ProbeHit {
    /// The voxel.
    pub cell: [i32; 3],
    /// The axis of the face entered; 3 if the ray began inside.
    pub axis: u32,
    /// The gradient of a smooth surface, in index space, of any length.
    pub gradient: [f32; 3],
    /// 1 for a hit, else 0.
    pub hit: u32,
    /// The ray parameter of the hit.
    pub t: f32,
    /// ∫ density dt.
    pub optical_length: f32,
    /// The number of traversal steps.
    pub steps: u32,
    pad: f32,
}

/// The query to run for each ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeKind {
    /// Finds the first occupied voxel.
    Voxels,
    /// Finds the first root of the interpolant.
    Smooth,
    /// Integrates the optical depth.
    Fog,
}

/// Constants of a dispatch.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Setup {
    /// The size of the image, in pixels.
    size: [u32; 2],
    /// The number of rays.
    count: u32,
    pad: u32,
}

/// A packed grid on the GPU.
#[derive(Debug)]
pub struct GpuGrid {
    /// The buffers, with their bindings.
    buffers: Vec<(u32, wgpu::Buffer)>,
    /// log₂ of the words per page, if there are several pages.
    bits: Option<u32>,
    is_wide: bool,
}

/// The bindings of the pages of words, as in `bindings.wgsl`.
const PAGES: [u32; 3] = [1, 2, 3];

impl GpuGrid {
    /// Uploads a grid, in several pages if it exceeds the largest binding. Kernels need its
    /// [`defs`](Self::defs), which [`Probe`] adds.
    ///
    /// # Panics
    /// If the grid is larger than [`Self::capacity`].
    pub fn new(gpu: &Gpu, grid: &PackedGrid) -> Self {
        let page = Self::page(gpu);
        Self::paged(
            gpu,
            grid,
            if grid.words.len() as u64 <= page { None } else { Some(page.ilog2()) },
        )
    }

    /// The most words per page.
    fn page(gpu: &Gpu) -> u64 {
        gpu.max_binding() / 4
    }

    /// The most words that shaders can access.
    pub fn capacity(gpu: &Gpu) -> u64 {
        (PAGES.len() as u64) << Self::page(gpu).ilog2()
    }

    /// Uploads a grid in pages of `2^bits` words.
    ///
    /// # Panics
    /// If that takes more pages than there are bindings.
    pub fn paged(gpu: &Gpu, grid: &PackedGrid, bits: Option<u32>) -> Self {
        let mut buffers = vec![(0, gpu.storage(bytemuck::bytes_of(&grid.header(0))))];
        let page = bits.map_or(usize::MAX, |bits| 1 << bits);
        assert!(
            grid.words.len().div_ceil(page) <= PAGES.len(),
            "pages of {page} words are too small"
        );
        for (i, binding) in PAGES.into_iter().enumerate() {
            let words = grid.words.chunks(page).nth(i).unwrap_or_default();
            buffers.push((binding, gpu.storage(bytemuck::cast_slice(words))));
        }
        Self { buffers, bits, is_wide: grid.is_wide() }
    }

    /// The shader defs for the grid and its pages.
    pub fn defs(&self) -> Vec<String> {
        let pages = self.bits.map(|bits| ["PAGED".into(), format!("PAGE_BITS={bits}")]);
        let wide = self.is_wide.then(|| "WIDE_GRIDS".into());
        pages.into_iter().flatten().chain(wide).collect()
    }

    /// The buffers with their bindings.
    pub fn bindings(&self) -> Vec<(u32, &wgpu::Buffer)> {
        self.buffers.iter().map(|(binding, buffer)| (*binding, buffer)).collect()
    }
}

/// The kernels of one query.
#[derive(Debug)]
pub struct Probe<'a> {
    gpu: &'a Gpu,
    entry: &'static str,
    defs: Vec<String>,
    alterations: Alterations,
    /// Kernels compiled so far, by their defs.
    kernels: Mutex<HashMap<Vec<String>, Arc<Kernel>>>,
}

const SOURCE: &str = include_str!("probe.wgsl");

/// Rays per dispatch along x, as in `probe.wgsl`.
const ROW: u32 = 64 * 32768;

impl<'a> Probe<'a> {
    /// A probe of a kind. Kernels are compiled when a grid first needs them.
    pub fn new(gpu: &'a Gpu, kind: ProbeKind) -> Self {
        Self::with_defs(gpu, kind, &[])
    }

    /// A probe with additional shader defs.
    pub fn with_defs(gpu: &'a Gpu, kind: ProbeKind, defs: Defs) -> Self {
        let entry = match kind {
            ProbeKind::Voxels => "probe_voxels",
            ProbeKind::Smooth => "probe_smooth",
            ProbeKind::Fog => "probe_fog",
        };
        let defs = defs.iter().chain(&["COUNT_STEPS"]).map(|def| (*def).to_owned()).collect();
        Self { gpu, entry, defs, alterations: &[], kernels: Mutex::default() }
    }

    /// A probe of a kind that runs altered shaders.
    pub fn altered(gpu: &'a Gpu, kind: ProbeKind, alterations: Alterations) -> Self {
        Self { alterations, ..Self::new(gpu, kind) }
    }

    /// The shader defs for a grid, with one more if there is one.
    fn defs(&self, grid: &GpuGrid, more: Option<&str>) -> Vec<String> {
        self.defs.iter().cloned().chain(grid.defs()).chain(more.map(Into::into)).collect()
    }

    /// The kernel for a grid, as WGSL without imports, and the name of its entry point.
    pub fn wgsl(&self, grid: &GpuGrid) -> (String, &'static str) {
        let defs = self.defs(grid, None);
        let defs: Vec<&str> = defs.iter().map(String::as_str).collect();
        (to_wgsl(&compose_altered(SOURCE, &defs, self.alterations)), self.entry)
    }

    /// The kernel for a grid, with one additional def if there is one.
    fn kernel(&self, grid: &GpuGrid, more: Option<&str>) -> Arc<Kernel> {
        let defs = self.defs(grid, more);
        let mut kernels = self.kernels.lock().expect("no kernel panics half-compiled");
        let kernel = kernels.entry(defs).or_insert_with_key(|defs| {
            let defs: Vec<&str> = defs.iter().map(String::as_str).collect();
            Arc::new(self.gpu.altered_kernel(SOURCE, self.entry, &defs, self.alterations))
        });
        kernel.clone()
    }

    /// Traces given rays through a grid.
    pub fn send(&self, grid: &GpuGrid, rays: &[ProbeRay]) -> Vec<ProbeHit> {
        let setup = Setup { size: [0; 2], count: rays.len() as u32, pad: 0 };
        let rays = self.gpu.storage(bytemuck::cast_slice(rays));
        self.run(&self.kernel(grid, None), grid, setup, &[(4, &rays)])
    }

    /// Traces the rays of an image of `size` pixels through a grid, row by row, with ray starts
    /// shared within tiles. Returns the rays generated by the shader, and their results.
    pub fn picture(
        &self,
        grid: &GpuGrid,
        view: &GpuRays,
        size: [u32; 2],
    ) -> (Vec<ProbeRay>, Vec<ProbeHit>) {
        let setup = Setup { size, count: size[0] * size[1], pad: 0 };
        let view = self.gpu.storage(bytemuck::bytes_of(view));
        let bytes = u64::from(setup.count) * size_of::<ProbeRay>() as u64;
        let made = self.gpu.output(bytes);
        let hits =
            self.run(&self.kernel(grid, Some("PICTURE")), grid, setup, &[(7, &view), (8, &made)]);
        (bytemuck::pod_collect_to_vec(&self.gpu.read(&made, bytes)), hits)
    }

    fn run(
        &self,
        kernel: &Kernel,
        grid: &GpuGrid,
        setup: Setup,
        more: &[(u32, &wgpu::Buffer)],
    ) -> Vec<ProbeHit> {
        let count = setup.count;
        if count == 0 {
            return Vec::new();
        }
        let bytes = u64::from(count) * size_of::<ProbeHit>() as u64;
        let hits = self.gpu.output(bytes);
        let setup = self.gpu.uniform(bytemuck::bytes_of(&setup));
        let mut buffers = grid.bindings();
        buffers.extend([(5, &hits), (6, &setup)]);
        buffers.extend_from_slice(more);
        let groups = [count.min(ROW).div_ceil(64), count.div_ceil(ROW), 1];
        self.gpu.run(kernel, &buffers, groups);
        bytemuck::pod_collect_to_vec(&self.gpu.read(&hits, bytes))
    }
}
