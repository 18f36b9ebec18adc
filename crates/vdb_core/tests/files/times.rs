//! Time follows the number of grids, and not that of instances.

use super::*;

/// The least time of three of something.
fn least(mut act: impl FnMut()) -> Duration {
    let times = (0..3).map(|_| {
        let start = Instant::now();
        act();
        start.elapsed()
    });
    times.min().unwrap_or_default()
}

/// A file with this many grids, which share one tree or have one each.
fn many_grids(count: usize, shared: bool) -> VdbFile {
    let tree = |number: usize| {
        let mut tree = Vdb543::new(0.0_f32);
        tree.set(IVec3::splat(number as i32), 1.0);
        AnyTree::Float(tree.into())
    };
    let one = tree(0);
    let own = |number: usize| if shared { one.clone() } else { tree(number) };
    let empty = || AnyTree::Float(Vdb543::new(0.0_f32).into());
    let trees =
        (0..count).map(|number| if shared || number % 50 == 0 { own(number) } else { empty() });
    // All of one name, so that numbers tell them apart.
    VdbFile::new(trees.map(|tree| Grid::new("grid", tree)).collect())
}

/// How many times longer eight times as many take than eight times that many, at the least of several rounds: what
/// else the machine does lengthens some. 1 where time follows the number, 8 where it does so squared.
fn growth(mut few: impl FnMut(), mut many: impl FnMut()) -> f64 {
    let mut least = f64::INFINITY;
    for _ in 0..10 {
        let start = Instant::now();
        (0..8).for_each(|_| few());
        let few = start.elapsed();
        let start = Instant::now();
        many();
        least = least.min(start.elapsed().as_secs_f64() / few.as_secs_f64());
        if least < 1.5 {
            break;
        }
    }
    least
}

#[test]
fn time_follows_the_number_of_grids() {
    const FEW: usize = 4_000;
    for shared in [false, true] {
        let [few, many] = [FEW, 8 * FEW].map(|count| {
            let file = many_grids(count, shared);
            let names = (0..count).map(|number| format!("grid[{number}]")).collect();
            let bytes = file.write(&WriteOptions::default()).unwrap();
            let again = VdbFile::read(&bytes, &ReadOptions::default()).unwrap();
            let own = again.grids.iter().filter(|grid| grid.instance_of.is_none()).count();
            assert_eq!(own, if shared { 1 } else { count });
            let first = &again.grids[0].tree;
            assert!(!shared || again.grids.iter().all(|grid| grid.tree.shares_with(first)));
            let grids = vdb_core::GridSelection::Names(names);
            (count, file, bytes, ReadOptions { grids, ..Default::default() })
        });
        let write = |(_, file, bytes, _): &(usize, VdbFile, Vec<u8>, ReadOptions)| {
            assert_eq!(file.write(&WriteOptions::default()).unwrap().len(), bytes.len());
        };
        let read = |(count, _, bytes, _): &(usize, VdbFile, Vec<u8>, ReadOptions)| {
            let file = VdbFile::read(bytes, &ReadOptions::default()).unwrap();
            assert_eq!(file.grids.len(), *count);
        };
        let choose = |(count, _, bytes, options): &(usize, VdbFile, Vec<u8>, ReadOptions)| {
            assert_eq!(VdbFile::read(bytes, options).unwrap().grids.len(), *count);
        };
        for (what, growth) in [
            ("writing", growth(|| write(&few), || write(&many))),
            ("reading", growth(|| read(&few), || read(&many))),
            ("choosing", growth(|| choose(&few), || choose(&many))),
        ] {
            println!("{what}, shared {shared}: {growth:.2}");
            assert!(growth < 2.5, "{what}, shared {shared}: {growth:.2}");
        }
    }
}

/// A tree that many grids share is gone through once.
#[test]
fn a_shared_tree_is_looked_at_once() {
    let mut tree = Vdb543::new(0.0_f32);
    for x in 0..60 {
        for y in 0..60 {
            tree.set(8 * IVec3::new(x, y, x % 7), 1.0);
        }
    }
    let tree = AnyTree::Float(tree.into());
    let write = |count: usize| {
        let grids = (0..count).map(|_| Grid::new("grid", tree.clone())).collect();
        let file = VdbFile::new(grids);
        least(|| assert!(!file.write(&WriteOptions::default()).unwrap().is_empty()))
    };
    let (one, many) = (write(1), write(500));
    println!("one {one:?}, 500 {many:?}");
    assert!(many < 10 * one.max(Duration::from_millis(5)), "one {one:?}, 500 {many:?}");
}
