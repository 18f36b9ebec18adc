//! Everything that follows reading, in sequence.

use vdb_core::pack::{PackError, PackKind, PackOptions, PackedGrid, ValueFormat};
use vdb_core::synth::Random;
use vdb_core::tree::{
    Coarsening, LevelOptions, Node, Vdb543, half_resolution, map_values, trim_narrow_band,
    voxel_in_distances,
};
use vdb_core::{AnyTree, GridClass, Transform, VdbFile};

use super::{FLOATS, edits, limits, pick, points, rays, round_trip};

/// The most trees of a file to process; writing and reading process all of them.
const TREES: usize = 2;

/// The most levels of detail of one grid.
const LEVELS: usize = 4;

/// The extent in cells below which no coarser level is generated, as in the plugin.
const SMALLEST: u64 = 32;

/// Writes, reads, packs, queries and edits. Each input takes only some of these paths; other inputs
/// take the others.
pub(super) fn file(file: &VdbFile, seed: u64) {
    let mut random = Random::new(seed);
    points::check(file, &mut random);
    if random.below(3) == 0 {
        return round_trip::check(file, &mut random);
    }
    for (i, grid) in file.grids.iter().enumerate() {
        let bbox = grid.tree.active_bbox();
        assert_eq!(bbox.is_some(), grid.tree.active_voxel_count() > 0);
        let shared = file.grids[..i].iter().any(|other| grid.tree.shares_with(&other.tree));
        if shared || i >= TREES {
            continue;
        }
        match &grid.tree {
            AnyTree::Float(tree) => self::grid(tree, grid.class, &grid.transform, &mut random),
            AnyTree::Vec3s(tree) => {
                let axis = random.below(3) as usize;
                let tree = map_values(tree, |value| value[axis]);
                self::grid(&tree, GridClass::FogVolume, &grid.transform, &mut random);
            }
            _ => {}
        }
    }
}

fn grid(tree: &Vdb543<f32>, class: GridClass, transform: &Transform, random: &mut Random) {
    let iso = pick(random, &[0.0, 0.5, -1.0, 1e-45, 1e29, tree.background()]);
    let iso = if iso.abs() < 1e30 { iso } else { 0.0 };
    let kinds = [
        PackKind::suited(class, tree),
        PackKind::Surface { iso },
        PackKind::Smooth { iso },
        PackKind::Fog,
    ];
    let kind = pick(random, &kinds);
    let Ok(packed) = pack(tree, kind, ValueFormat::Exact) else { return };
    rays::check(tree, &packed, transform, random);
    match random.below(4) {
        0 => levels(tree, packed, class, random),
        1 => pruned(tree, random),
        2 => edits::check(tree, kind, random),
        _ => {
            let format = pick(random, &[ValueFormat::Full, ValueFormat::Half, ValueFormat::Byte]);
            let Ok(other) = pack(tree, kind, format) else { return };
            assert_eq!(other.occupied, packed.occupied, "{kind:?} {format:?}");
            rays::dda(&other, random);
        }
    }
}

pub(super) fn pack(
    tree: &Vdb543<f32>,
    kind: PackKind,
    format: ValueFormat,
) -> Result<PackedGrid, PackError> {
    let options = PackOptions { format, limits: limits(), ..PackOptions::default() };
    PackedGrid::with_options(tree, kind, &options)
}

/// Generates levels of detail as the plugin does.
fn levels(tree: &Vdb543<f32>, packed: PackedGrid, class: GridClass, random: &mut Random) {
    let (mut coarser, mut level) = (None, packed);
    let kind = level.kind;
    for _ in 0..LEVELS {
        let cells = level.occupied.map_or(0, |cells| cells.dim().into_iter().max().unwrap_or(0));
        if cells < SMALLEST {
            return;
        }
        let finer = coarser.as_ref().unwrap_or(tree);
        let coarsening = match kind {
            PackKind::Fog => Coarsening::Fog,
            PackKind::Surface { iso } | PackKind::Smooth { iso } => {
                let is_distance = class == GridClass::LevelSet && iso == 0.0;
                let voxel = if is_distance { voxel_in_distances(finer) } else { None };
                Coarsening::Surface { iso, voxel }
            }
        };
        let options = LevelOptions { limits: limits(), ..LevelOptions::default() };
        let Ok(made) = half_resolution(finer, coarsening, &options) else { return };
        let (most, bytes) = (options.limits.level_bytes, made.stats().bytes);
        assert!(bytes <= most + (1 << 20), "{bytes} bytes of a level that may take {most}");
        let Ok(packed) = pack(&made, kind, ValueFormat::Exact) else { return };
        rays::dda(&packed, random);
        (level, coarser) = (packed, Some(made));
    }
}

/// Pruning must change no voxel. Trimming the narrow band must not add leaves.
fn pruned(tree: &Vdb543<f32>, random: &mut Random) {
    let mut pruned = tree.clone();
    pruned.prune();
    assert_eq!(pruned.active_voxel_count(), tree.active_voxel_count());
    assert_eq!(pruned.active_bbox(), tree.active_bbox());
    for leaf in tree.leaves() {
        let at = leaf.origin() + random.below(8) as i32;
        let [a, b] = [tree, &pruned].map(|tree| tree.probe(at));
        assert_eq!((a.0.to_bits(), a.1), (b.0.to_bits(), b.1), "{at}");
    }
    let half_width = pick(random, &FLOATS);
    let trimmed = trim_narrow_band(tree, half_width);
    assert!(trimmed.stats().leaf_count() <= tree.stats().leaf_count());
}
