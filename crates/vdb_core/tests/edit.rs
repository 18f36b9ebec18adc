//! Grids whose voxels change, against the same trees packed as a whole: rays, words and samples.

use glam::DVec3;
use vdb_core::pack::edit::{Changes, Editor, Voxel};
use vdb_core::pack::layout::{BOUNDARY, CHILD, OCCUPIED};
use vdb_core::pack::{PackKind, PackedGrid, ValueFormat, traverse};
use vdb_core::synth::{Random, fog, level_set, rays};
use vdb_core::tree::{CoordBox, IVec3, Node, Vdb543};

const KINDS: [PackKind; 3] =
    [PackKind::Surface { iso: 0.0 }, PackKind::Smooth { iso: 0.0 }, PackKind::Fog];

/// log₂ of the cells per edge from which on cubes are of the crown's, which cut the void otherwise where
/// they begin elsewhere or have more levels.
const LARGEST: u32 = 7;

/// A tree that is edited, its packed grid, and a copy of the words that is kept up to date by the
/// changes alone, as the GPU's is.
struct Edited {
    tree: Vdb543<f32>,
    packed: PackedGrid,
    editor: Editor,
    mirror: Vec<u32>,
    /// Commits that packed everything anew, and those that did not.
    wholes: u32,
    parts: u32,
}

impl Edited {
    fn new(tree: Vdb543<f32>, kind: PackKind) -> Self {
        let packed = PackedGrid::new(&tree, kind).unwrap();
        let (editor, mirror) = (Editor::default(), packed.words.clone());
        Self { tree, packed, editor, mirror, wholes: 0, parts: 0 }
    }

    /// Commits, and gives the words that have changed.
    fn commit(&mut self) -> usize {
        match self.editor.commit(&self.tree, &mut self.packed).unwrap() {
            Changes::All => {
                self.mirror.clone_from(&self.packed.words);
                self.wholes += 1;
                self.mirror.len()
            }
            Changes::Words(ranges) => {
                assert!(ranges.windows(2).all(|two| two[0].end < two[1].start), "{ranges:?}");
                for range in &ranges {
                    let range = range.start as usize..range.end as usize;
                    assert!(!range.is_empty());
                    self.mirror[range.clone()].copy_from_slice(&self.packed.words[range]);
                }
                self.parts += 1;
                ranges.iter().map(ExactSizeIterator::len).sum()
            }
        }
    }

    /// Compares with the tree packed as a whole.
    fn check(&self, random: &mut Random, rays: usize) {
        assert!(self.mirror == self.packed.words, "a change was not told of");
        let whole =
            PackedGrid::with_format(&self.tree, self.packed.kind, ValueFormat::Full).unwrap();
        let in_index = |grid: &PackedGrid| {
            let own = grid.occupied?;
            Some(CoordBox { min: own.min + grid.base, max: own.max + grid.base })
        };
        assert_eq!(in_index(&self.packed), in_index(&whole));
        let Some(bounds) = in_index(&whole) else { return };
        for _ in 0..4 {
            compare_slots(&self.packed, &whole, place(random), bounds);
        }
        let leaves: Vec<IVec3> = self.tree.leaves().map(Node::origin).collect();
        for _ in 0..leaves.len().min(rays) {
            let leaf = leaves[random.below(leaves.len() as u64) as usize];
            compare_cells(&self.packed, &whole, leaf, bounds);
        }
        // Rays are made from the extent of the box, which has to be a number.
        let extent = bounds.max.as_i64vec3() - bounds.min.as_i64vec3();
        let rays = if extent.max_element() < 1 << 30 { rays } else { 0 };
        for _ in 0..rays {
            compare_ray(&self.packed, &whole, random, bounds);
        }
    }
}

/// Leaf-sized cubes around a voxel, in all octants: what is there, and how far it is to something else.
fn compare_slots(one: &PackedGrid, two: &PackedGrid, at: IVec3, bounds: CoordBox) {
    let cubes = |at: i32| (at >> 3) - 10..(at >> 3) + 10;
    for x in cubes(at.x) {
        for y in cubes(at.y) {
            for z in cubes(at.z) {
                let ijk = IVec3::new(x, y, z) * 8;
                if !bounds.contains(ijk) {
                    continue;
                }
                for octant in 0..8 {
                    let [a, b] =
                        [one, two].map(|grid| traverse::locate(grid, ijk - grid.base, octant));
                    let cut = |span: traverse::Span| {
                        let skip = if span.log_dim < LARGEST { span.skip } else { 0 };
                        (span.occupied(), span.log_dim.min(LARGEST), skip)
                    };
                    assert_eq!(cut(a), cut(b), "{ijk} octant {octant}: {a:?} {b:?}");
                }
            }
        }
    }
}

/// What is in each cell of the cubes around a leaf of the tree: whether it is occupied, and the samples
/// at its corners.
fn compare_cells(one: &PackedGrid, two: &PackedGrid, leaf: IVec3, bounds: CoordBox) {
    for i in 0..1000 {
        let ijk = leaf.wrapping_add(IVec3::new(i / 100, i / 10 % 10, i % 10) - 1);
        // Rays look at cells of the box alone.
        if !bounds.contains(ijk) {
            continue;
        }
        let [a, b] = [one, two].map(|grid| traverse::locate(grid, ijk.wrapping_sub(grid.base), 0));
        let cut = |span: traverse::Span| (span.occupied(), span.log_dim.min(LARGEST));
        assert_eq!(cut(a), cut(b), "{ijk}: {a:?} {b:?}");
        let flags = CHILD | OCCUPIED | BOUNDARY;
        assert_eq!(a.word & flags, b.word & flags, "{ijk}");
        if a.occupied() && !matches!(one.kind, PackKind::Surface { .. }) && !a.constant() {
            let [a, b] = [(one, a), (two, b)].map(|(grid, span)| {
                traverse::corners(grid, span, ijk.wrapping_sub(grid.base)).map(f32::to_bits)
            });
            assert_eq!(a, b, "{ijk}");
        }
    }
}

fn compare_ray(one: &PackedGrid, two: &PackedGrid, random: &mut Random, bounds: CoordBox) {
    let ray = rays::adversarial(random, bounds);
    let Some(dir) = rays::normalized(ray.dir) else { return };
    let local = |grid: &PackedGrid| traverse::Ray::from_index(grid, ray.cell, ray.frac, dir);
    let hit = |grid: &PackedGrid| {
        let hit = traverse::first_hit(grid, &local(grid))?;
        Some((hit.cell + grid.base, hit.t.to_bits(), hit.axis))
    };
    assert_eq!(hit(one), hit(two), "{ray:?}");
    if one.kind == PackKind::Fog {
        let depth = |grid: &PackedGrid| traverse::optical_length(grid, &local(grid));
        let (a, b) = (depth(one), depth(two));
        assert!((a - b).abs() <= 1e-5 * a.abs(), "{ray:?}: {a} and {b}");
    }
}

fn model(kind: PackKind, seed: u64) -> Vdb543<f32> {
    let center = DVec3::splat(37.3 * seed as f64 - 90.0);
    match (kind, seed % 3) {
        (_, 0) => Vdb543::new(if kind == PackKind::Fog { 0.0 } else { 3.0 }),
        (PackKind::Fog, 1) => fog::sphere(center, 30.0, 9.0),
        // A block of 128³ tiles.
        (PackKind::Fog, _) => {
            fog::block(CoordBox { min: IVec3::splat(-130), max: IVec3::splat(270) }, 0.5)
        }
        (_, 1) => level_set::sphere(center, 40.0),
        (_, _) => level_set::cuboid(DVec3::splat(-140.5), DVec3::splat(150.5)),
    }
}

fn voxel(random: &mut Random, kind: PackKind) -> Voxel {
    let values = match kind {
        PackKind::Fog => [0.0, 0.5, 1.0, -1.0, random.unit() as f32],
        _ => [3.0, -3.0, 0.25, 0.0, random.range(-3.0, 3.0) as f32],
    };
    let special = if random.below(200) == 0 { f32::NAN } else { 1.0 };
    let value = values[random.below(5) as usize] * special;
    Voxel { value, active: random.below(2) == 0 }
}

/// A place in the midst, at a corner of a leaf, a region or an upper node, or away from all.
fn place(random: &mut Random) -> IVec3 {
    let corner = [0, 8, 128, 4096, -128, -4096][random.below(6) as usize];
    let mut axis = || match random.below(8) {
        0 => corner - 1,
        1 => corner,
        _ => random.below(200) as i32 - 100,
    };
    IVec3::new(axis(), axis(), axis())
}

fn edit(edited: &mut Edited, random: &mut Random) {
    let kind = edited.packed.kind;
    let mut edit = edited.editor.edit(&mut edited.tree);
    for _ in 0..1 + random.below(3) {
        let at = place(random);
        let voxel = voxel(random, kind);
        let size = 1 + random.below(40) as i32;
        let bbox = CoordBox { min: at - random.below(30) as i32, max: at + size };
        match random.below(6) {
            0 => edit.fill(bbox, voxel),
            1 => {
                // A ball, dug or added.
                let dig = random.below(2) == 0;
                let ball = move |ijk: IVec3, old: Voxel| {
                    let distance = (ijk - at).as_vec3().length() - size as f32 / 2.0;
                    let value = match (kind, dig) {
                        (PackKind::Fog, true) => old.value * (distance / 4.0).clamp(0.0, 1.0),
                        (PackKind::Fog, false) => old.value.max((-distance / 4.0).clamp(0.0, 1.0)),
                        (_, true) => old.value.max(-distance),
                        (_, false) => old.value.min(distance.clamp(-3.0, 3.0)),
                    };
                    Voxel { value, active: value != old.value || old.active }
                };
                edit.update(bbox, ball);
            }
            2 => {
                for _ in 0..random.below(300) {
                    let at = place(random);
                    edit.set_voxel(at, self::voxel(random, kind));
                }
            }
            // Everything around goes.
            3 if random.below(3) == 0 => {
                let empty = Voxel { value: edit.tree().background(), active: false };
                edit.fill(CoordBox { min: at - 200, max: at + 200 }, empty);
            }
            _ => {
                for i in 0..20 {
                    edit.set_voxel(at + IVec3::new(i, i * 3 % 7, i / 2), voxel);
                    assert_eq!(edit.get(at).to_bits(), voxel.value.to_bits());
                }
            }
        }
    }
}

#[test]
fn an_edited_grid_is_that_of_its_tree() {
    let rounds = std::env::var("EDIT_ROUNDS").map_or(4, |rounds| rounds.parse().unwrap());
    for kind in KINDS {
        let (mut wholes, mut parts) = (0, 0);
        for seed in 0..rounds {
            let mut random = Random::new(seed);
            let mut edited = Edited::new(model(kind, seed), kind);
            for step in 0..12 {
                edit(&mut edited, &mut random);
                edited.commit();
                println!("{kind:?} seed {seed} step {step}");
                edited.check(&mut random, 300);
            }
            wholes += edited.wholes;
            parts += edited.parts;
        }
        println!("{kind:?}: {parts} commits in part, {wholes} of everything");
        assert!(parts > wholes, "hardly a commit was in part");
    }
}

#[test]
fn what_cannot_be_packed_in_part_is_packed_whole() {
    // Tiles of 4096³ that are solid, and a solid void.
    let mut tiled = Vdb543::new(1.0);
    tiled.insert_tile(IVec3::ZERO, -1.0, false);
    tiled.set(IVec3::new(-1, 5, 5), -1.0);
    let mut solid = Vdb543::new(-1.0);
    solid.set(IVec3::ZERO, 1.0);
    for (tree, kind, in_part) in
        [(&tiled, KINDS[0], true), (&tiled, KINDS[1], true), (&solid, KINDS[0], false)]
    {
        let mut random = Random::new(3);
        let mut edited = Edited::new(tree.clone(), kind);
        for at in [IVec3::splat(4095), IVec3::new(-1, 5, 6), IVec3::splat(-2)] {
            let value = -edited.tree.get(at);
            edited.editor.edit(&mut edited.tree).set(at, value);
            edited.commit();
            edited.check(&mut random, 20);
        }
        // Once its tile has been cut, the first is as others are.
        assert_eq!(edited.parts > 0, in_part, "{kind:?}");
    }
}

#[test]
fn voxels_can_be_set_anywhere() {
    for kind in KINDS {
        let background = if kind == PackKind::Fog { 0.0 } else { 1.0 };
        let mut edited = Edited::new(Vdb543::new(background), kind);
        let mut random = Random::new(4);
        let ends = [i32::MIN, i32::MIN + 8, -1, 0, i32::MAX - 1, i32::MAX];
        for _ in 0..30 {
            let mut axis = || ends[random.below(6) as usize];
            let at = IVec3::new(axis(), axis(), axis());
            let there = edited.tree.get(at);
            let value = if kind == PackKind::Fog { 0.5 - there } else { -there };
            edited.editor.edit(&mut edited.tree).set(at, value);
            edited.commit();
            edited.check(&mut random, 60);
        }
        let (wholes, parts) = (edited.wholes, edited.parts);
        println!("{kind:?}: {parts} commits in part, {wholes} of everything");
        assert!(parts > wholes);
    }
}

#[test]
fn what_does_not_change_costs_nothing() {
    for kind in KINDS {
        let mut edited = Edited::new(model(kind, 1), kind);
        let at = edited.tree.leaves().next().unwrap().origin();
        edited.editor.edit(&mut edited.tree).set(at, 0.25);
        assert!(edited.commit() > 0 && edited.wholes == 1);
        assert_eq!(edited.commit(), 0, "no edit");
        edited.editor.edit(&mut edited.tree).set(at, 0.25);
        let bbox = CoordBox { min: at - 50, max: at + 50 };
        edited.editor.edit(&mut edited.tree).update(bbox, |_, old| old);
        assert_eq!(edited.commit(), 0, "an edit that changes nothing");
        // There and back: the words are others, if any, for runs may have moved.
        edited.editor.edit(&mut edited.tree).set(at, 0.5);
        edited.editor.edit(&mut edited.tree).set(at, 0.25);
        assert_eq!(edited.commit(), 0, "an edit that was undone");
        assert_eq!((edited.wholes, edited.parts), (1, 3));
        // A value of a voxel of a surface that stays on its side is nothing to its words; else a leaf or
        // eight of them.
        edited.editor.edit(&mut edited.tree).set(at, 0.5);
        let words = edited.commit();
        let most = if matches!(kind, PackKind::Surface { .. }) { 0 } else { 8 * 1000 };
        assert!(words <= most, "{kind:?}: {words} words for a voxel");
    }
}
