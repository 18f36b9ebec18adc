//! Fog by samples at even distances, beside the exact integral and closed forms.

use glam::{DVec3, IVec3, Vec3};
use vdb_core::pack::{PackKind, PackedGrid, ValueFormat, traverse};
use vdb_core::synth::{Random, fog};
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_probe::{Gpu, GpuGrid, Probe, ProbeKind, ProbeRay};

const RAYS: usize = 2000;

fn pack(tree: &Vdb543<f32>, format: ValueFormat) -> PackedGrid {
    PackedGrid::with_format(tree, PackKind::Fog, format).unwrap()
}

/// Rays through a ball of 30 voxels, of length 1 a unit of t.
fn rays(grid: &PackedGrid, shift: IVec3) -> Vec<ProbeRay> {
    let mut random = Random::new(1);
    let mut ray = || {
        let mut place = |radius: f64| {
            DVec3::from_array([0; 3].map(|_| random.range(-radius, radius))).as_vec3()
        };
        let (from, to) = (place(60.0), place(20.0));
        let cell = from.floor();
        let dir = (to - from).normalize();
        traverse::Ray::from_index(grid, cell.as_ivec3() + shift, from - cell, dir).into()
    };
    (0..RAYS).map(|_| ray()).collect()
}

fn lengths(gpu: &Gpu, grid: &PackedGrid, rays: &[ProbeRay], defs: &[&str]) -> Vec<f32> {
    let probe = Probe::with_defs(gpu, ProbeKind::Fog, defs);
    let hits = probe.send(&GpuGrid::new(gpu, grid), rays);
    hits.iter().map(|hit| hit.optical_length).collect()
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn smaller_steps_come_closer_to_the_integral() {
    let Some(gpu) = Gpu::find() else { return };
    let tree = fog::sphere(DVec3::ZERO, 30.0, 12.0);
    let grid = pack(&tree, ValueFormat::Exact);
    let rays = rays(&grid, IVec3::ZERO);
    let exact = lengths(&gpu, &grid, &rays, &[]);
    assert!(exact.iter().filter(|&&length| length > 20.0).count() > RAYS / 4);
    let off = [16, 4, 1].map(|step| {
        let stepped = lengths(&gpu, &grid, &rays, &[&format!("STEP={step}")]);
        largest_difference(&exact, &stepped)
    });
    // The density has kinks at both ends of its fall, of slope 1/12: what the rule of midpoints gets
    // wrong at one is at most step² / 8 · slope, and a ray meets four.
    for (off, step) in off.into_iter().zip([4.0_f32, 1.0, 0.25]) {
        let bound = 4.0 * step * step / 8.0 / 12.0 + 2e-3;
        assert!(off <= bound, "{off} with steps of {step} voxels, more than {bound}");
    }
    assert!(off[0] > 4.0 * off[1], "{off:?}: the step changes nothing");
}

#[test]
fn a_block_of_tiles_has_the_length_of_its_chord() {
    let Some(gpu) = Gpu::find() else { return };
    // Tiles of 128³ and leaves of 8³ side by side, then nothing.
    let bbox = CoordBox { min: IVec3::ZERO, max: IVec3::new(263, 127, 127) };
    let tree = fog::block(bbox, 0.5);
    assert!(tree.stats().active_tiles() > 0);
    let grid = pack(&tree, ValueFormat::Exact);
    let along = |dir: Vec3, cell: IVec3| -> ProbeRay {
        traverse::Ray::from_index(&grid, cell, Vec3::splat(0.3), dir).into()
    };
    let rays = [
        along(Vec3::X, IVec3::new(-50, 60, 60)),
        along(Vec3::NEG_X, IVec3::new(400, 60, 60)),
        along(Vec3::Y, IVec3::new(100, -50, 3)),
        along(Vec3::NEG_Z, IVec3::new(256, 60, 300)),
    ];
    // Between the outermost samples the density is 0.5, and it falls to 0 within a voxel.
    let chords = [264.0_f32, 264.0, 128.0, 128.0];
    let stepped = lengths(&gpu, &grid, &rays, &["STEP=4"]);
    for (length, chord) in stepped.into_iter().zip(chords) {
        assert!((length - 0.5 * chord).abs() <= 0.5, "{length}, not {}", 0.5 * chord);
    }
}

#[test]
fn formats_are_as_good_as_their_bits() {
    let Some(gpu) = Gpu::find() else { return };
    let tree = fog::sphere(DVec3::ZERO, 30.0, 12.0);
    let exact = pack(&tree, ValueFormat::Exact);
    let rays = rays(&exact, IVec3::ZERO);
    for defs in [&[][..], &["STEP=2"]] {
        let expected = lengths(&gpu, &exact, &rays, defs);
        // Errors of 2⁻¹² for densities of up to 1, or half a step of 1/255, over 60 voxels at most.
        for (format, bound) in
            [(ValueFormat::Half, 60.0 / 4096.0), (ValueFormat::Byte, 60.0 / 510.0)]
        {
            let grid = pack(&tree, format);
            assert!(grid.bytes() < exact.bytes());
            let off = largest_difference(&expected, &lengths(&gpu, &grid, &rays, defs));
            assert!(off > 0.0 && off <= bound, "{format:?}: {off}");
        }
    }
}

#[test]
fn samples_do_not_depend_on_where_the_grid_is() {
    let Some(gpu) = Gpu::find() else { return };
    let at = |shift: IVec3| {
        let tree = fog::sphere(shift.as_dvec3(), 30.0, 12.0);
        let grid = pack(&tree, ValueFormat::Exact);
        lengths(&gpu, &grid, &rays(&grid, shift), &["STEP=8"])
    };
    let here = at(IVec3::ZERO);
    assert_eq!(here, at(IVec3::new(1 << 20, -(1 << 22), 777)));
}
