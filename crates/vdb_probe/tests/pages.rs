//! A grid larger than one binding, as small as that can be made: cut into pages, it answers alike.

use glam::DVec3;
use vdb_core::pack::{PackKind, PackedGrid, ValueFormat, traverse};
use vdb_core::synth::{Random, level_set};
use vdb_probe::{Gpu, GpuGrid, Probe, ProbeKind, ProbeRay};

const RAYS: usize = 2000;

/// Rays from around a ball of 20 voxels towards it.
fn rays(grid: &PackedGrid, random: &mut Random) -> Vec<ProbeRay> {
    let mut ray = || {
        let mut place = |radius: f64| {
            DVec3::from_array([0; 3].map(|_| random.range(-radius, radius))).as_vec3()
        };
        let (from, to) = (place(40.0), place(20.0));
        let cell = from.floor();
        traverse::Ray::from_index(grid, cell.as_ivec3(), from - cell, to - from).into()
    };
    (0..RAYS).map(|_| ray()).collect()
}

#[test]
fn pages_answer_as_one_piece_does() {
    let Some(gpu) = Gpu::find() else { return };
    let tree = level_set::sphere(DVec3::ZERO, 20.0);
    let mut most_pages = 0;
    let mut random = Random::new(1);
    for (ask, kind) in [
        (ProbeKind::Voxels, PackKind::Surface { iso: 0.0 }),
        (ProbeKind::Smooth, PackKind::Smooth { iso: 0.0 }),
        (ProbeKind::Fog, PackKind::Fog),
    ] {
        for format in [ValueFormat::Exact, ValueFormat::Half, ValueFormat::Byte] {
            let grid = PackedGrid::with_format(&tree, kind, format).unwrap();
            let rays = rays(&grid, &mut random);
            let page = grid.words.len().div_ceil(3).next_power_of_two();
            most_pages = most_pages.max(grid.words.len().div_ceil(page));
            let whole = GpuGrid::paged(&gpu, &grid, None);
            let cut = GpuGrid::paged(&gpu, &grid, Some(page.ilog2()));
            let probe = Probe::new(&gpu, ask);
            let [expected, hits] = [whole, cut].map(|grid| probe.send(&grid, &rays));
            let met = |hit: &&vdb_probe::ProbeHit| hit.hit == 1 || hit.optical_length > 0.0;
            let met = expected.iter().filter(met).count();
            assert!(met > RAYS / 10, "{met} rays meet something");
            for (i, (hit, expected)) in hits.iter().zip(&expected).enumerate() {
                assert_eq!(hit, expected, "{kind:?}, {format:?}, ray {i}");
            }
        }
    }
    assert_eq!(most_pages, 3);
}
