//! Cooked files: what comes back, and how close bytes are.

use std::collections::BTreeSet;
use std::io::Read;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

use glam::{DVec3, IVec3};
use vdb_core::cooked::{CookError, CookOptions, CookedError, CookedFile};
use vdb_core::pack::layout::{BRICK_VALUES, CHILD};
use vdb_core::pack::{PackKind, PackedGrid, SpareWords, ValueFormat, traverse};
use vdb_core::synth::{self, Random};
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::{
    AnyTree, Error, FileBuffer, Grid, GridClass, GridSelection, Limits, MetaValue, ProgressFn,
    ReadOptions, Transform, VdbFile, WriteOptions, reference,
};

const FORMATS: [ValueFormat; 4] =
    [ValueFormat::Exact, ValueFormat::Full, ValueFormat::Half, ValueFormat::Byte];

fn boxed(min: i32, max: i32) -> CoordBox {
    CoordBox { min: IVec3::splat(min), max: IVec3::splat(max) }
}

/// Trees with leaves, tiles of all sizes, odd values, and parts far from each other.
fn trees() -> Vec<(&'static str, Vdb543<f32>)> {
    let mut tiles = synth::fog::block(boxed(0, 300), 0.7);
    tiles.set(IVec3::new(-5, 3, 9), 0.25);
    tiles.set(IVec3::new(301, 301, 150), 0.1);
    let mut far = Vdb543::new(0.0);
    for at in [IVec3::ZERO, IVec3::splat(1 << 20), IVec3::new(i32::MIN, 5, i32::MAX)] {
        far.set(at, 0.3);
    }
    let mut odd = synth::sparse::random(boxed(-20, 20), 0.2, 5);
    for (i, value) in [f32::NAN, f32::INFINITY, -1.0, 1e-42, 1e30, 3e38].into_iter().enumerate() {
        odd.set(IVec3::splat(i as i32), value);
    }
    let mut background = Vdb543::new(0.5);
    background.set(IVec3::new(1, 2, 3), 0.9);
    background.set(IVec3::new(200, 2, 3), 0.1);
    vec![
        ("sphere of fog", synth::fog::sphere(DVec3::new(3.0, -70.0, 128.0), 30.0, 9.0)),
        ("cloud", synth::fog::cloud(40.0, 1)),
        ("tiles", tiles),
        ("far", far),
        ("odd", odd),
        ("background", background),
        ("level set", synth::level_set::sphere(DVec3::splat(60.5), 25.0)),
        ("empty", Vdb543::new(0.0)),
    ]
}

fn file_of(name: &str, tree: &Vdb543<f32>) -> VdbFile {
    VdbFile::new(vec![Grid::new(name, AnyTree::Float(tree.clone().into()))])
}

fn cooked(tree: &Vdb543<f32>, kind: PackKind, format: ValueFormat) -> CookedFile {
    let options = CookOptions { format, kind: Some(kind), ..CookOptions::default() };
    CookedFile::cook(&file_of("density", tree), &options).unwrap()
}

fn read(bytes: &[u8]) -> Result<CookedFile, CookedError> {
    CookedFile::read(bytes, &ReadOptions::default())
}

fn assert_same(a: &PackedGrid, b: &PackedGrid, what: &str) {
    assert_eq!((a.kind, a.base, a.occupied), (b.kind, b.base, b.occupied), "{what}");
    assert_eq!(a.header(7), b.header(7), "{what}");
    assert_eq!(a.majorant.to_bits(), b.majorant.to_bits(), "{what}");
    assert_eq!(a.detail, b.detail, "{what}");
    assert!(a.words == b.words, "{what}: the words differ");
}

#[test]
fn every_kind_in_every_format_comes_back_bit_for_bit() {
    for (name, tree) in trees() {
        let kinds = [
            PackKind::Fog,
            PackKind::Surface { iso: 0.0 },
            PackKind::Surface { iso: 0.5 },
            PackKind::Smooth { iso: 0.25 },
        ];
        for (kind, format) in kinds.into_iter().flat_map(|kind| FORMATS.map(|f| (kind, f))) {
            let what = format!("{name}, {kind:?}, {format:?}");
            let cooked = cooked(&tree, kind, format);
            let bytes = cooked.write().unwrap();
            let again = read(&bytes).unwrap_or_else(|error| panic!("{what}: {error}"));
            assert_same(&again.grids[0].packed, &cooked.grids[0].packed, &what);
            let spare = Arc::new(SpareWords::new(u64::MAX));
            let reuse = || CookedFile::read_reusing(&bytes, &ReadOptions::default(), &spare);
            let mut first = reuse().unwrap();
            first.grids[0].packed.words.fill(0xdead_beef);
            drop(first);
            assert!(spare.bytes() >= cooked.grids[0].packed.bytes(), "{what}: no memory is kept");
            let reused = reuse().unwrap();
            assert_eq!(spare.bytes(), 0, "{what}: the memory was not used");
            assert_same(&reused.grids[0].packed, &cooked.grids[0].packed, &what);
            if kind != PackKind::Fog || format != ValueFormat::Byte {
                let packed = PackedGrid::with_format(&tree, kind, format).unwrap();
                assert_same(&again.grids[0].packed, &packed, &what);
            }
            assert_eq!(again.write().unwrap(), bytes, "{what}: written again, it differs");
        }
    }
}

#[test]
fn names_classes_transforms_and_metadata_are_kept() {
    let tree = AnyTree::Float(synth::fog::sphere(DVec3::ZERO, 9.0, 3.0).into());
    let mut density = Grid::new("density", tree.clone());
    density.class = GridClass::FogVolume;
    density.transform = Transform::uniform(0.25, DVec3::new(1.0, 2.0, -3.0)).unwrap();
    density.metadata.insert("answer", MetaValue::Int32(42));
    let mut other = Grid::new("temperature", tree);
    other.transform = Transform::uniform(0.5, DVec3::ZERO).unwrap();
    let points = AnyTree::Int32(Vdb543::new(0).into());
    let mut file = VdbFile::new(vec![density, Grid::new("ids", points), other]);
    file.metadata.insert("title", MetaValue::String("smoke".into()));

    let cooked = CookedFile::cook(&file, &CookOptions::default()).unwrap();
    let again = read(&cooked.write().unwrap()).unwrap();
    assert_eq!(again.metadata, file.metadata);
    let names: Vec<&str> = again.grids.iter().map(|grid| grid.name.as_str()).collect();
    assert_eq!(names, ["density", "temperature"], "only grids of floats are cooked");
    let own = again.grid("density").unwrap();
    assert_eq!(own.class, GridClass::FogVolume);
    assert_eq!(
        (&own.transform, &own.metadata),
        (&file.grids[0].transform, &file.grids[0].metadata)
    );

    let only_ids = VdbFile::new(vec![file.grids[1].clone()]);
    let error = CookedFile::cook(&only_ids, &CookOptions::default()).unwrap_err();
    assert!(matches!(error, CookError::Nothing), "{error}");
}

/// The samples of fog's bricks as floats, decoded as shaders do.
fn bricks(packed: &PackedGrid) -> Vec<[f32; BRICK_VALUES]> {
    let header = packed.header(0);
    let words = &packed.words[header.samples as usize..header.palette as usize];
    let bricks = words.chunks_exact(header.brick_words as usize).map(|words| {
        std::array::from_fn(|i| match header.format {
            0 => f32::from_bits(words[i]),
            1 => {
                let bits = words[i / 2] >> (16 * (i % 2));
                half::f16::from_bits(bits as u16).to_f32() * header.scale
            }
            _ => {
                let byte = words[2 + i / 4] >> (8 * (i % 4)) & 0xff;
                f32::from_bits(words[0]) + byte as f32 * f32::from_bits(words[1])
            }
        })
    });
    bricks.collect()
}

#[test]
fn bytes_of_fog_are_within_a_255th_of_their_leafs_range() {
    for (name, tree) in trees() {
        if name == "background" {
            continue;
        }
        let exact = PackedGrid::with_format(&tree, PackKind::Fog, ValueFormat::Full).unwrap();
        let kept = cooked(&tree, PackKind::Fog, ValueFormat::Byte);
        let kept = &kept.grids[0].packed;
        let coarsest = bricks(kept).len().max(1);
        for (leaf, (exact, bytes)) in bricks(&exact).iter().zip(bricks(kept)).enumerate() {
            let least = exact.iter().copied().fold(f32::INFINITY, f32::min);
            let largest = exact.iter().copied().fold(0.0, f32::max);
            let allowed = ((largest - least) / 255.0).max(largest / 16_777_216.0);
            for i in 0..512 {
                let at = (i >> 6) * 90 + (i >> 3 & 7) * 10 + (i & 7);
                let error = (exact[at] - bytes[at]).abs();
                // The last factor is the rounding of the test's own sums.
                assert!(
                    error <= allowed * 1.000_01 + f32::MIN_POSITIVE,
                    "{name}, leaf {leaf} of {coarsest}: {} became {}, of {least}..{largest}",
                    exact[at],
                    bytes[at]
                );
            }
            assert!(bytes.iter().all(|value| *value <= kept.majorant), "{name}: the majorant");
        }
    }
}

/// A sample that two bricks repeat is rounded from its owner's value.
#[test]
fn bricks_agree_on_the_samples_they_share() {
    let tree = synth::fog::cloud(40.0, 1);
    let file = cooked(&tree, PackKind::Fog, ValueFormat::Byte);
    let packed = &file.grids[0].packed;
    let header = packed.header(0);
    let bricks = bricks(packed);
    let step = |leaf: usize| {
        f32::from_bits(
            packed.words[header.samples as usize + leaf * header.brick_words as usize + 1],
        )
    };
    let leaf_at = |cell: IVec3| {
        let span = traverse::locate(packed, cell, 0);
        (span.word & CHILD != 0 && span.occupied()).then_some(span.leaf as usize)
    };
    let (mut same, mut other) = (0, 0);
    let occupied = packed.occupied.unwrap();
    let mut random = Random::new(1);
    for _ in 0..400_000 {
        let at = [0, 1, 2].map(|axis| {
            let (min, max) = (occupied.min[axis], occupied.max[axis]);
            min + random.below((max - min + 1) as u64) as i32
        });
        let mut cell = IVec3::from_array(at);
        let axis = random.below(3) as usize;
        cell[axis] |= 7;
        let mut beyond = cell;
        beyond[axis] += 1;
        let (Some(own), Some(owner)) = (leaf_at(cell), leaf_at(beyond)) else { continue };
        let part = |c: IVec3| (c & 7).dot(IVec3::new(90, 10, 1)) as usize;
        let repeated = bricks[own][part(cell) + [90, 10, 1][axis]];
        let kept = bricks[owner][part(beyond)];
        if step(own) == step(owner) {
            assert_eq!(repeated, kept, "{cell}");
            same += 1;
        } else {
            assert!((repeated - kept).abs() <= step(own).max(step(owner)), "{cell}");
            other += 1;
        }
    }
    assert!(same > 1000 && other > 1000, "{same} of one step, {other} of two");
}

#[test]
fn transmittance_through_bytes_is_within_two_thousandths() {
    let tree = synth::fog::cloud(48.0, 3);
    let file = cooked(&tree, PackKind::Fog, ValueFormat::Byte);
    let packed = &file.grids[0].packed;
    let mut random = Random::new(9);
    // Optical depths per voxel of density 1, and the largest errors. Where a voxel or two decide
    // about a ray, errors of samples do not cancel.
    let mut cases = [(0.01, 2e-3, 0.0_f64), (0.1, 2e-3, 0.0), (1.0, 6e-3, 0.0)];
    let mut partial = 0;
    for _ in 0..2000 {
        let origin = DVec3::new(-60.0, random.range(-30.0, 30.0), random.range(-30.0, 30.0));
        let dir = DVec3::new(1.0, random.range(-0.3, 0.3), random.range(-0.3, 0.3));
        let cell = origin.floor();
        let frac = (origin - cell).as_vec3();
        let exact = reference::Ray::new(cell.as_ivec3(), frac, dir.as_vec3());
        let exact = reference::optical_depth(&tree, &exact).value;
        let ray = traverse::Ray::from_index(packed, cell.as_ivec3(), frac, dir.as_vec3());
        let kept = f64::from(traverse::optical_length(packed, &ray));
        for (extinction, _, worst) in &mut cases {
            let through = |depth: f64| (-*extinction * depth).exp();
            *worst = worst.max((through(exact) - through(kept)).abs());
            partial += i32::from((0.1..0.9).contains(&through(exact)));
        }
    }
    println!("largest errors: {cases:?}");
    assert!(partial > 500, "{partial} rays are dimmed in part");
    assert!(cases.iter().all(|(_, allowed, worst)| worst <= allowed), "{cases:?}");
}

#[test]
fn cooked_fog_is_smaller_than_the_file() {
    let mut file = file_of("density", &synth::fog::cloud(60.0, 2));
    file.grids[0].saved_as_half = true;
    let saved = file.write(&WriteOptions::default()).unwrap();
    let file = VdbFile::read(&saved, &ReadOptions::default()).unwrap();
    let of = |format| {
        let options = CookOptions { format, ..CookOptions::default() };
        CookedFile::cook(&file, &options).unwrap().write().unwrap().len()
    };
    let (exact, byte) = (of(ValueFormat::Exact), of(ValueFormat::Byte));
    println!("{} bytes became {exact} and {byte}", saved.len());
    assert!(exact < saved.len() && byte < saved.len() / 2, "{exact} and {byte}");
}

#[test]
fn only_selected_grids_are_decoded() {
    let tree = || AnyTree::Float(synth::fog::sphere(DVec3::ZERO, 9.0, 3.0).into());
    let grids = ["density", "density", "flame"].map(|name| Grid::new(name, tree()));
    // Writing gives them unique names.
    let bytes = VdbFile::new(grids.into()).write(&WriteOptions::default()).unwrap();
    let file = VdbFile::read(&bytes, &ReadOptions::default()).unwrap();
    let bytes = CookedFile::cook(&file, &CookOptions::default()).unwrap().write().unwrap();
    let select = |names: &[&str]| {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        let grids = GridSelection::Names(names);
        let options = ReadOptions { grids, ..ReadOptions::default() };
        let file = CookedFile::read(&bytes, &options)?;
        let names = file.grids.iter().map(|grid| (grid.name.clone(), grid.base_name().to_owned()));
        Ok::<Vec<_>, CookedError>(names.collect())
    };
    let pair = |(a, b): (&str, &str)| (a.to_owned(), b.to_owned());
    let [first, second] = [("density[0]", "density"), ("density[1]", "density")].map(pair);
    let flame = pair(("flame", "flame"));
    assert_eq!(select(&["density"]).unwrap(), [first, second.clone()]);
    assert_eq!(select(&["flame", "density[1]"]).unwrap(), [second, flame]);
    let error = select(&["flame", "Cd"]).unwrap_err();
    assert_eq!(error, CookedError::NoSuchGrid { name: "Cd".into() });
    // The words of two grids are more than the limit, those of one are not.
    let one = file.grids.len() as u64;
    let whole = CookedFile::read(&bytes, &ReadOptions::default()).unwrap();
    let words: u64 = whole.grids.iter().map(|grid| grid.packed.bytes()).sum();
    let mut limits = Limits::default();
    limits.packed_bytes = words * 3 / 2 / one;
    let grids = GridSelection::Names(vec!["flame".into()]);
    assert!(
        CookedFile::read(&bytes, &ReadOptions { limits: limits.clone(), ..ReadOptions::default() })
            .is_err()
    );
    let options = ReadOptions { limits, grids, ..ReadOptions::default() };
    assert_eq!(CookedFile::read(&bytes, &options).unwrap().grids.len(), 1);
}

#[test]
fn progress_is_reported_within_grids_and_cancels() {
    let tree = || AnyTree::Float(synth::fog::sphere(DVec3::ZERO, 9.0, 3.0).into());
    let file = VdbFile::new(["a", "b"].map(|name| Grid::new(name, tree())).into());
    let bytes = CookedFile::cook(&file, &CookOptions::default()).unwrap().write().unwrap();
    let reports = Arc::new(Mutex::new(Vec::new()));
    let spare = Arc::new(SpareWords::new(1 << 30));
    let report = |last: u64| {
        let reports = reports.clone();
        let progress = move |done: u64, all: u64| {
            reports.lock().unwrap().push((done, all));
            if done > last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let progress: Option<Arc<ProgressFn>> = Some(Arc::new(progress));
        let options = ReadOptions { progress, ..ReadOptions::default() };
        CookedFile::read_reusing(&bytes, &options, &spare)
    };
    let words = report(u64::MAX).unwrap().grids.iter().map(|grid| grid.packed.bytes()).sum();
    // All memory is used again, and given back even though the second grid is not decoded.
    assert_eq!(spare.bytes(), words);
    let all = bytes.len() as u64;
    let told = std::mem::take(&mut *reports.lock().unwrap());
    assert!(told.iter().all(|(done, of)| done <= of && *of == all), "{told:?}");
    assert_eq!((told.first(), told.last()), (Some(&(0, all)), Some(&(all, all))));
    // The ball touches eight lower nodes, each of which is reported with its own bytes.
    let first_half = told.iter().map(|(done, _)| *done).filter(|done| (1..all / 2).contains(done));
    assert!(first_half.collect::<BTreeSet<_>>().len() >= 8, "{told:?}");
    assert_eq!(report(0).unwrap_err(), CookedError::Cancelled);
    assert_eq!(spare.bytes(), words);
    let told = std::mem::take(&mut *reports.lock().unwrap());
    assert!(told.iter().all(|(done, _)| *done < all / 2), "the second grid was decoded: {told:?}");
    // At most one lower node per thread goes on.
    assert!(told.len() < 2 + rayon::current_num_threads().min(8), "{told:?}");
}

#[test]
fn cooked_files_are_read_to_their_end_within_the_limit() {
    let tree = synth::sparse::random(boxed(-60, 60), 0.3, 1);
    let file = file_of("density", &tree);
    let bytes = CookedFile::cook(&file, &CookOptions::default()).unwrap().write().unwrap();
    assert!(bytes.len() > 100_000, "several reads");
    let take = |limits: &Limits, length: Option<u64>| {
        let mut buffer = FileBuffer::new(limits.clone(), length);
        let mut source = bytes.as_slice();
        while let Some(room) = buffer.room()? {
            let count = source.read(room).unwrap();
            buffer.filled(count);
        }
        Ok::<_, Error>(buffer.into_bytes())
    };
    let length = bytes.len() as u64;
    for known in [None, Some(length)] {
        assert!(take(&Limits::default(), known).unwrap() == bytes);
        let mut small = Limits::default();
        small.file_bytes = length - 1;
        assert!(matches!(take(&small, known), Err(Error::LimitExceeded { .. })), "{known:?}");
    }
}
