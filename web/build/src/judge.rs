//! Compares pictures of the page's data with the reference tracer, which shares no code with the page.

use std::path::Path;

use glam::{DAffine3, DVec3, IVec3};
use vdb_core::reference::standard::{self, Upper};
use vdb_core::reference::{Blocky, Fog, Occupied, Ray, Smooth};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, VdbFile};

use crate::cases::{Case, Kind};
use crate::picture::Picture;
use crate::root;

/// Every pixel with these distances from the next is compared.
const STRIDE: [u32; 2] = [3, 5];
/// Neighbours of a ray, in pixels. Where they see something else, the pixel is on an edge: the shader's rays are
/// rounded to f32 and may pass on either side of it. Rounding is a hundred times less.
const NEIGHBOURS: [(f64, f64); 4] = [(-0.01, 0.0), (0.01, 0.0), (0.0, -0.01), (0.0, 0.01)];
/// The least pixels that a comparison is worth something with: in all, and with something of the volume.
const LEAST: [u32; 2] = [2_000, 400];

/// The reference tracer of a kind.
enum Tracer<'a> {
    Voxels(Blocky<'a, Upper>),
    Smooth(Smooth<'a, Upper>),
    Fog(Fog<'a, Upper>),
}

/// Compares a picture. Fails if a pixel that is on no edge differs.
pub fn judge(path: &Path) -> Result<(), String> {
    let case = Case::open(path)?;
    let picture = Picture::open(&case.picture)?;
    let size = [picture.width, picture.height];
    let name = format!("{:?}, {}", case.kind, case.model.display());
    let model = root().join(&case.model);
    let file = VdbFile::open(&model).map_err(|e| format!("{name}: {e}"))?;
    let [grid] = &file.grids[..] else { return Err(format!("{name}: not a single grid")) };
    let AnyTree::Float(tree) = &grid.tree else { return Err(format!("{name}: not floats")) };
    let world_from_index =
        grid.transform.linear().ok_or_else(|| format!("{name}: not a linear transform"))?;
    let tracer = Tracer::new(case.kind, tree);
    let index_from_world = world_from_index.inverse();
    let color = |x, y| {
        let ray = case.ray((x, y), size, index_from_world);
        tracer.color(&ray, world_from_index, case.extinction)
    };
    let (mut compared, mut filled, mut edges, mut wrong, mut largest) = (0, 0, 0, Vec::new(), 0.0);
    for y in (STRIDE[1] / 2..size[1]).step_by(STRIDE[1] as usize) {
        for x in (STRIDE[0] / 2..size[0]).step_by(STRIDE[0] as usize) {
            let (at_x, at_y) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
            let expected = color(at_x, at_y);
            let is_edge = NEIGHBOURS.iter().any(|(dx, dy)| {
                difference(color(at_x + dx, at_y + dy), expected) > tracer.tolerance()
            });
            if is_edge {
                edges += 1;
                continue;
            }
            compared += 1;
            filled += u32::from(expected != tracer.nothing());
            let found = picture.at(x, y);
            let error = difference(found.map(f64::from), expected);
            if error <= tracer.tolerance() {
                largest = f64::max(largest, error);
            } else {
                wrong.push(format!("pixel {x}, {y} is {found:?} instead of {expected:.1?}"));
            }
        }
    }
    println!(
        "{name}: {compared} pixels compared, {filled} of the volume, {edges} on edges left out; \
         {} wrong, largest error of the others {largest:.2}/255",
        wrong.len()
    );
    if !wrong.is_empty() {
        wrong.truncate(5);
        return Err(format!("{name}: {}", wrong.join("; ")));
    }
    if compared < LEAST[0] || filled < LEAST[1] {
        return Err(format!("{name}: too few pixels to tell"));
    }
    Ok(())
}

fn difference(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max)
}

impl<'a> Tracer<'a> {
    fn new(kind: Kind, tree: &'a Vdb543<f32>) -> Self {
        match kind {
            Kind::Voxels => Self::Voxels(Blocky::new(tree, Occupied::BelowIso(0.0))),
            Kind::Smooth => Self::Smooth(Smooth::new(tree, 0.0)),
            Kind::Fog => Self::Fog(Fog::new(tree)),
        }
    }

    /// The greatest difference between a pixel and what it should be, in steps of 8 bits.
    fn tolerance(&self) -> f64 {
        match self {
            Self::Voxels(_) => 0.0,
            // Rounding to 8 bits, and that of the models: their samples are bytes.
            Self::Smooth(_) => 3.0,
            Self::Fog(_) => 2.0,
        }
    }

    /// The colour where there is nothing of the volume.
    fn nothing(&self) -> [f64; 3] {
        match self {
            Self::Voxels(_) | Self::Smooth(_) => [0.0; 3],
            Self::Fog(_) => [255.0; 3],
        }
    }

    /// The colour that `data` in `web/shaders/demo.wgsl` gives to a ray, from 0 to 255.
    fn color(&self, ray: &Ray, world_from_index: DAffine3, extinction: f64) -> [f64; 3] {
        match self {
            Self::Voxels(voxels) => match standard::first_voxel(voxels, ray) {
                Some(hit) => voxel_color(hit.ijk),
                None => self.nothing(),
            },
            Self::Smooth(smooth) => match smooth.first_root(ray) {
                Some(hit) => {
                    let gradient = smooth.shading_gradient(&hit);
                    let normal = world_from_index.matrix3.inverse().transpose() * gradient;
                    let dir = world_from_index.transform_vector3(ray.dir.as_dvec3());
                    let facing = if normal.dot(dir) > 0.0 { -normal } else { normal };
                    ((facing.normalize() * 0.5 + DVec3::splat(0.5)) * 255.0).to_array()
                }
                None => self.nothing(),
            },
            Self::Fog(fog) => [255.0 * fog.transmittance(ray, extinction).value; 3],
        }
    }
}

/// The twin of `pcg` in `web/shaders/scene.wgsl`.
fn pcg(x: u32) -> u32 {
    let state = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

fn voxel_color(ijk: IVec3) -> [f64; 3] {
    let [x, y, z] = ijk.to_array().map(i32::cast_unsigned);
    let bits = pcg(x.wrapping_add(pcg(y.wrapping_add(pcg(z)))));
    [0, 8, 16].map(|shift| f64::from((bits >> shift & 255) | 32))
}
