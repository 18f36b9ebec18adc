//! What lies far apart is reached in few steps.

use glam::{IVec3, Vec3};
use vdb_core::pack::{PackKind, PackedGrid, traverse};
use vdb_core::tree::Vdb543;
use vdb_probe::{Gpu, GpuGrid, Probe, ProbeKind};

#[test]
fn the_top_tree_skips_two_million_voxels_in_a_few_steps() {
    let Some(gpu) = Gpu::find() else { return };
    let far = IVec3::new(2_000_000, 2_000_000, 2_000_000);
    let mut tree = Vdb543::new(1.0);
    tree.set(IVec3::ZERO, -1.0);
    tree.set(far, -1.0);
    let grid = PackedGrid::new(&tree, PackKind::Surface { iso: 0.0 }).unwrap();
    let ray = |cell, dir| traverse::Ray::from_index(&grid, cell, Vec3::ZERO, dir).into();
    let forward = ray(far - IVec3::new(0, 0, 900), Vec3::Z);
    let reverse = ray(far + IVec3::new(0, 0, 1100), Vec3::NEG_ONE);
    let probe = Probe::new(&gpu, ProbeKind::Voxels);
    let hits = probe.send(&GpuGrid::new(&gpu, &grid), &[forward, reverse]);
    assert_eq!(IVec3::from_array(hits[0].cell) + grid.base, far);
    assert_eq!(hits[0].hit, 1);
    for hit in hits {
        assert!(hit.steps < 200, "{} steps", hit.steps);
    }
}
