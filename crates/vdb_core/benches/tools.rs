//! Tools beside OpenVDB's: time, peak memory, and how far the results differ.
//!
//! `scripts/bench-tools` builds the other side and starts this. Rounds of both alternate, each in a
//! process of its own, so that both see the same machine.

use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use vdb_core::tools::{
    CsgOperation, LevelSetToMesh, MeshToLevelSet, Redistance, csg, level_set_to_mesh,
    mesh_to_level_set, redistance,
};
use vdb_core::{AnyTree, Grid, VdbFile, WriteOptions};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Processes of each side for each row, of one run each.
const ROUNDS: usize = 3;

fn main() -> Result<()> {
    // `cargo bench` adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["child", _, task, ref rest @ ..] => child(task, rest),
        [peer, folder, voxels, ref meshes @ ..] if !meshes.is_empty() => {
            println!("Median of {ROUNDS} runs; seconds of all threads; peak memory, MB.");
            println!(
                "| work | ours | OpenVDB's | ratio | on the clock | memory | OpenVDB's | ratio |"
            );
            println!("|---|---|---|---|---|---|---|---|");
            for mesh in meshes {
                for voxels in voxels.split(',') {
                    compare(peer, Path::new(folder), mesh, voxels.parse()?)?;
                }
            }
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

/// Does a task once.
fn child(task: &str, arguments: &[&str]) -> Result<()> {
    let (start, before);
    let made: Option<Grid>;
    match (task, arguments) {
        ("from-mesh", [path, size]) => {
            let ((positions, triangles), options) =
                (mesh(path)?, MeshToLevelSet::new(size.parse()?));
            (start, before) = (Instant::now(), cpu_time()?);
            made = Some(mesh_to_level_set(&positions, &triangles, &options)?);
        }
        ("to-mesh", [path]) => {
            let grid = read(path)?;
            let AnyTree::Float(tree) = &grid.tree else { return Err("not floats".into()) };
            (start, before) = (Instant::now(), cpu_time()?);
            black_box(level_set_to_mesh(tree, &grid.transform, &LevelSetToMesh::default())?);
            made = None;
        }
        ("csg", [a, b, _]) => {
            let (a, b) = (read(a)?, read(b)?);
            (start, before) = (Instant::now(), cpu_time()?);
            made = Some(csg(&a, &b, CsgOperation::Union)?);
        }
        ("redistance", [path, _]) => {
            let grid = read(path)?;
            (start, before) = (Instant::now(), cpu_time()?);
            made = Some(redistance(&grid, &Redistance::default())?);
        }
        _ => return Err("no such task".into()),
    }
    println!("{} {}", start.elapsed().as_nanos(), cpu_time()? - before);
    if let (Some(made), ["csg", .., out] | ["redistance", _, out]) =
        (&made, &[&[task], arguments].concat()[..])
    {
        write(Path::new(out), made)?;
    }
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    println!("{}", peak.ok_or("no VmHWM")?.trim().trim_end_matches(" kB"));
    Ok(())
}

/// Nanoseconds of all threads, in steps of 10 ms.
fn cpu_time() -> Result<u64> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let fields = stat.rsplit(')').next().ok_or("no fields")?.split_whitespace();
    let ticks: u64 = fields.skip(11).take(2).map(|ticks| ticks.parse().unwrap_or(0)).sum();
    Ok(ticks * 10_000_000)
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

/// All tasks for one mesh at one size.
fn compare(peer: &str, folder: &Path, mesh_path: &str, voxels: u32) -> Result<()> {
    let (mut positions, triangles) = mesh(mesh_path)?;
    let options = MeshToLevelSet::with_voxels(&positions, voxels);
    let size = options.voxel_size;
    let file = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let [one, other] = [file("one.vdb"), file("other.vdb")];
    write(Path::new(&one), &mesh_to_level_set(&positions, &triangles, &options)?)?;
    positions.iter_mut().for_each(|p| p[0] += (voxels as f64 / 20.0 * size) as f32);
    write(Path::new(&other), &mesh_to_level_set(&positions, &triangles, &options)?)?;
    let name = Path::new(mesh_path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let results = [file("ours.vdb"), file("theirs.vdb")];
    let tasks: [(&str, Vec<String>, bool); 4] = [
        ("from-mesh", vec![mesh_path.into(), size.to_string()], false),
        ("to-mesh", vec![one.clone()], false),
        ("csg", vec![one.clone(), other], true),
        ("redistance", vec![one], true),
    ];
    let own = std::env::current_exe()?;
    for (task, arguments, has_result) in tasks {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        let with = |result: &String| {
            let mut all = arguments.clone();
            all.extend(has_result.then(|| result.clone()));
            all
        };
        for _ in 0..ROUNDS {
            let own_arguments = with(&results[0]);
            ours.push(measure(Command::new(&own).args(["child", "1", task]).args(own_arguments))?);
            theirs.push(measure(Command::new(peer).args(["1", task]).args(with(&results[1])))?);
        }
        let of = |which: usize| [median(ours.clone(), which), median(theirs.clone(), which)];
        let ([clock, cpu, memory], ratio) = ([of(0), of(1), of(2)], |[a, b]: [f64; 2]| a / b);
        println!(
            "| {task}, {name} at {voxels} | {:.2} | {:.2} | {:.2} | {:.2} | {:.0} | {:.0} | {:.2} |",
            cpu[0],
            cpu[1],
            ratio(cpu),
            ratio(clock),
            memory[0],
            memory[1],
            ratio(memory)
        );
        if has_result {
            differences(task, &results, size)?;
        }
    }
    Ok(())
}

/// Prints how far two results differ, in voxels, where ours is active.
fn differences(task: &str, [ours, theirs]: &[String; 2], size: f64) -> Result<()> {
    let (ours, theirs) = (read(ours)?, read(theirs)?);
    let (AnyTree::Float(ours), AnyTree::Float(theirs)) = (&ours.tree, &theirs.tree) else {
        return Err("not floats".into());
    };
    let mut accessor = theirs.accessor();
    let (mut sum, mut most, mut count, mut signs) = (0.0_f64, 0.0_f64, 0_u64, 0_u64);
    for own in ours.active_values() {
        let other = accessor.get(own.origin);
        let difference = f64::from((own.value - other).abs()) / size;
        (sum, most, count) = (sum + difference, most.max(difference), count + 1);
        signs += u64::from((own.value < 0.0) != (other < 0.0));
    }
    eprintln!(
        "{task}: {count} active values differ from OpenVDB's by {:.1e} voxels on average, at most \
         {most:.1e}; {signs} signs",
        sum / count as f64
    );
    Ok(())
}
