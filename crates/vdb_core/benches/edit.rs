//! What an edit of 100,000 voxels costs: `cargo bench -p vdb_core --bench edit [-- FILE.vdb …]`

use std::error::Error;
use std::time::Instant;

use glam::{DVec3, IVec3};
use vdb_core::pack::edit::{Changes, Editor, Voxel};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tree::{CoordBox, Node, Vdb543};
use vdb_core::{AnyTree, VdbFile};

/// Frames of each kind, the first ones left out: they pack everything.
const FRAMES: usize = 60;
const FIRST: usize = 10;
/// Voxels that a frame changes, about.
const VOXELS: usize = 100_000;
/// Of a ball of as many voxels.
const RADIUS: f32 = 28.8;

fn main() -> Result<(), Box<dyn Error>> {
    println!(
        "{} threads; medians of {FRAMES} frames: milliseconds to set the voxels, to commit them, and \
         KiB that the GPU is sent; the longest frame, and how many packed everything.",
        rayon::current_num_threads()
    );
    println!(
        "| grid | shown as | edit | voxels | set, ms | commit, ms | KiB | longest, ms | whole |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let smooth = PackKind::Smooth { iso: 0.0 };
    let voxels = PackKind::Surface { iso: 0.0 };
    let ball = level_set::sphere(DVec3::ZERO, 300.0);
    for kind in [voxels, smooth] {
        measure("ball, radius 300", &ball, kind);
    }
    measure("fog, radius 150", &fog::sphere(DVec3::ZERO, 150.0, 50.0), PackKind::Fog);
    // `cargo bench` adds an option of its own.
    for file in std::env::args().skip(1).filter(|a| a != "--bench") {
        for grid in VdbFile::open(&file)?.grids {
            let AnyTree::Float(tree) = &grid.tree else { continue };
            let kinds = match PackKind::suited(grid.class, tree) {
                PackKind::Fog => &[PackKind::Fog][..],
                _ => &[voxels, smooth],
            };
            for &kind in kinds {
                measure(&format!("{file} {}", grid.name), tree, kind);
            }
        }
    }
    Ok(())
}

fn measure(name: &str, tree: &Vdb543<f32>, kind: PackKind) {
    let leaves: Vec<IVec3> = tree.leaves().map(Node::origin).collect();
    // A chord of the grid's box through its middle, along which the ball goes.
    let Some(bounds) = tree.active_bbox() else { return };
    let unit = tree.background().abs().max(0.1) / 3.0;
    let go = |frame: usize| {
        let along = frame as f32 / FRAMES as f32;
        bounds.min + ((bounds.max - bounds.min).as_vec3() * along).as_ivec3()
    };
    let sphere = |at: IVec3, old: Voxel, ijk: IVec3| {
        let distance = ((ijk - at).as_vec3().length() - RADIUS) * unit;
        let value = match kind {
            PackKind::Fog => old.value.max((-distance).clamp(0.0, 1.0)),
            _ => old.value.min(distance.clamp(-3.0 * unit, 3.0 * unit)),
        };
        Voxel { value, active: old.active || value != old.value }
    };
    let mut random = Random::new(1);
    run(name, "moving ball", tree, kind, |editor, tree, frame| {
        // The ball goes on: what it leaves becomes what it was.
        let (old, at) = (go(frame.saturating_sub(1)), go(frame));
        let around = |at: IVec3| CoordBox { min: at - 32, max: at + 32 };
        let background = tree.background();
        let empty =
            Voxel { value: if kind == PackKind::Fog { 0.0 } else { background }, active: false };
        let mut edit = editor.edit(tree);
        edit.update(around(old), |ijk, was| {
            let inside = (ijk - old).as_vec3().length() < RADIUS + 3.0;
            if inside { empty } else { was }
        });
        edit.update(around(at), |ijk, old| sphere(at, old, ijk));
    });
    run(name, "scattered", tree, kind, |editor, tree, _| {
        let mut edit = editor.edit(tree);
        for _ in 0..VOXELS {
            let leaf = leaves[random.below(leaves.len() as u64) as usize];
            let mut axis = || random.below(8) as i32;
            let at = leaf + IVec3::new(axis(), axis(), axis());
            edit.set(at, -edit.get(at));
        }
    });
}

fn run(
    name: &str,
    edit_name: &str,
    tree: &Vdb543<f32>,
    kind: PackKind,
    mut edit: impl FnMut(&mut Editor, &mut Vdb543<f32>, usize),
) {
    let (mut tree, mut editor) = (tree.clone(), Editor::default());
    let mut packed = PackedGrid::new(&tree, kind).expect("the grid can be packed");
    let (mut set, mut commit, mut kib, mut longest, mut whole) =
        (Vec::new(), Vec::new(), Vec::new(), 0.0_f64, 0);
    for frame in 0..FIRST + FRAMES {
        let start = Instant::now();
        edit(&mut editor, &mut tree, frame.saturating_sub(FIRST));
        let has_set = start.elapsed().as_secs_f64() * 1e3;
        let changes = editor.commit(&tree, &mut packed).expect("the grid can be packed");
        let all = start.elapsed().as_secs_f64() * 1e3;
        if frame < FIRST {
            continue;
        }
        let words = match changes {
            Changes::All => {
                whole += 1;
                packed.words.len()
            }
            Changes::Words(ranges) => ranges.iter().map(ExactSizeIterator::len).sum(),
        };
        set.push(has_set);
        commit.push(all - has_set);
        kib.push(words as f64 / 256.0);
        longest = longest.max(all);
    }
    let shown = match kind {
        PackKind::Surface { .. } => "voxels",
        PackKind::Smooth { .. } => "smooth",
        PackKind::Fog => "fog",
    };
    println!(
        "| {name} | {shown} | {edit_name} | {VOXELS} | {:.1} | {:.1} | {:.0} | {longest:.1} | {whole} |",
        median(&mut set),
        median(&mut commit),
        median(&mut kib)
    );
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
