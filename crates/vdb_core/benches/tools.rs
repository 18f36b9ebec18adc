//! Tools beside OpenVDB's: time, peak memory, and how far the results differ.
//!
//! `scripts/bench-tools` builds the other side and starts this. Rounds of both alternate, each in a
//! process of its own, so that both see the same machine.

mod judge;

use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use glam::{DAffine3, DMat3};
use judge::Judgement;
use vdb_core::tools::{
    CsgOperation, Filter, FogFromLevelSet, LevelSetToMesh, MeshToLevelSet, Offset, Redistance,
    Resample, Smooth, csg, fog_from_level_set, level_set_to_mesh, mesh_to_level_set, offset,
    redistance, resample, smooth,
};
use vdb_core::{AnyTree, Grid, Transform, VdbFile, WriteOptions};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// How much larger the voxels are that level sets are resampled to.
const COARSER: f64 = 1.5;

/// Processes of each side for each row, of one run each, unless `ROUNDS` says how many.
const ROUNDS: usize = 3;

fn rounds() -> Result<usize> {
    Ok(std::env::var("ROUNDS").ok().map(|own| own.parse()).transpose()?.unwrap_or(ROUNDS).max(1))
}

/// Whether a row is wanted: all of them, unless `TASKS` lists some, separated by commas.
fn is_wanted(task: &str) -> bool {
    std::env::var("TASKS").map_or(true, |tasks| tasks.split(',').any(|wanted| wanted == task))
}

fn main() -> Result<()> {
    // `cargo bench` adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["child", _, task, ref rest @ ..] => child(task, rest),
        [peer, folder, voxels, ref meshes @ ..] if !meshes.is_empty() => {
            println!("Medians of {} runs: seconds of all threads; peak memory in MB.", rounds()?);
            println!(
                "| work | ours | OpenVDB's | ratio | on the clock | memory | OpenVDB's | ratio |"
            );
            println!("|---|---|---|---|---|---|---|---|");
            let mut ratios = Vec::new();
            for mesh in meshes {
                for voxels in voxels.split(',') {
                    ratios.extend(compare(peer, Path::new(folder), mesh, voxels.parse()?)?);
                }
            }
            let mean = |which: usize| {
                let logarithms = ratios.iter().map(|row: &[f64; 3]| row[which].ln()).sum::<f64>();
                (logarithms / ratios.len() as f64).exp()
            };
            let [clock, cpu, memory] = [0, 1, 2].map(mean);
            println!("| geometric mean | | | {cpu:.2} | {clock:.2} | | | {memory:.2} |");
            Ok(())
        }
        _ => {
            println!("nothing measured; start this with scripts/bench-tools");
            Ok(())
        }
    }
}

/// A mesh as `benches/make_models.py` writes it: two counts, positions, indices.
fn mesh(path: &str) -> Result<(Vec<[f32; 3]>, Vec<[u32; 3]>)> {
    let bytes = std::fs::read(path)?;
    let words: Vec<[u8; 4]> = bytes.as_chunks().0.to_vec();
    let [vertices, triangles] = [0, 1].map(|i| u32::from_le_bytes(words[i]) as usize);
    let (positions, indices) = words[2..].split_at(3 * vertices);
    let triple = |three: &[[u8; 4]; 3]| three.map(f32::from_le_bytes);
    let corners = |three: &[[u8; 4]; 3]| three.map(u32::from_le_bytes);
    let positions = positions.as_chunks().0.iter().map(triple).collect();
    Ok((positions, indices.as_chunks().0.iter().take(triangles).map(corners).collect()))
}

fn read(path: &str) -> Result<Grid> {
    Ok(VdbFile::open(path)?.grids.pop().ok_or("no grid")?)
}

fn write(path: &Path, grid: &Grid) -> Result<()> {
    Ok(VdbFile::new(vec![grid.clone()]).save(path, &WriteOptions::default())?)
}

/// The transform that the fog is resampled to: turned, with voxels of the same size.
fn turned(size: f64) -> Result<Transform> {
    let turn = DMat3::from_rotation_y(0.3) * size;
    Ok(Transform::affine(DAffine3 { matrix3: turn, ..DAffine3::IDENTITY }).ok_or("no transform")?)
}

/// Does a task once.
fn child(task: &str, arguments: &[&str]) -> Result<()> {
    let mut mesh_made = None;
    let [inputs @ .., out] = arguments else { return Err("no arguments".into()) };
    let grids: Vec<Grid> = match task {
        "from-mesh" => Vec::new(),
        "to-mesh" => vec![read(out)?],
        _ => inputs.iter().map(|path| read(path)).collect::<Result<_>>()?,
    };
    let read_mesh = if task == "from-mesh" { Some(mesh(inputs[0])?) } else { None };
    let edge = grids.first().map_or(1.0, |grid| grid.transform.voxel_size().x);
    let smoothing = Smooth::new(Filter::Gaussian { width: 1 });
    let (start, before) = (Instant::now(), cpu_time()?);
    let made = match (task, &grids[..]) {
        ("from-mesh", _) => {
            let (positions, triangles) = read_mesh.as_ref().ok_or("no mesh")?;
            Some(mesh_to_level_set(positions, triangles, &MeshToLevelSet::new(out.parse()?))?)
        }
        ("to-mesh", [grid]) => {
            let AnyTree::Float(tree) = &grid.tree else { return Err("not floats".into()) };
            let options = LevelSetToMesh::default();
            mesh_made = Some(level_set_to_mesh(tree, &grid.transform, &options)?);
            None
        }
        ("csg", [a, b]) => Some(csg(a, b, CsgOperation::Union)?),
        ("redistance", [grid]) => Some(redistance(grid, &Redistance::default())?),
        ("resample", [grid]) => {
            Some(resample(grid, &Resample::with_voxel_size(grid, COARSER * edge)?)?)
        }
        ("resample-fog", [grid]) => Some(resample(grid, &Resample::new(turned(edge)?))?),
        ("offset", [grid]) => Some(offset(grid, &Offset::new(2.0 * edge))?),
        ("smooth" | "smooth-fog", [grid]) => Some(smooth(grid, &smoothing)?),
        ("fog", [grid]) => Some(fog_from_level_set(grid, &FogFromLevelSet::default())?),
        _ => return Err("no such task".into()),
    };
    println!("{} {}", start.elapsed().as_nanos(), cpu_time()? - before);
    black_box(mesh_made);
    if let Some(made) = made.filter(|_| task != "from-mesh") {
        write(Path::new(out), &made)?;
    }
    println!("{}", peak_memory()?);
    Ok(())
}

/// The peak memory, in kilobytes.
fn peak_memory() -> Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    Ok(peak.ok_or("no VmHWM")?.trim().trim_end_matches(" kB").parse()?)
}

/// Nanoseconds of all threads.
fn cpu_time() -> Result<u64> {
    let mut sum = 0;
    for thread in std::fs::read_dir("/proc/self/task")? {
        let times = std::fs::read_to_string(thread?.path().join("schedstat"))?;
        sum += times.split_whitespace().next().ok_or("no time")?.parse::<u64>()?;
    }
    Ok(sum)
}

/// Wall clock and processor time in seconds, and memory in MB.
fn measure(command: &mut Command) -> Result<[f64; 3]> {
    let output = command.output()?;
    if !output.status.success() {
        return Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let text = String::from_utf8(output.stdout)?;
    let numbers: Vec<f64> =
        text.split_whitespace().map(str::parse).collect::<std::result::Result<_, _>>()?;
    let [clock, cpu, peak] = numbers[..] else { return Err("three numbers expected".into()) };
    Ok([clock / 1e9, cpu / 1e9, peak / 1e3])
}

fn median(mut samples: Vec<[f64; 3]>, which: usize) -> f64 {
    samples.sort_by(|a, b| a[which].total_cmp(&b[which]));
    samples[samples.len() / 2][which]
}

/// All tasks for one mesh at one size. Returns the ratios of each: on the clock, of all threads, and of
/// memory.
fn compare(peer: &str, folder: &Path, mesh_path: &str, voxels: u32) -> Result<Vec<[f64; 3]>> {
    let file = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let [one, other, fog] = ["one.vdb", "other.vdb", "fog.vdb"].map(file);
    let size = inputs(mesh_path, voxels, [&one, &other, &fog])?;
    let name = Path::new(mesh_path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let results = ["ours.vdb", "theirs.vdb"].map(file);
    let number = size.to_string();
    // Whose results are compared, in which unit.
    let tasks: [(&str, &[&String], Option<f64>); 10] = [
        ("from-mesh", &[&mesh_path.to_owned(), &number], None),
        ("to-mesh", &[&one], None),
        ("csg", &[&one, &other], Some(size)),
        ("redistance", &[&one], Some(size)),
        ("resample", &[&one], Some(size)),
        ("resample-fog", &[&fog], Some(1.0)),
        ("offset", &[&one], Some(size)),
        ("smooth", &[&one], Some(size)),
        ("smooth-fog", &[&fog], Some(1.0)),
        ("fog", &[&one], Some(1.0)),
    ];
    let own = std::env::current_exe()?;
    let mut ratios = Vec::new();
    for (task, arguments, unit) in tasks.into_iter().filter(|(task, ..)| is_wanted(task)) {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        let with = |result: &String| {
            let mut all: Vec<String> = arguments.iter().map(|&argument| argument.clone()).collect();
            all.extend(unit.map(|_| result.clone()));
            all
        };
        for _ in 0..rounds()? {
            let own_arguments = with(&results[0]);
            ours.push(measure(Command::new(&own).args(["child", "1", task]).args(own_arguments))?);
            theirs.push(measure(Command::new(peer).args(["1", task]).args(with(&results[1])))?);
        }
        let of = |which: usize| [median(ours.clone(), which), median(theirs.clone(), which)];
        let each: Vec<[f64; 3]> =
            ours.iter().zip(&theirs).map(|(a, b)| [0, 1, 2].map(|i| a[i] / b[i])).collect();
        let ratio = [0, 1, 2].map(|which| median(each.clone(), which));
        let ([cpu, memory], [on_clock, of_all, of_memory]) = ([of(1), of(2)], ratio);
        println!(
            "| {task}, {name} at {voxels} | {:.2} | {:.2} | {of_all:.2} | {on_clock:.2} | {:.0} | \
             {:.0} | {of_memory:.2} |",
            cpu[0], cpu[1], memory[0], memory[1],
        );
        ratios.push(ratio);
        if let Some(unit) = unit {
            differences(task, &results, unit)?;
            match task {
                "redistance" => judge(task, &one, &results, 1.0)?,
                "resample" => judge(task, &one, &results, COARSER)?,
                _ => (),
            }
        }
    }
    Ok(ratios)
}

/// Writes the grids that the tasks work on; returns the size of a voxel.
fn inputs(mesh_path: &str, voxels: u32, [one, other, fog]: [&String; 3]) -> Result<f64> {
    let (mut positions, triangles) = mesh(mesh_path)?;
    let options = MeshToLevelSet::with_voxels(&positions, voxels);
    let size = options.voxel_size;
    let solid = mesh_to_level_set(&positions, &triangles, &options)?;
    write(Path::new(one), &solid)?;
    write(Path::new(fog), &fog_from_level_set(&solid, &FogFromLevelSet::default())?)?;
    positions.iter_mut().for_each(|p| p[0] += (f64::from(voxels) / 20.0 * size) as f32);
    write(Path::new(other), &mesh_to_level_set(&positions, &triangles, &options)?)?;
    Ok(size)
}

/// Prints how far two results differ, in a unit, where ours is active.
fn differences(task: &str, [ours, theirs]: &[String; 2], unit: f64) -> Result<()> {
    let (ours, theirs) = (read(ours)?, read(theirs)?);
    let (AnyTree::Float(ours), AnyTree::Float(theirs)) = (&ours.tree, &theirs.tree) else {
        return Err("not floats".into());
    };
    let mut accessor = theirs.accessor();
    let (mut sum, mut most, mut count, mut signs) = (0.0_f64, 0.0_f64, 0_u64, 0_u64);
    for own in ours.active_values() {
        let other = accessor.get(own.origin);
        let difference = f64::from((own.value - other).abs()) / unit;
        (sum, most, count) = (sum + difference, most.max(difference), count + 1);
        signs += u64::from((own.value < 0.0) != (other < 0.0));
    }
    eprintln!(
        "{task}: {count} active values differ from OpenVDB's by {:.1e} on average, at most \
         {most:.1e}; {signs} signs",
        sum / count as f64
    );
    Ok(())
}

/// Prints which of two level sets is nearer to the truth, where they differ by more than a voxel. A
/// voxel of theirs is `coarser` times as large as one of the input.
fn judge(task: &str, input: &str, [ours, theirs]: &[String; 2], coarser: f64) -> Result<()> {
    let grids = (read(input)?, read(ours)?, read(theirs)?);
    let (AnyTree::Float(input), AnyTree::Float(ours), AnyTree::Float(theirs)) =
        (&grids.0.tree, &grids.1.tree, &grids.2.tree)
    else {
        return Err("not floats".into());
    };
    let edge = grids.1.transform.voxel_size().x;
    let band = f64::from(ours.background()) / edge;
    let (mut own, mut other) = (ours.accessor(), theirs.accessor());
    let mut judgement = Judgement::default();
    let all = ours.active_values().map(|voxel| voxel.origin);
    let mut visited = ours.accessor();
    let more = theirs.active_values().map(|voxel| voxel.origin);
    for ijk in all.chain(more.filter(|ijk| !visited.probe(*ijk).1)) {
        let values = [own.get(ijk), other.get(ijk)].map(|value| f64::from(value) / edge);
        if (values[0] - values[1]).abs() > 1.0 {
            let truth = judge::distance(input, ijk.as_dvec3() * coarser, band * coarser) / coarser;
            judgement.add(ijk, values, truth);
        }
    }
    judgement.show(task);
    Ok(())
}
