//! Edited grids, compared with the same tree packed as a whole.

use vdb_core::pack::edit::{Changes, Editor, Voxel};
use vdb_core::pack::layout::{BOUNDARY, CHILD, LOWER_BITS, OCCUPIED, PAYLOAD, TOP_WORDS, top_slot};
use vdb_core::pack::{PackKind, PackedGrid, ValueFormat, traverse};
use vdb_core::synth::Random;
use vdb_core::tree::{CoordBox, IVec3, Node, Vdb543};
use vdb_core::{AnyTree, Grid, VdbFile};

use super::follow::pack;
use super::{CORNERS, FLOATS, pick, rays, round_trip};

/// The most commits per grid, and the most edits before each.
const COMMITS: u64 = 2;
const EDITS: u64 = 6;

/// log₂ of the cells per edge from which cubes belong to the top-level tree, which may divide empty
/// space differently.
const LARGEST: u32 = 7;

/// Edits a copy of a tree. After each commit, words and ray results must equal those of a newly
/// packed grid.
pub(super) fn check(tree: &Vdb543<f32>, kind: PackKind, random: &mut Random) {
    let Ok(mut packed) = pack(tree, kind, ValueFormat::Exact) else { return };
    let (mut tree, mut editor) = (tree.clone(), Editor::default());
    let mut mirror = packed.words.clone();
    for _ in 0..1 + random.below(COMMITS) {
        let places = edit(&mut editor, &mut tree, random);
        match editor.commit(&tree, &mut packed) {
            Err(_) => return,
            Ok(Changes::All) => mirror.clone_from(&packed.words),
            Ok(Changes::Words(ranges)) => {
                assert!(ranges.windows(2).all(|two| two[0].end < two[1].start), "{ranges:?}");
                for range in ranges {
                    let range = range.start as usize..range.end as usize;
                    assert!(!range.is_empty());
                    mirror[range.clone()].copy_from_slice(&packed.words[range]);
                }
            }
        }
        assert!(mirror == packed.words, "a change was not told of");
        compare(&tree, &packed, &places, random);
    }
    if random.below(4) > 0 {
        return;
    }
    let mut grid = Grid::new("edited", AnyTree::Float(tree.into()));
    grid.saved_as_half = random.below(4) == 0;
    round_trip::check(&VdbFile::new(vec![grid]), random);
}

/// Makes a few edits of all kinds, and returns their positions.
fn edit(editor: &mut Editor, tree: &mut Vdb543<f32>, random: &mut Random) -> Vec<IVec3> {
    let origins: Vec<IVec3> = tree.leaves().take(1000).map(Node::origin).collect();
    let mut places = Vec::new();
    let mut edit = editor.edit(tree);
    for _ in 0..1 + random.below(EDITS) {
        let at = place(random, &origins);
        let voxel = Voxel { value: pick(random, &FLOATS), active: random.below(2) == 0 };
        let size = 1 + random.below(20) as i32;
        let bbox = CoordBox { min: at, max: at.saturating_add(IVec3::splat(size)) };
        match random.below(6) {
            0 => edit.fill(bbox, voxel),
            1 => edit.update(bbox, |ijk, old| {
                let keep = (ijk.x ^ ijk.y ^ ijk.z) & 1 == 0;
                if keep { old } else { voxel }
            }),
            2 => {
                let empty = Voxel { value: edit.tree().background(), active: false };
                edit.fill(bbox, empty);
            }
            // A change that is reverted.
            3 => {
                let old = edit.voxel(at);
                edit.set_voxel(at, voxel);
                edit.set_voxel(at, old);
            }
            _ => {
                edit.set_voxel(at, voxel);
                assert_eq!(edit.get(at).to_bits(), voxel.value.to_bits());
            }
        }
        places.extend([at, bbox.max]);
    }
    places
}

/// A position in a leaf, next to one, or near a corner of the index space or of nodes.
fn place(random: &mut Random, origins: &[IVec3]) -> IVec3 {
    let mut base = IVec3::from_array([0; 3].map(|_| pick(random, &CORNERS)));
    if random.below(2) == 0 && !origins.is_empty() {
        base = pick(random, origins);
    }
    let offset = IVec3::from_array([0; 3].map(|_| random.below(10) as i32 - 1));
    base.saturating_add(offset)
}

fn compare(tree: &Vdb543<f32>, packed: &PackedGrid, places: &[IVec3], random: &mut Random) {
    let Ok(whole) = pack(tree, packed.kind, ValueFormat::Full) else { return };
    assert_eq!(rays::bounds(packed), rays::bounds(&whole));
    let Some(bounds) = rays::bounds(&whole) else { return };
    for &place in places {
        for i in 0..27 {
            let side = IVec3::new(i / 9, i / 3 % 3, i % 3) - 1;
            for step in [1, 8] {
                let ijk = place.saturating_add(side * step);
                // Rays only visit cells of the box.
                if bounds.contains(ijk) {
                    compare_cell(packed, &whole, ijk, random.below(8) as u32);
                }
            }
        }
    }
    for _ in 0..8 {
        compare_ray(packed, &whole, bounds, random);
    }
}

/// Cells have the same samples in both; where the cubes around are cut alike, their spans are equal, too.
fn compare_cell(one: &PackedGrid, two: &PackedGrid, ijk: IVec3, octant: u32) {
    let [a, b] = [one, two].map(|grid| traverse::locate(grid, ijk.wrapping_sub(grid.base), octant));
    assert_eq!(met(one, a, ijk), met(two, b, ijk), "{ijk} octant {octant}: {a:?} {b:?}");
    if cuts(one, ijk) != cuts(two, ijk) {
        return;
    }
    let cut = |span: traverse::Span| {
        let reach = if span.log_dim < LARGEST { span.skip } else { 0 };
        (span.occupied(), span.log_dim.min(LARGEST), reach)
    };
    assert_eq!(cut(a), cut(b), "{ijk} octant {octant}: {a:?} {b:?}");
    let flags = CHILD | OCCUPIED | BOUNDARY;
    assert_eq!(a.word & flags, b.word & flags, "{ijk}");
}

/// The bits of the samples that a ray meets in a cell; `None` where it meets nothing.
fn met(grid: &PackedGrid, span: traverse::Span, ijk: IVec3) -> Option<[u32; 8]> {
    if !span.occupied() {
        return None;
    }
    if matches!(grid.kind, PackKind::Surface { .. }) {
        return Some([0; 8]);
    }
    let samples = traverse::corners(grid, span, ijk.wrapping_sub(grid.base));
    // The high sides of a tile are one span, and a ray meets nothing in some of their cells.
    let is_met = match grid.kind {
        PackKind::Fog => samples.iter().any(|sample| *sample > 0.0),
        _ => {
            let below = samples.iter().filter(|sample| **sample < 0.0).count();
            (1..8).contains(&below)
        }
    };
    is_met.then(|| samples.map(f32::to_bits))
}

/// What the cubes of 128³ cells around a cell are: nothing, tiles or lower nodes. An edit that leaves a leaf
/// with nothing new in a tile keeps the tile whole; packed anew, the tile is cut down to that leaf, and
/// cells beside it can skip further.
fn cuts(grid: &PackedGrid, ijk: IVec3) -> [u32; 27] {
    let header = grid.header(0);
    let first = (ijk.wrapping_sub(grid.base) >> LOWER_BITS) - IVec3::from_array(header.top_origin);
    std::array::from_fn(|i| {
        let i = i as i32;
        let at = first + IVec3::new(i / 9, i / 3 % 3, i % 3) - 1;
        if (at.x | at.y | at.z) >> (2 * header.top_levels) != 0 {
            return 0;
        }
        let mut node = header.top as usize;
        for level in (0..header.top_levels).rev() {
            let word = grid.words[node + top_slot(at, level)];
            if word & CHILD == 0 || level == 0 {
                return word & (CHILD | OCCUPIED);
            }
            node = header.top as usize + (word & PAYLOAD) as usize * TOP_WORDS;
        }
        0
    })
}

fn compare_ray(one: &PackedGrid, two: &PackedGrid, bounds: CoordBox, random: &mut Random) {
    let Some(ray) = rays::near(one, bounds, random) else { return };
    // The same ray relative to the base of the other grid.
    let moved = one.base.wrapping_sub(two.base);
    let other = traverse::Ray { cell: ray.cell.wrapping_add(moved), ..ray };
    let hit = |grid: &PackedGrid, ray| {
        let hit = traverse::first_hit(grid, ray)?;
        Some((hit.cell.wrapping_add(grid.base), hit.t.to_bits(), hit.axis))
    };
    assert_eq!(hit(one, &ray), hit(two, &other), "{ray:?}");
    if one.kind == PackKind::Fog {
        let (a, b) = (traverse::optical_length(one, &ray), traverse::optical_length(two, &other));
        assert!(a == b || (a - b).abs() <= 1e-5 * a.abs(), "{ray:?}: {a} and {b}");
    }
}
