//! Single rays: what goes in, what comes out.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use bytemuck::{Pod, Zeroable};
use vdb_core::pack::{PackedGrid, traverse};
use vdb_core::view::GpuRays;

use crate::gpu::{Gpu, Kernel};
use crate::shaders::Defs;

/// A ray in local lattice coordinates of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ProbeRay {
    /// The cell of the origin.
    pub cell: [i32; 3],
    /// Where the ray begins.
    pub t_min: f32,
    /// Where in the cell.
    pub frac: [f32; 3],
    /// Where the ray ends.
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

/// What a ray has met.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ProbeHit {
    /// The voxel.
    pub cell: [i32; 3],
    /// The axis of the face entered; 3: the ray began inside.
    pub axis: u32,
    /// Of a smooth surface, in index space, not of unit length.
    pub gradient: [f32; 3],
    /// 1 where there is a hit.
    pub hit: u32,
    /// Where.
    pub t: f32,
    /// ∫ density dt.
    pub optical_length: f32,
    /// Steps of the traversal.
    pub steps: u32,
    pad: f32,
}

/// What is asked about a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeKind {
    /// The first occupied voxel.
    Voxels,
    /// The first root of the interpolant.
    Smooth,
    /// The optical depth.
    Fog,
}

/// Constants of a dispatch.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Setup {
    /// The picture, in pixels.
    size: [u32; 2],
    /// How many rays.
    count: u32,
    pad: u32,
}

/// A packed grid on the GPU.
#[derive(Debug)]
pub struct GpuGrid {
    /// With their bindings.
    buffers: Vec<(u32, wgpu::Buffer)>,
    /// log₂ of the words of a page, where there are several.
    bits: Option<u32>,
    is_wide: bool,
}

/// The bindings of the pages of words, as `bindings.wgsl` has them.
const PAGES: [u32; 3] = [1, 2, 3];

impl GpuGrid {
    /// Uploads a grid, in pages where a shader cannot bind as much at once; kernels need its
    /// [`defs`](Self::defs), which a [`Probe`] sees to.
    ///
    /// # Panics
    /// When it is larger than [`Self::capacity`].
    pub fn new(gpu: &Gpu, grid: &PackedGrid) -> Self {
        let page = Self::page(gpu);
        Self::paged(
            gpu,
            grid,
            if grid.words.len() as u64 <= page { None } else { Some(page.ilog2()) },
        )
    }

    /// Words of a page at most.
    fn page(gpu: &Gpu) -> u64 {
        gpu.max_binding() / 4
    }

    /// Words that shaders reach.
    pub fn capacity(gpu: &Gpu) -> u64 {
        (PAGES.len() as u64) << Self::page(gpu).ilog2()
    }

    /// Uploads a grid in pages of `2^bits` words.
    ///
    /// # Panics
    /// When that makes more pages than there are bindings.
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

    /// What the shaders have to know of the grid and its pages.
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

/// The kernels of one question.
#[derive(Debug)]
pub struct Probe<'a> {
    gpu: &'a Gpu,
    entry: &'static str,
    defs: Vec<String>,
    /// Those that grids have asked for so far, by all their defs.
    kernels: Mutex<HashMap<Vec<String>, Arc<Kernel>>>,
}

/// Rays of a dispatch along x; as in `probe.wgsl`.
const ROW: u32 = 64 * 32768;

impl<'a> Probe<'a> {
    /// Kernels are compiled when a grid first needs them.
    pub fn new(gpu: &'a Gpu, kind: ProbeKind) -> Self {
        Self::with_defs(gpu, kind, &[])
    }

    /// The shaders with more defs.
    pub fn with_defs(gpu: &'a Gpu, kind: ProbeKind, defs: Defs) -> Self {
        let entry = match kind {
            ProbeKind::Voxels => "probe_voxels",
            ProbeKind::Smooth => "probe_smooth",
            ProbeKind::Fog => "probe_fog",
        };
        let defs = defs.iter().chain(&["COUNT_STEPS"]).map(|def| (*def).to_owned()).collect();
        Self { gpu, entry, defs, kernels: Mutex::default() }
    }

    /// The kernel for a grid, with one def more if there is one.
    fn kernel(&self, grid: &GpuGrid, more: Option<&str>) -> Arc<Kernel> {
        let mut defs = self.defs.clone();
        defs.extend(grid.defs().into_iter().chain(more.map(Into::into)));
        let mut kernels = self.kernels.lock().expect("no kernel panics half-compiled");
        let kernel = kernels.entry(defs).or_insert_with_key(|defs| {
            let defs: Vec<&str> = defs.iter().map(String::as_str).collect();
            Arc::new(self.gpu.kernel(include_str!("probe.wgsl"), self.entry, &defs))
        });
        kernel.clone()
    }

    /// Sends given rays through a grid.
    pub fn send(&self, grid: &GpuGrid, rays: &[ProbeRay]) -> Vec<ProbeHit> {
        let setup = Setup { size: [0; 2], count: rays.len() as u32, pad: 0 };
        let rays = self.gpu.storage(bytemuck::cast_slice(rays));
        self.run(&self.kernel(grid, None), grid, setup, &[(4, &rays)])
    }

    /// Sends the rays of a picture of so many pixels through a grid, row by row, with the starts that
    /// those of a tile share; and the rays that the shader made of them.
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
