//! What is written is read again, here and by `NanoVDB`, and laid out as it lays files out.

use super::*;

const VALIDATE: &str = "nanovdb_validate";

const ALL_VALUES: [NanoVdbValues; 3] =
    [NanoVdbValues::Float, NanoVdbValues::Fp8, NanoVdbValues::Fp16];

/// A tree with everything that a writer has to place: tiles at each level, leaves without active
/// voxels, nodes without any, and several octants.
pub(super) fn varied() -> Vdb543<f32> {
    let mut tree = Vdb543::new(0.5_f32);
    for i in 0..300 {
        let at = IVec3::new(i * 7 % 61 - 30, i * 13 % 47 - 20, i * 29 % 301 - 150);
        tree.set(at, (i as f32 * 0.37).sin());
    }
    tree.fill_leaf(IVec3::new(512, 8, 16), 0.25, true);
    tree.fill_leaf(IVec3::new(512, 16, 16), -0.25, false);
    tree.insert_tile(IVec3::new(8192, 0, -4096), 3.0, true);
    tree.insert_tile(IVec3::new(-8192, 0, 4096), 4.0, false);
    tree.set_inactive(IVec3::new(20_000, 3, 3), 9.0);
    tree.set(IVec3::new(-300_000, 70_000, i32::MAX), 2.5);
    tree
}

fn varied_file() -> VdbFile {
    let mut grid = Grid::new("varied", AnyTree::Float(varied().into()));
    grid.class = GridClass::FogVolume;
    let mut long = Grid::new("n".repeat(300), AnyTree::Float(Vdb543::new(1.5_f32).into()));
    long.class = GridClass::LevelSet;
    VdbFile::new(vec![grid, long])
}

#[test]
fn written_files_are_read_again() {
    let file = varied_file();
    for (values, codec) in
        ALL_VALUES.iter().flat_map(|v| [Codec::None, Codec::Zip, Codec::Blosc].map(|c| (*v, c)))
    {
        let what = format!("{values:?}, {codec:?}");
        let written = file.write_nanovdb(&NanoVdbOptions { values, codec }).unwrap();
        let again = read(&written);
        assert_eq!(again.grids.len(), 2, "{what}");
        for (own, grid) in file.grids.iter().zip(&again.grids) {
            assert_eq!((&own.name, own.class), (&grid.name, grid.class), "{what}");
            assert_eq!(grid.compression.codec, codec);
            assert_same_place(own, grid, &what);
            assert_sound(grid, &what);
            assert_close(float(own), float(grid), values, &what);
        }
        // The same, read piece by piece.
        let mut buffer = FileBuffer::new(Limits::default(), None);
        let mut rest = &written[..];
        while let Some(room) = buffer.room().unwrap() {
            let now = rest.len().min(room.len()).min(10_000);
            room[..now].copy_from_slice(&rest[..now]);
            buffer.filled(now);
            rest = &rest[now..];
        }
        assert_eq!(buffer.into_bytes(), written, "{what}");
    }
}

/// Whether trees are equal, apart from values of leaves that are quantised, which may be off by half
/// a step of their leaf's range, and the rounding of f32.
fn assert_close(a: &Vdb543<f32>, b: &Vdb543<f32>, values: NanoVdbValues, what: &str) {
    let steps = match values {
        NanoVdbValues::Float => return assert!(same_tree(a, b), "{what}"),
        NanoVdbValues::Fp8 => 255.0,
        NanoVdbValues::Fp16 => 65_535.0,
    };
    assert_eq!(a.stats().levels, b.stats().levels, "{what}");
    let leaves = a.leaves().zip(b.leaves());
    for (a, b) in leaves {
        assert_eq!((a.origin(), a.value_mask()), (b.origin(), b.value_mask()), "{what}");
        let range = a
            .values_slice()
            .iter()
            .fold((f32::MAX, f32::MIN), |range, value| (range.0.min(*value), range.1.max(*value)));
        let largest = range.0.abs().max(range.1.abs());
        // Product, sum and quantum are rounded once each.
        let allowed = (range.1 - range.0) / steps * 0.5 + largest * f32::EPSILON * 3.0;
        for (a, b) in a.values_slice().iter().zip(b.values_slice()) {
            assert!((a - b).abs() <= allowed, "{what}: {a} became {b}, allowed {allowed}");
        }
    }
    let tiles = |tree: &Vdb543<f32>| -> Vec<_> {
        tree.values().filter(|value| value.log2_dim > 0).collect()
    };
    assert_eq!(tiles(a), tiles(b), "{what}");
}

#[test]
fn what_cannot_be_written_is_said() {
    let refused = |grid: Grid, values| {
        let options = NanoVdbOptions { values, codec: Codec::None };
        let error = VdbFile::new(vec![grid]).write_nanovdb(&options).unwrap_err();
        assert!(matches!(error, Error::NotSupported { .. }), "{error:?}");
        error.to_string()
    };
    let vectors = Grid::new("v", AnyTree::Vec3s(Vdb543::new([0.0; 3]).into()));
    assert!(refused(vectors, NanoVdbValues::Float).contains("Tree_vec3s_5_4_3"));
    for bad in [f32::NAN, f32::INFINITY] {
        let mut tree = varied();
        tree.set(IVec3::ZERO, bad);
        let grid = Grid::new("bad", AnyTree::Float(tree.into()));
        let said = refused(grid.clone(), NanoVdbValues::Fp8);
        assert!(said.contains("grid \"bad\"") && said.contains("not finite"), "{said}");
        let options = NanoVdbOptions::default();
        let file = VdbFile::new(vec![grid]);
        let again = read(&file.write_nanovdb(&options).unwrap());
        assert!(same_any(&file.grids[0].tree, &again.grids[0].tree), "floats keep it");
    }
}

/// What is written here is valid for `NanoVDB`, which reads the same values; floats are laid out as
/// its converter lays them out.
#[test]
fn nanovdb_reads_what_is_written() {
    if !openvdb::is_there(CONVERT, &["--help"]) {
        return;
    }
    let folder = openvdb::folder("nanovdb_write");
    let at = |name: &str| folder.join(name);
    let mut file = varied_file();
    file.grids.extend(VdbFile::open(data("kinds.vdb")).unwrap().grids);
    file.grids.retain(|grid| matches!(grid.tree, AnyTree::Float(_)));
    let codecs = [Codec::None, Codec::Zip, Codec::Blosc];
    for (values, codec) in ALL_VALUES.into_iter().zip(codecs) {
        let what = format!("{values:?}, {codec:?}");
        let nvdb = at("written.nvdb");
        file.save_nanovdb(&nvdb, &NanoVdbOptions { values, codec }).unwrap();
        let checked = Command::new(VALIDATE).arg(&nvdb).output().unwrap();
        let said = String::from_utf8_lossy(&checked.stdout).into_owned()
            + &String::from_utf8_lossy(&checked.stderr);
        assert!(checked.status.success() && !said.contains("nvalid"), "{what}: {said}");
        convert(&[], &nvdb, &at("back.vdb")).unwrap_or_else(|| panic!("{what}: refused"));
        let (own, back) = (VdbFile::open(&nvdb).unwrap(), VdbFile::open(at("back.vdb")).unwrap());
        assert_eq!(own.grids.len(), back.grids.len(), "{what}");
        for grid in &own.grids {
            let back = back.grid(&grid.name).unwrap();
            assert!(same_any(&grid.tree, &back.tree), "{what}: {}", grid.name);
            assert_eq!(grid.class, back.class, "{what}");
            // On the way back, `nanovdb_convert` 32.4.2 transposes matrices, also its own.
            if grid.transform.map_type() != "AffineMap" {
                assert_same_place(grid, back, &what);
            }
        }
    }
}

/// The parts of a written grid that are floats, which depend on the order of sums.
fn is_statistic(at: usize, nodes: &[(usize, usize)]) -> bool {
    nodes.iter().any(|(start, length)| (*start..start + length).contains(&at))
}

#[test]
fn floats_are_laid_out_as_nanovdb_does_it() {
    if !openvdb::is_there(CONVERT, &["--help"]) {
        return;
    }
    let folder = openvdb::folder("nanovdb_layout");
    let (vdb, nvdb) = (folder.join("one.vdb"), folder.join("one.nvdb"));
    let mut compared = 0;
    for mut grid in VdbFile::open(data("kinds.vdb")).unwrap().grids {
        if !matches!(grid.tree, AnyTree::Float(_)) {
            continue;
        }
        grid.saved_as_half = false;
        let file = VdbFile::new(vec![grid]);
        file.save(&vdb, &vdb_core::WriteOptions::default()).unwrap();
        convert(&[], &vdb, &nvdb).unwrap();
        let theirs = std::fs::read(&nvdb).unwrap();
        let ours = file.write_nanovdb(&NanoVdbOptions::default()).unwrap();
        assert_eq!(theirs.len(), ours.len());
        let name = file.grids[0].name.len() + 1;
        // The segment's header, then the metadata of the grid and its name.
        let grid_at = 16 + 176 + name;
        compare(&theirs, &ours, grid_at);
        compared += 1;
    }
    assert_eq!(compared, 2);
}

/// Compares the bytes of two files with one float grid that begins at `start`.
fn compare(theirs: &[u8], ours: &[u8], start: usize) {
    let number = |bytes: &[u8], at: usize| {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    };
    let tree = start + 672;
    let counts = [32, 36, 40].map(|at| number(theirs, tree + at));
    let tiles = number(theirs, tree + 64 + 24);
    let uppers = tree + 64 + 64 + 32 * tiles;
    let lowers = uppers + counts[2] * 270_400;
    let leaves = lowers + counts[1] * 33_856;
    assert_eq!(leaves + counts[0] * 2144, theirs.len());
    // Average and deviation of each node, and minimum and maximum.
    let mut floats = vec![(tree + 64 + 32, 16)];
    floats.extend((0..counts[2]).map(|i| (uppers + i * 270_400 + 8224, 16)));
    floats.extend((0..counts[1]).map(|i| (lowers + i * 33_856 + 1056, 16)));
    floats.extend((0..counts[0]).map(|i| (leaves + i * 2144 + 80, 16)));
    // Maps, boxes and voxel sizes depend on the order of operations as well.
    let doubles = [(start + 296 + 88, 176), (start + 560, 72), (16 + 40, 48), (16 + 112, 24)];
    let maps = [(start + 296, 88)];
    // The checksum covers all of them. Behind the value of a tile, in a slot of eight bytes, and
    // behind the statistics there is nothing.
    let free = [(start + 8, 8)];
    let table = |at: usize, first: usize, bytes: usize, offset: usize| {
        at >= first && (at - first) % bytes >= offset
    };
    let mut at = 0;
    while at < ours.len() {
        let step = if is_statistic(at, &doubles) { 8 } else { 4 };
        let (a, b) = (&theirs[at..ours.len().min(at + step)], &ours[at..ours.len().min(at + step)]);
        let near =
            |a: f64, b: f64, bound: f64| (a - b).abs() <= bound * a.abs().max(1e-30) || a == b;
        if is_statistic(at, &doubles) {
            let [a, b] = [a, b].map(|x| f64::from_le_bytes(x.try_into().unwrap()));
            assert!(near(a, b, 1e-14) || (a - b).abs() < 1e-15, "f64 at {at}: {a} and {b}");
        } else if is_statistic(at, &floats) || is_statistic(at, &maps) {
            let [a, b] = [a, b].map(|x| f64::from(f32::from_le_bytes(x.try_into().unwrap())));
            // An ulp, from sums in another order.
            assert!(near(a, b, 2.5e-7) || (a - b).abs() < 1e-15, "f32 at {at}: {a} and {b}");
        } else if !is_statistic(at, &free) && a != b {
            let in_upper = (uppers..lowers).contains(&at) && table(at, uppers, 270_400, 8240);
            let in_lower = (lowers..leaves).contains(&at) && table(at, lowers, 33_856, 1072);
            let base = if in_upper { uppers } else { lowers };
            let high_half = (in_upper || in_lower) && (at - base) % 8 == 4;
            assert!(high_half, "byte {at} of {}: {a:?} and {b:?}", ours.len());
        }
        at += step;
    }
}
