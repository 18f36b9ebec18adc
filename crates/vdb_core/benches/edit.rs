//! Edits of 100,000 voxels of a packed grid: `cargo bench -p vdb_core --bench edit [-- FILE.vdb …]`
//!
//! A sample is one frame of an app that edits each frame. Beside the times it prints the data that the GPU
//! is sent.

mod grids;

use std::cell::RefCell;
use std::sync::{LazyLock, Mutex};

use divan::Bencher;
use glam::{DVec3, IVec3};
use grids::{BenchGrid, Shown};
use vdb_core::GridClass;
use vdb_core::pack::edit::{Changes, Editor, Voxel};
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::synth::{Random, fog, level_set};
use vdb_core::tree::{CoordBox, Node, Vdb543};

/// Frames that are measured.
const FRAMES: u32 = 60;
/// Frames before those: the first packs the whole grid.
const WARM_UP: usize = 10;
/// Voxels that a frame changes, about.
const VOXELS: usize = 100_000;
/// Radius of a ball of as many voxels.
const RADIUS: f32 = 28.8;

static GRIDS: LazyLock<Vec<BenchGrid>> = LazyLock::new(|| {
    grids::grids(|| {
        vec![
            BenchGrid {
                name: "ball, radius 300".into(),
                class: GridClass::LevelSet,
                tree: level_set::sphere(DVec3::ZERO, 300.0).into(),
            },
            BenchGrid {
                name: "fog, radius 150".into(),
                class: GridClass::FogVolume,
                tree: fog::sphere(DVec3::ZERO, 150.0, 50.0).into(),
            },
        ]
    })
});

/// A line for each benchmark of commits: median KiB sent, and frames that packed the whole grid.
static SENT: Mutex<Vec<String>> = Mutex::new(Vec::new());

fn main() {
    println!("{} threads; a sample is a frame", rayon::current_num_threads());
    grids::run();
    println!("\n| grid, edit | KiB to the GPU, median | frames that packed all |\n|---|---|---|");
    SENT.lock().iter().flat_map(|lines| lines.iter()).for_each(|line| println!("{line}"));
}

/// A ball that moves through the grid; the one of the frame before is taken away again.
#[divan::bench_group(sample_count = FRAMES, sample_size = 1)]
mod moving_ball {
    use super::*;

    #[divan::bench(args = grids::shown(&GRIDS))]
    fn set(bencher: Bencher, shown: Shown) {
        bench_set(bencher, shown, move_ball(shown));
    }

    #[divan::bench(args = grids::shown(&GRIDS))]
    fn commit(bencher: Bencher, shown: Shown) {
        bench_commit(bencher, shown, "moving ball", move_ball(shown));
    }
}

/// Voxels at random places in leaves all over the grid change their sign.
#[divan::bench_group(sample_count = FRAMES, sample_size = 1)]
mod scattered {
    use super::*;

    #[divan::bench(args = grids::shown(&GRIDS))]
    fn set(bencher: Bencher, shown: Shown) {
        bench_set(bencher, shown, scatter(shown));
    }

    #[divan::bench(args = grids::shown(&GRIDS))]
    fn commit(bencher: Bencher, shown: Shown) {
        bench_commit(bencher, shown, "scattered", scatter(shown));
    }
}

/// Sets the voxels of a frame.
trait Edit: FnMut(&mut Editor, &mut Vdb543<f32>, usize) {}
impl<F: FnMut(&mut Editor, &mut Vdb543<f32>, usize)> Edit for F {}

fn move_ball(shown: Shown) -> impl Edit {
    let tree = &shown.grid.tree;
    let is_fog = shown.kind == PackKind::Fog;
    let bounds = tree.active_bbox().expect("the grid has active voxels");
    let unit = tree.background().abs().max(0.1) / 3.0;
    // Along a diagonal of the grid's box.
    let center = move |frame: usize| {
        let along = frame as f32 / FRAMES as f32;
        bounds.min + ((bounds.max - bounds.min).as_vec3() * along).as_ivec3()
    };
    let with_ball = move |at: IVec3, old: Voxel, ijk: IVec3| {
        let distance = ((ijk - at).as_vec3().length() - RADIUS) * unit;
        let value = if is_fog {
            old.value.max((-distance).clamp(0.0, 1.0))
        } else {
            old.value.min(distance.clamp(-3.0 * unit, 3.0 * unit))
        };
        Voxel { value, active: old.active || value != old.value }
    };
    let empty = Voxel { value: if is_fog { 0.0 } else { tree.background() }, active: false };
    let around = |at: IVec3| CoordBox { min: at - 32, max: at + 32 };
    move |editor, tree, frame| {
        let (old, new) = (center(frame.saturating_sub(1)), center(frame));
        let mut edit = editor.edit(tree);
        edit.update(around(old), |ijk, was| {
            let inside = (ijk - old).as_vec3().length() < RADIUS + 3.0;
            if inside { empty } else { was }
        });
        edit.update(around(new), |ijk, old| with_ball(new, old, ijk));
    }
}

fn scatter(shown: Shown) -> impl Edit {
    let leaves: Vec<IVec3> = shown.grid.tree.leaves().map(Node::origin).collect();
    let mut random = Random::new(1);
    move |editor, tree, _| {
        let mut edit = editor.edit(tree);
        for _ in 0..VOXELS {
            let leaf = leaves[random.below(leaves.len() as u64) as usize];
            let mut axis = || random.below(8) as i32;
            let at = leaf + IVec3::new(axis(), axis(), axis());
            edit.set(at, -edit.get(at));
        }
    }
}

/// A grid that is edited frame by frame.
struct Session<E> {
    tree: Vdb543<f32>,
    packed: PackedGrid,
    editor: Editor,
    edit: E,
    frame: usize,
}

impl<E: Edit> Session<E> {
    fn new(shown: Shown, edit: E) -> Self {
        let tree = Vdb543::clone(&shown.grid.tree);
        let packed = PackedGrid::new(&tree, shown.kind).expect("the grid can be packed");
        let mut session = Self { tree, packed, editor: Editor::default(), edit, frame: 0 };
        for _ in 0..WARM_UP {
            session.frame = 0;
            session.set();
            session.commit();
        }
        session
    }

    fn set(&mut self) {
        (self.edit)(&mut self.editor, &mut self.tree, self.frame);
        self.frame += 1;
    }

    fn commit(&mut self) -> Changes {
        self.editor.commit(&self.tree, &mut self.packed).expect("the grid can be packed")
    }
}

fn bench_set(bencher: Bencher, shown: Shown, edit: impl Edit) {
    // The input of a frame is the frame before, committed.
    let session = RefCell::new(Session::new(shown, edit));
    bencher
        .with_inputs(|| drop(session.borrow_mut().commit()))
        .bench_local_values(|()| session.borrow_mut().set());
}

fn bench_commit(bencher: Bencher, shown: Shown, edit_name: &str, edit: impl Edit) {
    let session = RefCell::new(Session::new(shown, edit));
    let (mut kib, mut whole) = (Vec::new(), 0);
    // What is returned is not part of the time.
    bencher.with_inputs(|| session.borrow_mut().set()).bench_local_values(|()| {
        let mut session = session.borrow_mut();
        let changes = session.commit();
        let words = match &changes {
            Changes::All => {
                whole += 1;
                session.packed.words.len()
            }
            Changes::Words(ranges) => ranges.iter().map(ExactSizeIterator::len).sum(),
        };
        kib.push(words / 256);
        changes
    });
    kib.sort_unstable();
    let Some(median) = kib.get(kib.len() / 2) else { return };
    if let Ok(mut lines) = SENT.lock() {
        lines.push(format!("| {shown}, {edit_name} | {median} | {whole} |"));
    }
}
