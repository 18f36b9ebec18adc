//! A flight over a terrain of pages: from the horizon of more than 10⁹ voxels down to single ones.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use bevy::camera::Hdr;
use bevy::math::{DAffine3, DVec2, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::pages::{FunctionSource, PageOptions, PageSource, cook_pages};
use bevy_vdb::vdb_core::synth::level_set;
use bevy_vdb::vdb_core::tree::{CoordBox, Vdb543};
use bevy_vdb::vdb_core::{Error, display::escaped};

use crate::studio::{Studio, WARM};
use crate::{Args, png_file, print_heading, summary};

/// Edges of the terrain and of its pages in voxels: a terrain that fits into memory as a whole, too, and a large one.
const EDGES: [(i32, u32); 3] = [(3_840, 256), (3_840, 512), (10_240, 256)];
/// Voxels of the terrain below the lowest valley.
const DEPTH: i32 = 40;
/// Stops of the flight at which times are compared.
const STOPS: usize = 12;
/// The file that lists the pages of a terrain.
const INDEX: &str = "terrain.vdbpages";
/// The memory of a paged terrain, in bytes.
const BYTES: u64 = 512 << 20;

pub fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::with_frames_and_gpu_times(args.size)?;
    studio.camera_mut().insert((Hdr, Msaa::Off));
    print_heading(&studio, "Pages", args.size);
    let is_asked = |edge: i32| args.scene.as_ref().is_none_or(|scene| *scene == edge.to_string());
    for (edge, page) in EDGES.into_iter().filter(|(edge, _)| is_asked(*edge)) {
        let folder = args.out.join(format!("terrain_{edge}_{page}"));
        let index = folder.join(INDEX);
        // The index is written last.
        let is_reused = args.keeps_pages && index.exists();
        if is_reused {
            println!(
                "\nA smooth terrain of {edge}² voxels in pages of {page}³, as cooked before.\n"
            );
        } else {
            cook(&folder, edge, page)?;
        }
        let world = World { edge, index, is_reused };
        let result = fly(&mut studio, args, &world);
        if !args.keeps_pages {
            fs::remove_dir_all(&folder).map_err(|error| error.to_string())?;
        }
        result?;
    }
    Ok(())
}

/// The height of the terrain above a point of the plane, in voxels: eight octaves of hills, with a slope of at most
/// 1.6.
fn height(at: DVec2) -> f64 {
    static TURNS: LazyLock<[DVec2; 8]> =
        LazyLock::new(|| std::array::from_fn(|octave| DVec2::from_angle(1.1 * octave as f64)));
    let (mut wave, mut sum) = (2_600.0, 0.0);
    for turn in &*TURNS {
        let turned = turn.rotate(at) / wave;
        sum += 0.12 * wave * turned.x.sin() * (1.3 * turned.y + wave).cos();
        wave *= 0.5;
    }
    sum
}

/// A conservative signed distance from the terrain, in voxels.
fn distance(at: DVec3) -> f64 {
    // √(1 + 1.6²) is below 1.9.
    (at.y - height(DVec2::new(at.x, at.z))) / 1.9
}

/// The corners of a terrain, in voxels.
fn bounds(edge: i32) -> [IVec3; 2] {
    [IVec3::new(0, -700 - DEPTH, 0), IVec3::new(edge, 700, edge)]
}

/// Pages of a terrain on disk.
struct World {
    edge: i32,
    index: PathBuf,
    /// Whether an earlier process has cooked them.
    is_reused: bool,
}

/// Counts the active voxels of the finest level.
struct Counted<F> {
    terrain: FunctionSource<F>,
    voxels: AtomicU64,
}

impl<F: Fn(DVec3) -> f64 + Sync> PageSource for Counted<F> {
    fn name(&self) -> &str {
        self.terrain.name()
    }

    fn kind(&self) -> PackKind {
        self.terrain.kind()
    }

    fn world_from_index(&self) -> DAffine3 {
        self.terrain.world_from_index()
    }

    fn levels(&self) -> u32 {
        self.terrain.levels()
    }

    fn pages(&self, level: u32, edge: u32, kind: PackKind) -> Result<Vec<IVec3>, Error> {
        self.terrain.pages(level, edge, kind)
    }

    fn samples(&self, level: u32, bounds: CoordBox) -> Result<Vdb543<f32>, Error> {
        let tree = self.terrain.samples(level, bounds)?;
        if level == 0 {
            self.voxels.fetch_add(tree.active_voxel_count(), Ordering::Relaxed);
        }
        Ok(tree)
    }
}

fn cook(folder: &Path, edge: i32, page: u32) -> Result<(), String> {
    let failed = |error: &dyn std::fmt::Display| {
        format!("{}: {error}", escaped(&folder.display().to_string()))
    };
    let corners = bounds(edge).map(|corner| corner.as_dvec3());
    let terrain = FunctionSource::new("terrain", DAffine3::IDENTITY, corners, distance);
    let source = Counted { terrain, voxels: AtomicU64::new(0) };
    let options = PageOptions { edge: page, smooth: true, ..PageOptions::default() };
    let start = Instant::now();
    let index = cook_pages(&source, &options, &|id, bytes| {
        let path = folder.join(id.file());
        fs::create_dir_all(path.parent().unwrap_or(folder))?;
        fs::write(path, bytes)
    });
    let index = index.map_err(|error| failed(&error))?;
    index.save(folder.join(INDEX)).map_err(|error| failed(&error))?;
    let mebibytes = |of: fn(&(u64, u64)) -> u64| -> f64 {
        let pages = index.pages.values().map(|page| (page.packed_bytes, page.file_bytes));
        pages.map(|page| of(&page)).sum::<u64>() as f64 / f64::from(1 << 20)
    };
    println!(
        "\nA smooth terrain of {edge}² voxels: {:.0} million active voxels (with the borders that pages share) in {} pages of {page}³ in {} levels, \
         {:.0} MiB on disk and {:.0} MiB on the GPU with all pages loaded; cooked in {:.0} s.\n",
        source.voxels.load(Ordering::Relaxed) as f64 / 1e6,
        index.pages.len(),
        index.levels,
        mebibytes(|page| page.1),
        mebibytes(|page| page.0),
        start.elapsed().as_secs_f64()
    );
    Ok(())
}

impl World {
    /// The camera after a part of the flight, from 0 to 1: from high above to a few voxels over the ground.
    fn view(&self, part: f64) -> Transform {
        let edge = f64::from(self.edge);
        let (at, above, eye) = self.place(part);
        let ahead = at + DVec2::new(0.02 * (6.0 * part).sin(), 0.05) * edge;
        let target = DVec3::new(ahead.x, height(at) + 0.3 * above, ahead.y);
        Transform::from_translation(eye.as_vec3()).looking_at(target.as_vec3(), Vec3::Y)
    }

    /// The same, but looking down, so that the terrain fills the picture.
    fn view_down(&self, part: f64) -> Transform {
        let (.., eye) = self.place(part);
        Transform::from_translation(eye.as_vec3()).looking_to(Vec3::new(0.1, -1.0, 0.2), Vec3::Z)
    }

    /// Where the camera is: the point below it in the plane, the voxels above the ground, and the eye.
    fn place(&self, part: f64) -> (DVec2, f64, DVec3) {
        let edge = f64::from(self.edge);
        let at = DVec2::new(0.5, 0.15 + 0.6 * part) * edge;
        let above = 0.12 * edge * (1.0 - part).powi(3) + 6.0;
        (at, above, DVec3::new(at.x, height(at) + above, at.y))
    }
}

fn fly(studio: &mut Studio, args: &Args, world: &World) -> Result<(), String> {
    studio.camera_mut().insert(Projection::Perspective(PerspectiveProjection {
        near: 1.0,
        far: 4.0 * world.edge as f32,
        ..default()
    }));
    let rss_before = resident_mib();
    let mut rss = None;
    let assets = studio.app.world().resource::<AssetServer>().clone();
    let terrain = VdbPagedVolume {
        max_bytes: BYTES,
        ..VdbPagedVolume::new(assets.load(world.index.clone()))
    };
    let terrain = studio.app.world_mut().spawn(terrain).id();
    studio.view = Some(world.view(0.0));
    complete(studio, terrain)?;
    println!(
        "| frames | frame, ms: median | 99 % | longest | passes, ms: median | 99 % | pages displayed | MiB | most missing | frames with pages missing |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut passes = Vec::new();
    let (mut missing, mut incomplete, mut bytes, mut displayed) = (0, 0, 0, 0);
    let mut frame = 0;
    let mut times = studio.frames_after(args.frames, |studio| {
        studio.view = Some(world.view(frame as f64 / args.frames as f64));
        frame += 1;
        passes.extend(studio.passes_ms());
        let status = status(studio, terrain);
        missing = missing.max(status.missing);
        incomplete += u32::from(status.missing > 0);
        (bytes, displayed) = (bytes.max(status.bytes), displayed.max(status.displayed));
        if frame % 50 == 1 {
            rss = rss.max(resident_mib());
        }
    });
    let ([median, _, late], longest) =
        (summary(&mut times), times.last().copied().unwrap_or_default());
    let [pass, _, late_pass] = summary(&mut passes);
    println!(
        "| {} | {median:.2} | {late:.2} | {longest:.2} | {pass:.2} | {late_pass:.2} | {displayed} | {} | {missing} | {incomplete} |",
        args.frames,
        bytes >> 20
    );
    if world.is_reused
        && let (Some(before), Some(most)) = (rss_before, rss)
    {
        println!(
            "\nThe process has at most {most} MiB of memory on the CPU, {before} before it loads the terrain."
        );
    }
    count_holes(studio, args, world)?;
    if args.writes_pictures {
        write_pictures(studio, args, world, terrain)?;
    }
    let limited = stops(studio, world, |studio| complete(studio, terrain))?;
    set_bytes(studio, terrain, u64::MAX);
    let unlimited = stops(studio, world, |studio| complete(studio, terrain))?;
    let all = status(studio, terrain).bytes >> 20;
    studio.app.world_mut().despawn(terrain);
    studio.frames(2);
    print_stops(["within 512 MiB", &format!("without limit ({all} MiB)")], &limited, &unlimited);
    if world.edge == EDGES[0].0 {
        let [min, max] = bounds(world.edge);
        let tree = level_set::from_distance(CoordBox { min, max }, distance);
        let grid = studio.grid(tree, PackKind::Smooth { iso: 0.0 }, 1.0)?;
        let whole = studio.app.world_mut().spawn(VdbVolume(grid)).id();
        for (detail, name) in [(0.0, "whole grid"), (1.0, "whole grid with levels of detail")] {
            studio.camera_mut().insert(VdbQuality { detail, ..default() });
            studio.view = Some(world.view(0.0));
            // Levels are made in the background.
            let end =
                Instant::now() + std::time::Duration::from_secs(if detail > 0.0 { 60 } else { 0 });
            while Instant::now() < end {
                studio.frames(1);
            }
            let own = stops(studio, world, |_| Ok(()))?;
            print_stops(["pages", name], &limited, &own);
        }
        studio.app.world_mut().despawn(whole);
        studio.camera_mut().insert(VdbQuality::default());
    }
    studio.view = None;
    Ok(())
}

/// Flies over the terrain again, looking down, and counts the pixels that show no terrain.
fn count_holes(studio: &mut Studio, args: &Args, world: &World) -> Result<(), String> {
    // No terrain is magenta.
    let set_background = |studio: &mut Studio, color: ClearColorConfig| {
        if let Some(mut camera) = studio.camera_mut().get_mut::<Camera>() {
            camera.clear_color = color;
        }
    };
    set_background(studio, ClearColorConfig::Custom(Color::srgb(1.0, 0.0, 1.0)));
    studio.view = Some(Transform::from_xyz(0.0, 1e6, 0.0).looking_to(Vec3::Y, Vec3::Z));
    let behind = studio.picture()?;
    let (mut holes, mut worst) = (0, 0);
    for frame in 0..args.frames {
        studio.view = Some(world.view_down(frame as f64 / args.frames as f64));
        let picture = studio.picture()?;
        let pixels = picture.chunks_exact(4).zip(behind.chunks_exact(4));
        let own = pixels.filter(|(pixel, behind)| pixel == behind).count();
        (holes, worst) = (holes + own, worst.max(own));
    }
    set_background(studio, ClearColorConfig::Default);
    println!(
        "\nLooking down, {holes} pixels of {} frames show no terrain, and at most {worst} of one frame.",
        args.frames
    );
    Ok(())
}

/// Writes a picture of each stop, with all pages that it needs.
fn write_pictures(
    studio: &mut Studio,
    args: &Args,
    world: &World,
    terrain: Entity,
) -> Result<(), String> {
    for stop in 0..STOPS {
        studio.view = Some(world.view(stop as f64 / (STOPS - 1) as f64));
        complete(studio, terrain)?;
        let picture = studio.picture()?;
        let pixels: Vec<_> =
            picture.chunks_exact(4).map(|rgba| [rgba[0], rgba[1], rgba[2]]).collect();
        png_file::write(&args.out.join(format!("stop_{stop:02}.png")), args.size, &pixels)?;
    }
    Ok(())
}

/// The memory of this process on the CPU, where the system says so in `/proc`.
fn resident_mib() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(resident.trim().trim_end_matches(" kB").parse::<u64>().ok()? >> 10)
}

fn status(studio: &Studio, terrain: Entity) -> VdbPagesStatus {
    studio.app.world().get::<VdbPagesStatus>(terrain).copied().unwrap_or_default()
}

fn set_bytes(studio: &mut Studio, terrain: Entity, max_bytes: u64) {
    if let Some(mut volume) = studio.app.world_mut().get_mut::<VdbPagedVolume>(terrain) {
        volume.max_bytes = max_bytes;
    }
}

/// Renders until all pages are there that the view needs.
fn complete(studio: &mut Studio, terrain: Entity) -> Result<(), String> {
    let start = Instant::now();
    studio.frames(2);
    while !status(studio, terrain).is_complete || status(studio, terrain).displayed == 0 {
        studio.frames(1);
        if start.elapsed().as_secs() > 120 {
            return Err(format!(
                "pages did not arrive within 120 s: {:?}",
                status(studio, terrain)
            ));
        }
    }
    Ok(())
}

/// The median times of all passes and of a frame at each stop of the flight, ms.
fn stops(
    studio: &mut Studio,
    world: &World,
    ready: impl Fn(&mut Studio) -> Result<(), String>,
) -> Result<Vec<[f64; 2]>, String> {
    (0..STOPS)
        .map(|stop| {
            studio.view = Some(world.view(stop as f64 / (STOPS - 1) as f64));
            ready(studio)?;
            studio.frames(WARM);
            let mut passes = Vec::new();
            let mut frames = studio.frames_after(30, |studio| passes.extend(studio.passes_ms()));
            let passes = if passes.is_empty() { 0.0 } else { summary(&mut passes)[0] };
            Ok([passes, summary(&mut frames)[0]])
        })
        .collect()
}

/// Prints times at the stops, and the ratios of passes.
fn print_stops(what: [&str; 2], own: &[[f64; 2]], other: &[[f64; 2]]) {
    let [name, other_name] = what;
    println!("\nAt {STOPS} stops of the flight, ms.\n");
    let row = |name: &str, values: Vec<String>| println!("| {name} | {} |", values.join(" | "));
    let times = |all: &[[f64; 2]], i: usize| all.iter().map(|ms| format!("{:.2}", ms[i])).collect();
    row("", (0..STOPS).map(|stop| format!("{stop}")).collect());
    row("---", vec!["---".into(); STOPS]);
    row(&format!("passes, {name}"), times(own, 0));
    row(&format!("passes, {other_name}"), times(other, 0));
    row("ratio", own.iter().zip(other).map(|(a, b)| format!("{:.2}", a[0] / b[0])).collect());
    row(&format!("frames, {name}"), times(own, 1));
    row(&format!("frames, {other_name}"), times(other, 1));
}
