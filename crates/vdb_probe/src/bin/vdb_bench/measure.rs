//! Rays through a grid, timed.

use std::path::Path;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use glam::{DAffine3, DMat4, DVec3};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::view::{GpuRays, LatticeRays, ViewRays};
use vdb_core::{AnyTree, GridClass, ReadOptions, VdbFile};
use vdb_probe::{Gpu, GpuGrid, Groups, Kernel, Step};

use crate::args::Args;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Setup {
    size: [u32; 2],
    bits: u32,
    density_scale: f32,
}

/// Extinction per unit of density and voxel, as the peers have it.
const DENSITY_SCALE: f32 = 0.1;
/// Milliseconds of work before what counts: a GPU that was idle is slow at first.
const WARM_UP: f64 = 500.0;

struct Model {
    name: String,
    tree: std::sync::Arc<Vdb543<f32>>,
    level_set: bool,
    active: CoordBox,
    active_voxels: u64,
}

fn load(path: &Path) -> Result<Model, String> {
    let at = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let bytes = std::fs::read(path).map_err(|error| at(&error))?;
    let file = VdbFile::read(&bytes, &ReadOptions::default()).map_err(|error| at(&error))?;
    let grid = file
        .grids
        .into_iter()
        .find(|grid| matches!(grid.tree, AnyTree::Float(_)))
        .ok_or_else(|| at(&"has no grid of floats"))?;
    let AnyTree::Float(tree) = grid.tree else { unreachable!("chosen as such") };
    let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
    let active = tree.active_bbox().ok_or_else(|| at(&"has no active voxel"))?;
    let active_voxels = tree.active_voxel_count();
    Ok(Model { name, level_set: grid.class == GridClass::LevelSet, tree, active, active_voxels })
}

/// The peers' camera, in index space where voxel ijk is the cube from ijk to ijk + 1: at `dist` half
/// diagonals of the box of active voxels, 45° vertically.
fn view(model: &Model, packed: &PackedGrid, dist: f64, [width, height]: [u32; 2]) -> GpuRays {
    let min = model.active.min.as_dvec3();
    let max = model.active.max.as_dvec3() + 1.0;
    let center = (min + max) * 0.5;
    let back = DVec3::new(0.45, 0.35, 0.82).normalize();
    let eye = center + back * (max - min).length() * 0.5 * dist;
    let aspect = f64::from(width) / f64::from(height);
    let clip = DMat4::perspective_infinite_reverse_rh(45_f64.to_radians(), aspect, 0.1);
    let rays = ViewRays::new(clip).expect("a sound projection");
    let world_from_view = DAffine3::look_at_rh(eye, center, DVec3::Y).inverse();
    // The peers' voxels begin at their samples, ours lie around them.
    let offset = DVec3::splat(-packed.kind.lattice_origin());
    let world_from_index = DAffine3::from_translation(offset);
    let rays = LatticeRays::new(&rays, world_from_view, world_from_index, packed);
    GpuRays::from(&rays.expect("a camera near the grid"))
}

pub fn run(args: &Args) -> Result<(), String> {
    let gpu = Gpu::new().map_err(|error| error.to_string())?;
    eprintln!("adapter: {}", gpu.name());
    println!(
        "model,kind,variant,rays,width,height,dist,median_ms,min_ms,max_ms,mrays_per_s,hit_percent,\
         steps_per_ray,bytes,bytes_per_voxel,pack_ms,adapter"
    );
    for path in &args.files {
        let model = load(path)?;
        let kinds: Vec<(&str, &str, PackKind)> = if model.level_set {
            let of = |smooth: &bool| match smooth {
                true => ("smooth", "smooth_surface", PackKind::Smooth { iso: 0.0 }),
                false => ("voxels", "voxels", PackKind::Surface { iso: 0.0 }),
            };
            args.smooth.iter().map(of).collect()
        } else {
            vec![("fog", "fog", PackKind::Fog)]
        };
        for (kind, entry, pack_kind) in kinds {
            let start = Instant::now();
            let packed = PackedGrid::new(&model.tree, pack_kind).map_err(|e| e.to_string())?;
            let pack_ms = start.elapsed().as_secs_f64() * 1e3;
            let grid = GpuGrid::new(&gpu, &packed);
            for variant in &args.variants {
                for &shuffled in &args.shuffled {
                    let mut defs: Vec<&str> = variant.iter().map(String::as_str).collect();
                    if shuffled {
                        defs.push("SHUFFLED");
                    }
                    let source = include_str!("bench.wgsl");
                    let kernel = gpu.kernel(source, entry, &defs);
                    defs.push("COUNT_STEPS");
                    let counting = gpu.kernel(source, entry, &defs);
                    let beams = defs.contains(&"BEAMS").then(|| gpu.kernel(source, "beams", &defs));
                    for &size in &args.sizes {
                        for &dist in &args.dists {
                            let picture = Picture { gpu: &gpu, model: &model, packed: &packed };
                            let line = picture.measure(
                                args,
                                &grid,
                                (&kernel, &counting, beams.as_ref()),
                                size,
                                dist,
                            )?;
                            println!(
                                "{},{kind},{},{},{}",
                                model.name,
                                variant.join("+"),
                                if shuffled { "shuffled" } else { "primary" },
                                line.replace("PACK", &format!("{pack_ms:.1}"))
                            );
                        }
                    }
                }
            }
        }
    }
    Ok(())
}

struct Picture<'a> {
    gpu: &'a Gpu,
    model: &'a Model,
    packed: &'a PackedGrid,
}

impl Picture<'_> {
    fn measure(
        &self,
        args: &Args,
        grid: &GpuGrid,
        (kernel, counting, beams): (&Kernel, &Kernel, Option<&Kernel>),
        [width, height]: [u32; 2],
        dist: f64,
    ) -> Result<String, String> {
        let (gpu, model) = (self.gpu, self.model);
        let rays = view(model, self.packed, dist, [width, height]);
        let pixels = u64::from(width) * u64::from(height);
        // `t` counts along the view's axis; the peers' density is per voxel along the ray. Rays in
        // the middle of the picture have the same, and the figure is a time, not a picture.
        let setup = Setup {
            size: [width, height],
            bits: pixels.next_power_of_two().trailing_zeros(),
            density_scale: DENSITY_SCALE,
        };
        let setup = gpu.uniform(bytemuck::bytes_of(&setup));
        let view = gpu.uniform(bytemuck::bytes_of(&rays));
        let out = gpu.output(pixels * 4);
        let normals = gpu.output(pixels * 16);
        let mut buffers = grid.bindings();
        let groups = [width.div_ceil(8), height.div_ceil(8), 1];
        let starts = gpu.output(u64::from(groups[0]) * u64::from(groups[1]) * 4);
        buffers.extend([(4, &setup), (5, &view), (6, &out), (7, &normals), (8, &starts)]);
        let beam_groups = [groups[0].div_ceil(8), groups[1].div_ceil(8), 1];
        if let Some(beams) = beams {
            gpu.run(beams, &buffers, beam_groups);
        }
        gpu.run(counting, &buffers, groups);
        let steps: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.read(&out, pixels * 4));
        let steps = steps.iter().map(|&steps| f64::from(steps)).sum::<f64>() / pixels as f64;
        let mut times = if gpu.has_timestamps() {
            let step = |kernel, groups| Step { kernel, buffers: &buffers[..], groups };
            let mut passes = Vec::new();
            passes.extend(beams.map(|beams| step(beams, Groups::Given(beam_groups))));
            passes.push(step(kernel, Groups::Given(groups)));
            let mut warm = 0.0;
            while warm < WARM_UP {
                warm += gpu.time(&passes, 20).iter().sum::<f64>();
            }
            gpu.time(&passes, args.runs)
        } else {
            return Err("the adapter has no timestamps".into());
        };
        times.sort_by(f64::total_cmp);
        let values: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.read(&out, pixels * 4));
        let is_hit = |&&value: &&f32| if model.level_set { value >= 0.0 } else { value < 0.999 };
        let hits = values.iter().filter(is_hit).count();
        if let Some(dir) = &args.dump {
            let name = format!("{}_{width}x{height}_{dist:.1}.f32", model.name);
            std::fs::create_dir_all(dir).map_err(|error| error.to_string())?;
            std::fs::write(dir.join(name), bytemuck::cast_slice(&values))
                .map_err(|error| error.to_string())?;
        }
        let median = times[times.len() / 2];
        Ok(format!(
            "{width},{height},{dist:.1},{median:.4},{:.4},{:.4},{:.0},{:.1},{steps:.2},{},{:.3},PACK,{}",
            times[0],
            times[times.len() - 1],
            pixels as f64 / median / 1e3,
            100.0 * hits as f64 / pixels as f64,
            self.packed.bytes(),
            self.packed.bytes() as f64 / model.active_voxels as f64,
            gpu.name(),
        ))
    }
}
