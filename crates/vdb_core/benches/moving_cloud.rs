//! Makes the frames of `frames sequence`: a cloud that turns and churns, seamlessly in a loop.
//!
//! `cargo bench -p vdb_core --bench moving_cloud -- CLOUD.vdb FRAMES OUT_DIR` writes
//! `OUT_DIR/cloud_0001.vdbc` and so on, and every twentieth frame as `.vdb` with 16-bit floats, to
//! compare sizes. With `--raw`, all frames are `.vdb` files and none is cooked; with `--half`, the
//! cloud has half the resolution. Without arguments nothing is made.

use std::error::Error;
use std::f32::consts::TAU;
use std::path::Path;

use glam::{IVec3, Vec3};
use rayon::prelude::*;
use vdb_core::cooked::{CookOptions, CookedFile};
use vdb_core::synth::fog;
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::{AnyTree, Grid, GridClass, VdbFile, WriteOptions};

/// The farthest that a voxel is carried, as a part of the cloud's longest edge.
const REACH: f32 = 0.025;

fn main() -> Result<(), Box<dyn Error>> {
    let (options, words): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|word| word.starts_with("--"));
    let [cloud, frames, out] = &words[..] else {
        println!("nothing made; name CLOUD.vdb FRAMES OUT_DIR");
        return Ok(());
    };
    let has = |name: &str| options.iter().any(|option| option == name);
    let (frames, out): (u32, _) = (frames.parse()?, Path::new(out));
    std::fs::create_dir_all(out)?;
    let is_raw = has("--raw");
    let step = if has("--half") { 2 } else { 1 };
    let still = Dense::read(cloud, step)?;
    let sums = (1..=frames).into_par_iter().map(|number| {
        let phase = TAU * (number - 1) as f32 / frames as f32;
        let tree = still.moved(phase);
        let mut own = Sums { voxels: tree.active_voxel_count(), ..Sums::default() };
        let mut grid = Grid::new("density", AnyTree::Float(tree.into()));
        (grid.class, grid.saved_as_half) = (GridClass::FogVolume, true);
        let file = VdbFile::new(vec![grid]);
        let path = out.join(format!("cloud_{number:04}"));
        if !is_raw {
            let cooked = CookedFile::cook(&file, &CookOptions::default())?;
            own.cooked = cooked.save(path.with_extension("vdbc"))?;
        }
        if is_raw || number % 20 == 1 {
            let bytes = file.write(&WriteOptions::default())?;
            own.raw = [1, bytes.len() as u64, own.cooked];
            if is_raw {
                std::fs::write(path.with_extension("vdb"), bytes)?;
            }
        }
        Ok(own)
    });
    let Sums { voxels, cooked, raw: [raw_frames, raw, raw_cooked] } = sums
        .try_reduce(Sums::default, |a, b| Ok(a.add(&b)))
        .map_err(|error: Box<dyn Error + Send + Sync>| error as Box<dyn Error>)?;
    let mean = |sum: u64, count: u64| sum as f64 / count as f64 / 1e6;
    println!("{frames} frames of {:.2} million active voxels", mean(voxels, frames.into()));
    println!("a .vdb file of 16-bit floats, Blosc: {:.2} MB", mean(raw, raw_frames));
    if cooked > 0 {
        let ratio = raw_cooked as f64 / raw as f64;
        println!("a cooked file: {:.2} MB, {ratio:.2} of that", mean(cooked, frames.into()));
    }
    Ok(())
}

/// What some frames have together.
#[derive(Default)]
struct Sums {
    voxels: u64,
    /// The bytes of their cooked files.
    cooked: u64,
    /// Of those that are written as `.vdb`: how many, their bytes, and the bytes of the same cooked.
    raw: [u64; 3],
}

impl Sums {
    fn add(&self, other: &Self) -> Self {
        Self {
            voxels: self.voxels + other.voxels,
            cooked: self.cooked + other.cooked,
            raw: [0, 1, 2].map(|i| self.raw[i] + other.raw[i]),
        }
    }
}

/// A cloud as an array.
struct Dense {
    low: IVec3,
    size: IVec3,
    values: Vec<f32>,
}

impl Dense {
    /// Every voxel of a file's first grid, or every second one on each axis.
    fn read(path: &str, step: i32) -> Result<Self, Box<dyn Error>> {
        let file = VdbFile::open(path)?;
        let tree = file.grids.into_iter().find_map(|grid| match grid.tree {
            AnyTree::Float(tree) => Some(tree),
            _ => None,
        });
        let tree = tree.ok_or("the file has no grid of floats")?;
        let bbox = tree.active_bbox().ok_or("the grid is empty")?;
        let (low, high) = (bbox.min / step, bbox.max / step);
        let size = high - low + 1;
        let plane = (size.y * size.z) as usize;
        let mut values = vec![0.0; size.x as usize * plane];
        values.par_chunks_mut(plane).zip(0..size.x).for_each(|(plane, x)| {
            let mut accessor = tree.accessor();
            for (i, value) in plane.iter_mut().enumerate() {
                let (y, z) = (i as i32 / size.z, i as i32 % size.z);
                *value = accessor.get((low + IVec3::new(x, y, z)) * step);
            }
        });
        Ok(Self { low, size, values })
    }

    /// The cloud at a time from 0 to 2π: each voxel comes from a place on a small orbit around its
    /// own, whose phase changes through space.
    fn moved(&self, time: f32) -> Vdb543<f32> {
        let edge = self.size.max_element() as f32;
        let reach = REACH * edge;
        let margin = reach.ceil() as i32;
        let bbox = CoordBox { min: self.low - margin, max: self.low + self.size + margin };
        let wave = Vec3::new(7.0, 5.0, 6.0) * TAU / edge;
        fog::from_densities(bbox, |ijk| {
            let at = (ijk - self.low).as_vec3();
            let phase = (at * wave).dot(Vec3::ONE) * 0.5;
            let orbit = Vec3::new(
                (time + phase).cos(),
                (time + at.x * wave.x).sin(),
                (2.0 * time + at.y * wave.y).cos(),
            );
            self.at(at + reach * orbit)
        })
    }

    /// The trilinear interpolant; 0 outside.
    fn at(&self, at: Vec3) -> f32 {
        let low = at.floor();
        let (cell, part) = (low.as_ivec3(), at - low);
        if cell.cmplt(IVec3::ZERO).any() || cell.cmpge(self.size - 1).any() {
            return 0.0;
        }
        let (row, plane) = (self.size.z as usize, (self.size.y * self.size.z) as usize);
        let first = cell.x as usize * plane + cell.y as usize * row + cell.z as usize;
        let mix = |a: f32, b: f32, u: f32| a + (b - a) * u;
        let z = |i: usize| mix(self.values[i], self.values[i + 1], part.z);
        let y = |i: usize| mix(z(i), z(i + row), part.y);
        let value = mix(y(first), y(first + plane), part.x);
        // As compact at its rim as the cloud that it is made of.
        if value < 1e-3 { 0.0 } else { value }
    }
}
