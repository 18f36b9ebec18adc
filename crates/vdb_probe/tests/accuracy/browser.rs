//! Files with which a browser repeats the cases of first voxels: kernels, packed grids, rays and the right answers.
//! `scripts/browser` asks for them, and `browser/page.js` reads them.

use std::fs;
use std::path::Path;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use serde_json::json;
use vdb_core::pack::exact::T_ERROR;
use vdb_core::reference::standard::Upper;
use vdb_core::reference::{Blocky, Occupied, standard};
use vdb_core::synth::Random;
use vdb_core::tree::IVec3;
use vdb_probe::ProbeRay;
use vdb_probe::judge::Scene;
use vdb_probe::judge::given::{self, Targets, chunks};

use crate::case::{Suite, hash};
use crate::grids::{self};
use crate::voxels::{ENDED, KIND, RAYS};

/// Rays that are traced at once, here and in the browser: few enough for a software driver to finish before a
/// browser considers it hung.
const BATCH: usize = 1 << 16;

/// The right answer to a ray, as `page.js` reads it.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Answer {
    /// Not rounded to f32, or else the bound of its error would be a little off.
    t: f64,
    cell: [i32; 3],
    /// The axis of the face, 3 if the ray begins inside, or [`MISS`].
    face: u32,
}

const MISS: u32 = 4;

/// Writes the cases, traces each here as well, and writes the list of them last.
pub fn write(suite: &Suite, folder: &Path) -> std::io::Result<()> {
    fs::create_dir_all(folder)?;
    let solids = grids::solids().into_iter().map(|grid| (grid.name, (grid.make)()));
    let offsets = grids::offsets().map(|(name, tree)| (format!("offset {name}"), tree));
    let (mut cases, mut kernels, mut entry) = (Vec::new(), Vec::new(), "");
    for (name, tree) in solids.chain(offsets) {
        if !suite.wants(&format!("voxels: {name}")) {
            continue;
        }
        let scene = Scene::new(suite.gpu, &tree, KIND).expect("there are voxels");
        let (kernel, point) = suite.voxels.wgsl(&scene.on_gpu);
        entry = point;
        let kernel = kernels.iter().position(|known| *known == kernel).unwrap_or_else(|| {
            kernels.push(kernel);
            kernels.len() - 1
        });
        let rays = rays(suite, &name, &scene);
        let number = cases.len();
        let save =
            |what: &str, bytes: &[u8]| fs::write(folder.join(format!("{number}.{what}")), bytes);
        save("grid", bytemuck::bytes_of(&scene.grid.header(0)))?;
        save("words", bytemuck::cast_slice(&scene.grid.words))?;
        save("rays", bytemuck::cast_slice(&rays))?;
        save("answers", bytemuck::cast_slice(&answers(&scene, &rays)))?;
        let seconds = seconds_here(suite, &scene, &rays);
        println!("{name}: {} rays, {:.0} per second here", rays.len(), rays.len() as f64 / seconds);
        cases.push(json!({
            "name": name,
            "kernel": kernel,
            "rays": rays.len(),
            "mostSteps": scene.most_steps(),
            "secondsHere": seconds,
        }));
    }
    let list = json!({
        "adapter": suite.gpu.name(),
        "batch": BATCH,
        "tError": T_ERROR,
        "entry": entry,
        "kernels": kernels,
        "cases": cases,
    });
    fs::write(folder.join("cases.json"), list.to_string())
}

/// The suite's random rays, hard ones and ones with ends.
fn rays(suite: &Suite, name: &str, scene: &Scene) -> Vec<ProbeRay> {
    let targets = Targets::new(scene.tree, &scene.grid);
    let kinds = [
        ("random", given::plain as given::Make, RAYS),
        ("hard", given::hard, RAYS),
        ("ends", given::ended, ENDED),
    ];
    let of_kind = |(kind, make, count): (&str, given::Make, usize)| {
        let make = |random: &mut Random| make(random, &targets, &scene.grid);
        chunks(suite.seed_of(hash(name) ^ hash(kind)), 0, count * suite.times, &make)
    };
    kinds.into_iter().flat_map(of_kind).collect()
}

fn answers(scene: &Scene, rays: &[ProbeRay]) -> Vec<Answer> {
    let oracle: Blocky<'_, Upper> = Blocky::new(scene.tree, Occupied::BelowIso(0.0));
    let answer = |ray: &ProbeRay| match standard::first_voxel(&oracle, &scene.exact(ray)) {
        None => Answer { t: 0.0, cell: [0; 3], face: MISS },
        Some(hit) => Answer {
            t: hit.t,
            cell: IVec3::wrapping_sub(hit.ijk, scene.grid.base).to_array(),
            face: hit.face.map_or(3, |face| face.axis.into()),
        },
    };
    rays.par_iter().map(answer).collect()
}

/// The time that this adapter takes, with sending rays and reading answers, after one ray has had the kernel
/// compiled.
fn seconds_here(suite: &Suite, scene: &Scene, rays: &[ProbeRay]) -> f64 {
    suite.voxels.send(&scene.on_gpu, &rays[..1]);
    let start = Instant::now();
    rays.chunks(BATCH).for_each(|rays| drop(suite.voxels.send(&scene.on_gpu, rays)));
    start.elapsed().as_secs_f64()
}
