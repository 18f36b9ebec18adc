//! Grid and camera shifted together: the same rays relative to the grid, and the same answers, bit
//! for bit.

use glam::{DAffine3, DMat4, DQuat, DVec3, EulerRot, IVec3};
use vdb_core::pack::PackKind;
use vdb_core::synth::Random;
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::view::{GpuRays, LatticeRays, ViewRays};
use vdb_probe::judge::{Scene, Tally};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::Suite;
use crate::grids::Tree;
use crate::report::{Bound, Row};
use crate::{fog, smooth, voxels};

/// Pixels along the edge of a picture.
const EDGE: u32 = 64;
/// Shifts in the short form.
const SHIFTS: usize = 6;
/// Voxels along the edge of the box that holds the grid.
const BOX: i32 = 48;

/// A blob with a rough surface, or a density, that depends on the voxel relative to the shift alone.
fn blob(shift: IVec3, kind: PackKind) -> Tree {
    let background = if kind == PackKind::Fog { 0.0 } else { 3.0 };
    let mut tree = Vdb543::new(background);
    let middle = DVec3::splat(f64::from(BOX) / 2.0);
    for x in 0..BOX {
        for y in 0..BOX {
            for z in 0..BOX {
                let ijk = IVec3::new(x, y, z);
                let p = ijk.as_dvec3();
                let waves = (p * 0.7).map(f64::sin).element_product();
                let distance = ((p - middle).length() - 17.0 + 2.0 * waves) as f32;
                match kind {
                    PackKind::Fog if distance < 0.0 => tree.set(shift + ijk, -distance * 0.1),
                    PackKind::Fog => {}
                    _ if distance.abs() < 3.0 => tree.set(shift + ijk, distance),
                    _ if distance < 0.0 => tree.set_inactive(shift + ijk, -3.0),
                    _ => {}
                }
            }
        }
    }
    tree
}

/// What a ray is relative to the shift, and what it met: as bits.
fn relative(kind: PackKind, ray: &ProbeRay, hit: &ProbeHit, base: IVec3) -> [u32; 15] {
    let cell =
        |cell: [i32; 3]| IVec3::from_array(cell).wrapping_add(base).to_array().map(|c| c as u32);
    let bits = |v: [f32; 3]| v.map(f32::to_bits);
    // Of what was met, what the question is about.
    let t = [hit.hit, hit.axis, hit.t.to_bits()];
    let (place, answer) = match kind {
        PackKind::Fog => ([0; 3], [0, 0, hit.optical_length.to_bits()]),
        _ if hit.hit == 0 => ([0; 3], [0; 3]),
        PackKind::Surface { .. } => (cell(hit.cell), t),
        PackKind::Smooth { .. } => (bits(hit.gradient), t),
    };
    let parts = [cell(ray.cell), bits(ray.frac), bits(ray.dir), place, answer];
    let mut all = [0; 15];
    all.copy_from_slice(parts.as_flattened());
    all
}

fn picture(suite: &Suite, kind: PackKind, shift: IVec3) -> Vec<[u32; 15]> {
    let tree = blob(shift, kind);
    debug_assert!(tree.active_bbox().is_none_or(|b: CoordBox| b.min.cmpge(shift).all()));
    let scene = Scene::new(suite.gpu, &tree, kind).expect("there is something to see");
    let rays = ViewRays::new(DMat4::perspective_infinite_reverse_rh(0.6, 1.0, 0.1));
    // Multiples of 2⁻²⁰, to which f64 can add any shift.
    let eye = DVec3::new(70.25, 31.0 + 1.0 / 1024.0, 66.5);
    let turn = DQuat::from_euler(EulerRot::YXZ, 0.83, 0.07, 0.3);
    let view = DAffine3::from_rotation_translation(turn, eye + shift.as_dvec3());
    let lattice = LatticeRays::new(&rays.expect("it can"), view, DAffine3::IDENTITY, &scene.grid);
    let lattice = lattice.expect("it can be shown");
    let rays = GpuRays::from(&lattice);
    let (rays, hits) = suite.probe(kind).picture(&scene.on_gpu, &rays, [EDGE; 2]);
    let base = scene.grid.base.wrapping_sub(shift);
    rays.iter().zip(&hits).map(|(ray, hit)| relative(kind, ray, hit, base)).collect()
}

pub fn run(suite: &mut Suite) {
    for (name, kind) in [("voxels", voxels::KIND), ("smooth", smooth::KIND), ("fog", fog::KIND)] {
        let case = format!("{name}, shifted by up to 2^30 voxels");
        if !suite.wants(&format!("invariance: {case}")) {
            continue;
        }
        let here = picture(suite, kind, IVec3::ZERO);
        let mut random = Random::new(suite.seed);
        let mut tally = Tally::default();
        for _ in 0..SHIFTS * suite.some_times() {
            let shift = [0; 3].map(|_| random.below(1 << 31) as i64 - (1 << 30)).map(|c| c as i32);
            let there = picture(suite, kind, IVec3::from_array(shift));
            for (a, b) in here.iter().zip(&there) {
                tally.rays += 1;
                tally.met += u64::from(a[14] != 0);
                if a != b {
                    tally.wrong += 1;
                    tally.show(|| format!("shifted by {shift:?}: {a:x?} becomes {b:x?}"));
                }
            }
        }
        let row = Row::new("invariance", case, "bits", Bound::Max(0.0), &tally);
        suite.report.add(row, &tally);
    }
}
