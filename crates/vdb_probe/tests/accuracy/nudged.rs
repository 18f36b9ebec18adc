//! The same voxels by the traversal of the thesis, which nudges its position: what the design buys. Shown
//! beside the suite's table, held to nothing.

use vdb_core::reference::standard::Upper;
use vdb_core::reference::{Blocky, Occupied, standard};
use vdb_core::synth::Random;
use vdb_core::tree::IVec3;
use vdb_core::view::GpuRays;
use vdb_probe::judge::given::{self, Targets};
use vdb_probe::judge::{Scene, Tally, judged};
use vdb_probe::{Kernel, ProbeHit, ProbeRay};

use crate::case::{Suite, hash};
use crate::grids::{self, Named, OFFSETS};
use crate::report::{Bound, Row};
use crate::views::{self, DISTANCES};
use crate::voxels;

/// Rays of each case, however many the suite itself takes.
const RAYS: usize = 10_000;
/// Pixels along the edge of a picture.
const EDGE: u32 = 8;
/// What the shader gives as `t` of a ray that used up its steps.
const STUCK: f32 = -1.0;

fn send(suite: &Suite, kernel: &Kernel, scene: &Scene, rays: &[ProbeRay]) -> Vec<ProbeHit> {
    let gpu = suite.gpu;
    let given = gpu.storage(bytemuck::cast_slice(rays));
    let bytes = (rays.len() * size_of::<ProbeHit>()) as u64;
    let hits = gpu.output(bytes);
    let base = gpu.uniform(bytemuck::bytes_of(&scene.grid.base.extend(0).to_array()));
    let mut buffers = scene.on_gpu.bindings();
    buffers.extend([(4, &given), (5, &hits), (6, &base)]);
    gpu.run(kernel, &buffers, [(rays.len() as u32).div_ceil(64), 1, 1]);
    bytemuck::pod_collect_to_vec(&gpu.read(&hits, bytes))
}

fn judge(
    scene: &Scene,
    oracle: &Blocky<'_, Upper>,
    ray: &ProbeRay,
    hit: &ProbeHit,
    tally: &mut Tally,
) {
    let truth = standard::first_voxel(oracle, &scene.exact(ray));
    let truth = truth.map(|hit| (hit.ijk, hit.face.map_or(3, |face| face.axis.into())));
    let cell = IVec3::from_array(hit.cell).wrapping_add(scene.grid.base);
    let found = (hit.hit != 0).then_some((cell, hit.axis));
    tally.met += u64::from(truth.is_some());
    tally.stuck += u64::from(hit.t == STUCK);
    if found != truth {
        tally.wrong += 1;
        let same = matches!((found, truth), (Some((a, _)), Some((b, _))) if a == b);
        tally.wrong_faces += u64::from(same);
    }
}

pub fn run(suite: &mut Suite) {
    if !suite.wants("nudged: ") {
        return;
    }
    let kernel = suite.gpu.kernel(include_str!("nudged.wgsl"), "nudged", &[]);
    let mut rows = Vec::new();
    let offsets = grids::offsets().map(|(name, tree)| (format!("offset {name}"), tree));
    let solids = grids::solids().into_iter().map(|Named { name, make }| (name, make()));
    for (name, tree) in solids.chain(offsets) {
        let scene = Scene::new(suite.gpu, &tree, voxels::KIND).expect("there are voxels");
        let targets = Targets::new(&tree, &scene.grid);
        let oracle = Blocky::new(&tree, Occupied::BelowIso(0.0));
        let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| {
            judge(&scene, &oracle, ray, hit, tally)
        };
        for (kind, make) in [("random", given::plain as given::Make), ("hard", given::hard)] {
            let mut random = Random::new(suite.seed ^ hash(&name) ^ hash(kind));
            let rays: Vec<ProbeRay> =
                (0..RAYS).map(|_| make(&mut random, &targets, &scene.grid)).collect();
            let hits = send(suite, &kernel, &scene, &rays);
            rows.push(row(format!("{name}, {kind}"), &judged(suite.gpu, &rays, &hits, &judge)));
        }
    }
    rows.extend(cameras(suite, &kernel));
    for row in rows {
        suite.report.add_beside(row);
    }
}

fn row(case: String, tally: &Tally) -> Row {
    let row = Row::new("nudged", case, "", Bound::None, tally);
    row.and(tally.wrong_faces, "faces alone").and(tally.stuck, "stood still")
}

/// The views of the suite of the grid at the origin of index space, where this traversal is at its best,
/// with the very rays that the suite's own traversal gets.
fn cameras(suite: &Suite, kernel: &Kernel) -> Vec<Row> {
    let tree = grids::ball(0);
    let scene = Scene::new(suite.gpu, &tree, voxels::KIND).expect("there are voxels");
    let oracle = Blocky::new(&tree, Occupied::BelowIso(scene.iso()));
    let mut tallies: Vec<Tally> = DISTANCES.iter().map(|_| Tally::default()).collect();
    for (d, _, view) in views::all(suite.seed).filter(|(_, o, _)| OFFSETS[*o].1 == 0) {
        let Some(Ok(lattice)) = view.camera().map(|camera| camera.lattice(&scene.grid)) else {
            continue;
        };
        let rays = GpuRays::from(&lattice);
        let (rays, _) = suite.voxels.picture(&scene.on_gpu, &rays, [EDGE; 2]);
        let hits = send(suite, kernel, &scene, &rays);
        let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| {
            judge(&scene, &oracle, ray, hit, tally)
        };
        tallies[d] = std::mem::take(&mut tallies[d]).merge(judged(suite.gpu, &rays, &hits, &judge));
    }
    let rows = DISTANCES.iter().zip(&tallies);
    rows.map(|((name, _), tally)| row(format!("camera at {name} voxels"), tally)).collect()
}
