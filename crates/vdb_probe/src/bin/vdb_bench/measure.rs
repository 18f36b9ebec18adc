//! Timing of rays through models.

use std::path::{Path, PathBuf};
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use vdb_core::pack::{PackedGrid, ValueFormat};
use vdb_probe::judge::Scene;
use vdb_probe::{Gpu, GpuGrid, Kernel, Step};

use crate::args::{Args, Set};
use crate::camera::Camera;
use crate::chart::{self, Dot};
use crate::check::Check;
use crate::model::{Kind, Model, Source};
use crate::report::{Report, Row};
use crate::submission::Submission;
use crate::timing::Times;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Setup {
    size: [u32; 2],
    bits: u32,
    density_scale: f32,
}

/// Extinction per unit of density and voxel, the same as for the peers.
const DENSITY_SCALE: f32 = 0.1;

/// Does what the command line requests.
pub fn run(args: &Args) -> Result<(), String> {
    if let Some((drawing, tables)) = &args.draw {
        return draw(drawing, tables, &args.sets);
    }
    let gpu = Gpu::new().map_err(|error| error.to_string())?;
    if !gpu.has_timestamps() {
        return Err(format!(
            "{} has no timestamp queries, without which GPU times cannot be measured; use a driver \
             that has them (any Vulkan driver of a desktop GPU, Mesa's lavapipe)",
            gpu.name()
        ));
    }
    let mut report = Report::new(gpu.name(), args.out.as_deref())?;
    let of_report = args.report.as_ref().map(|_| Set::of_report(gpu.is_software()));
    let sets = of_report.as_ref().unwrap_or(&args.sets);
    let mut checks = args.report.is_some().then(Vec::new);
    // A model that fails must not prevent the others from being measured.
    let mut failed = Vec::new();
    for source in &args.models {
        if let Err(message) = measure_model(&gpu, args, sets, source, &mut report, checks.as_mut())
        {
            eprintln!("vdb_bench: {message}");
            failed.push(message);
        }
    }
    report.finish()?;
    let wrong = checks.iter().flatten().map(|check| check.tally.wrong).sum::<u64>();
    if let (Some(dir), Some(checks)) = (&args.report, &checks) {
        let submission = Submission::new(gpu.info(), report.rows(), checks, &failed);
        let path = dir.join("report.md");
        std::fs::write(&path, submission.markdown())
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    match (failed.len(), wrong) {
        (0, 0) => Ok(()),
        (0, wrong) => {
            Err(format!("{wrong} rays are WRONG on this adapter: please send the report"))
        }
        (failed, _) => Err(format!("{failed} of {} models failed, see above", args.models.len())),
    }
}

/// Draws a chart of tables from earlier measurements, including those of peers.
fn draw(drawing: &Path, tables: &[PathBuf], sets: &[Set]) -> Result<(), String> {
    let mut dots = Vec::new();
    for table in tables {
        dots.extend(Dot::read(table)?);
    }
    dots.retain(|dot| sets.iter().any(|set| set.sizes.contains(&dot.size)));
    if dots.is_empty() {
        return Err("the tables have no rows of these --sizes".into());
    }
    let adapters = chart::distinct(&dots, |dot| dot.adapter.clone());
    std::fs::write(drawing, chart::svg(&dots, &adapters.join(", ")))
        .map_err(|error| format!("{}: {error}", drawing.display()))
}

fn measure_model(
    gpu: &Gpu,
    args: &Args,
    sets: &[Set],
    source: &Source,
    report: &mut Report,
    mut checks: Option<&mut Vec<Check>>,
) -> Result<(), String> {
    let model = Model::new(source)?;
    let mut ways: Vec<(Kind, ValueFormat)> = Vec::new();
    for way in sets.iter().flat_map(|set| ways_of(set, &model)) {
        if !ways.contains(&way) {
            ways.push(way);
        }
    }
    for (kind, format) in ways {
        let subject = Subject::new(gpu, &model, kind, format)?;
        for set in sets.iter().filter(|set| ways_of(set, &model).contains(&(kind, format))) {
            subject.measure_set(args, set, report)?;
        }
        if let (Some(checks), Some(set)) = (checks.as_mut(), sets.first()) {
            checks.push(Check::new(gpu, &model, kind, &subject.scene, &set.cameras)?);
        }
    }
    Ok(())
}

/// The ways in which a set packs a model. Voxels have no samples, and therefore only one format.
fn ways_of(set: &Set, model: &Model) -> Vec<(Kind, ValueFormat)> {
    let kinds = model.kinds(&set.smooth).into_iter();
    let ways = kinds.flat_map(|kind| {
        let formats: &[ValueFormat] =
            if kind == Kind::Voxels { &[ValueFormat::Exact] } else { &set.formats };
        formats.iter().map(move |format| (kind, *format))
    });
    ways.collect()
}

/// A model on the GPU, packed for one kind of rendering.
struct Subject<'a> {
    gpu: &'a Gpu,
    model: &'a Model,
    kind: Kind,
    format: ValueFormat,
    scene: Scene<'a>,
    pack_ms: f64,
}

/// The kernels of a variant.
struct Kernels {
    variant: String,
    rays: &'static str,
    beams: Option<Kernel>,
    trace: Kernel,
    /// Writes the number of steps of each ray instead of its result.
    steps: Kernel,
}

impl Kernels {
    fn new(gpu: &Gpu, grid: &GpuGrid, kind: Kind, variant: &[String], shuffled: bool) -> Self {
        let source = include_str!("bench.wgsl");
        let of_grid = grid.defs();
        let mut defs: Vec<&str> = variant.iter().chain(&of_grid).map(String::as_str).collect();
        defs.extend(kind.def());
        defs.extend(shuffled.then_some("SHUFFLED"));
        let beams = defs.contains(&"BEAMS").then(|| gpu.kernel(source, "beams", &defs));
        let trace = gpu.kernel(source, "trace", &defs);
        defs.push("COUNT_STEPS");
        let steps = gpu.kernel(source, "trace", &defs);
        let rays = if shuffled { "shuffled" } else { "primary" };
        Self { variant: variant.join("+"), rays, beams, trace, steps }
    }
}

impl<'a> Subject<'a> {
    fn new(
        gpu: &'a Gpu,
        model: &'a Model,
        kind: Kind,
        format: ValueFormat,
    ) -> Result<Self, String> {
        let name = |error: &dyn std::fmt::Display| format!("{}: {error}", model.name);
        let start = Instant::now();
        let grid = PackedGrid::with_format(&model.tree, kind.pack(), format);
        let grid = grid.map_err(|error| name(&error))?;
        let pack_ms = start.elapsed().as_secs_f64() * 1e3;
        let (words, capacity) = (grid.words.len() as u64, GpuGrid::capacity(gpu));
        if words > capacity {
            return Err(format!(
                "{}: {} MB, but shaders on {} can access only {} MB; use a smaller model",
                model.name,
                (4 * words) >> 20,
                gpu.name(),
                (4 * capacity) >> 20
            ));
        }
        let on_gpu = GpuGrid::new(gpu, &grid);
        let scene = Scene { tree: &model.tree, grid, on_gpu };
        Ok(Self { gpu, model, kind, format, scene, pack_ms })
    }

    fn measure_set(&self, args: &Args, set: &Set, report: &mut Report) -> Result<(), String> {
        for (variant, &shuffled) in product(&set.variants, &set.shuffled) {
            let kernels = Kernels::new(self.gpu, &self.scene.on_gpu, self.kind, variant, shuffled);
            for (&size, camera) in product(&set.sizes, &set.cameras) {
                report.add(self.measure(args, &kernels, size, camera)?)?;
            }
        }
        Ok(())
    }

    /// Measures one image.
    fn measure(
        &self,
        args: &Args,
        kernels: &Kernels,
        size: [u32; 2],
        camera: &Camera,
    ) -> Result<Row, String> {
        let (gpu, model) = (self.gpu, self.model);
        let rays = camera
            .rays(model, &self.scene.grid, size)
            .map_err(|error| format!("{}: {error}", model.name))?;
        let pixels = size.iter().map(|&edge| u64::from(edge)).product::<u64>();
        if pixels * 16 > gpu.max_binding() {
            let [width, height] = size;
            return Err(format!("--sizes {width}x{height} is more than {} can write", gpu.name()));
        }
        let setup = Setup {
            size,
            bits: pixels.next_power_of_two().trailing_zeros(),
            density_scale: DENSITY_SCALE * (1 << model.level) as f32,
        };
        let setup = gpu.uniform(bytemuck::bytes_of(&setup));
        let view = gpu.uniform(bytemuck::bytes_of(&rays));
        let out = gpu.output(pixels * 4);
        let normals = gpu.output(pixels * 16);
        let tiles = size.map(|edge| edge.div_ceil(8));
        let starts = gpu.output(tiles.iter().map(|&edge| u64::from(edge)).product::<u64>() * 4);
        let mut buffers = self.scene.on_gpu.bindings();
        buffers.extend([(4, &setup), (5, &view), (6, &out), (7, &normals), (8, &starts)]);

        let groups = [tiles[0], tiles[1].div_ceil(2), 1];
        let mut passes: Vec<Step> = Vec::new();
        let beam_groups = [tiles[0].div_ceil(8), tiles[1].div_ceil(8), 1];
        let beams = kernels.beams.as_ref();
        passes.extend(beams.map(|kernel| Step { kernel, buffers: &buffers, groups: beam_groups }));
        passes.push(Step { kernel: &kernels.trace, buffers: &buffers, groups });
        let times = Times::measure(gpu, &passes, args.runs);

        let values: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.read(&out, pixels * 4));
        let hits = values.iter().filter(|&&value| self.kind.is_hit(value)).count();
        let dist = camera.dist(model);
        if let Some(dir) = &args.dump {
            dump(dir, &model.name, size, dist, &values)?;
        }
        // After the timed runs, whose shared ray starts it reuses.
        gpu.run(&kernels.steps, &buffers, groups);
        let steps: Vec<f32> = bytemuck::pod_collect_to_vec(&gpu.read(&out, pixels * 4));
        let steps = steps.iter().map(|&steps| f64::from(steps)).sum::<f64>();

        Ok(Row {
            model: model.name.clone(),
            kind: self.kind.name(),
            format: match self.format {
                ValueFormat::Exact => "exact",
                ValueFormat::Full => "full",
                ValueFormat::Half => "half",
                ValueFormat::Byte => "byte",
            },
            variant: kernels.variant.clone(),
            rays: kernels.rays,
            size,
            dist,
            pixels,
            times,
            hits: hits as f64 / pixels as f64,
            steps: steps / pixels as f64,
            bytes: self.scene.grid.bytes(),
            active_voxels: model.active_voxels,
            pack_ms: self.pack_ms,
        })
    }
}

/// All pairs of elements.
fn product<'a, A, B>(a: &'a [A], b: &'a [B]) -> impl Iterator<Item = (&'a A, &'a B)> {
    a.iter().flat_map(move |a| b.iter().map(move |b| (a, b)))
}

fn dump(
    dir: &std::path::Path,
    model: &str,
    [width, height]: [u32; 2],
    dist: f64,
    values: &[f32],
) -> Result<(), String> {
    let path = dir.join(format!("{model}_{width}x{height}_{dist:.1}.f32"));
    std::fs::create_dir_all(dir)
        .and_then(|()| std::fs::write(&path, bytemuck::cast_slice(values)))
        .map_err(|error| format!("{}: {error}", path.display()))
}
