//! A grid as a dense texture.

use std::path::Path;
use std::time::Instant;

use bevy::math::IVec3;
use bevy::render::render_resource::TextureFormat;
use half::f16;
use vdb_core::tree::{CoordBox, Vdb543};
use vdb_core::{AnyTree, VdbFile};

/// How a texel is stored.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A byte, as in Bevy's example.
    R8,
    /// 16-bit floats, which the files have as well.
    R16,
}

impl Format {
    pub fn named(name: &str) -> Option<Self> {
        [Self::R8, Self::R16].into_iter().find(|format| format.name() == name)
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::R8 => "r8",
            Self::R16 => "r16",
        }
    }

    pub fn on_gpu(self) -> TextureFormat {
        match self {
            Self::R8 => TextureFormat::R8Unorm,
            Self::R16 => TextureFormat::R16Float,
        }
    }
}

/// The densities of all voxels in the box of the active ones, with one voxel around it in which fog
/// falls off to nothing, as it does between samples.
pub struct Density {
    pub name: String,
    pub format: Format,
    /// Of the active voxels, in index space.
    pub active: CoordBox,
    pub active_voxels: u64,
    /// Voxels of the texture.
    pub dim: [u32; 3],
    /// x fastest.
    pub texels: Vec<u8>,
    /// Milliseconds from the tree to the texels.
    pub fill_ms: f64,
}

impl Density {
    /// Reads the first grid of floats of a file. Densities go from 0 to 1 in R8.
    pub fn read(path: &Path, format: Format) -> Result<Self, String> {
        let file = VdbFile::open(path).map_err(|error| error.to_string())?;
        let tree = file.grids.into_iter().find_map(|grid| match grid.tree {
            AnyTree::Float(tree) => Some(tree),
            _ => None,
        });
        let tree = tree.ok_or("has no grid of floats")?;
        let active = tree.active_bbox().ok_or("has no active voxel")?;
        let around = CoordBox { min: active.min - 1, max: active.max + 1 };
        let dim = around.dim();
        // What every GPU takes.
        if dim.iter().any(|&edge| edge > 2048) {
            return Err(format!("{dim:?} voxels are more than a texture holds"));
        }
        let dim = dim.map(|edge| edge as u32);
        let start = Instant::now();
        let texels = match format {
            Format::R8 => {
                fill(&tree, around, |value| [(value.clamp(0.0, 1.0) * 255.0).round() as u8])
            }
            Format::R16 => fill(&tree, around, |value| f16::from_f32(value).to_le_bytes()),
        };
        let fill_ms = start.elapsed().as_secs_f64() * 1e3;
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
        let active_voxels = tree.active_voxel_count();
        Ok(Self { name, format, active, active_voxels, dim, texels, fill_ms })
    }
}

fn fill<const N: usize>(
    tree: &Vdb543<f32>,
    around: CoordBox,
    texel: impl Fn(f32) -> [u8; N],
) -> Vec<u8> {
    let [nx, ny, nz] = around.dim().map(|edge| edge as usize);
    let mut texels = vec![[0; N]; nx * ny * nz];
    for value in tree.values().filter(|value| value.value != 0.0) {
        let Some(bbox) = value.bbox().intersection(around) else { continue };
        let (low, high) = (bbox.min - around.min, bbox.max - around.min);
        let texel = texel(value.value);
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let at = IVec3::new(x, y, z).as_usizevec3();
                    texels[(at.z * ny + at.y) * nx + at.x] = texel;
                }
            }
        }
    }
    texels.into_flattened()
}
