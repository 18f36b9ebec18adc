//! Grids with other voxels.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::build::{Formula, build, uppers};
use super::from_mesh::{self, InsideRule};
use super::grid::{cube_edge, floats, half_width, pass, replaced};
use super::nodes::{Leaf, State, Upper};
use super::places::{Places, ROUNDING, around, corners};
use super::samples::{Samples, Voxels, content, one_value};
use super::{LevelSetToMesh, MeshToLevelSet, Redistance, ToolError, level_set_to_mesh, redistance};
use crate::tree::{Accessor, IVec3, Node, Vdb543};
use crate::work::debug_options;
use crate::{Grid, GridClass, Limits, ProgressFn, Transform};

/// How values between voxels are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// That of the nearest voxel, for values that must not be mixed, such as labels.
    Nearest,
    /// Linear along each axis, between eight voxels.
    #[default]
    Trilinear,
}

/// Options of [`resample`].
#[derive(Clone)]
pub struct Resample {
    /// The transform of the new grid, which must be linear.
    pub transform: Transform,
    /// How values between voxels are found. The surfaces of level sets are always trilinear.
    pub interpolation: Interpolation,
    /// The limit on memory, [`Limits::tree_bytes`].
    pub limits: Limits,
    /// Reports progress, and may cancel the work.
    pub progress: Option<Arc<ProgressFn>>,
}

impl Resample {
    /// To the voxels of a transform, trilinearly and with default limits.
    pub fn new(transform: Transform) -> Self {
        Self {
            transform,
            interpolation: Interpolation::default(),
            limits: Limits::default(),
            progress: None,
        }
    }

    /// To cubic voxels of a size in world units, with the axes of a grid and its voxel (0, 0, 0). The
    /// axes are those of the world if the grid is in a frustum, or has axes at other than right angles.
    ///
    /// # Errors
    /// If the size is not positive, or too large or too small for a transform.
    pub fn with_voxel_size(grid: &Grid, voxel_size: f64) -> Result<Self, ToolError> {
        let turned = |from: DAffine3| {
            let axes = [0, 1, 2].map(|axis| from.matrix3.col(axis).normalize() * voxel_size);
            let matrix3 = DMat3::from_cols(axes[0], axes[1], axes[2]);
            let transform = Transform::affine(DAffine3 { matrix3, ..from })?;
            cube_edge(&transform).is_ok().then_some(transform)
        };
        let aligned = |translation: DVec3| Transform::uniform(voxel_size, translation);
        let transform = match grid.transform.linear() {
            Some(from) if from.matrix3 == DMat3::from_diagonal(from.matrix3.diagonal().abs()) => {
                aligned(from.translation)
            }
            Some(from) => turned(from).or_else(|| aligned(from.translation)),
            None => aligned(DVec3::ZERO),
        };
        let sound =
            transform.filter(|_| (f64::from(f32::MIN_POSITIVE)..1e36).contains(&voxel_size));
        sound.map(Self::new).ok_or(ToolError::BadSetting {
            setting: "the voxel size",
            value: voxel_size,
            range: "a positive number from 1.2e-38 to 1e36",
        })
    }
}

debug_options!(Resample { transform, interpolation, limits });

/// Makes a grid with the voxels of another transform, at the same place in the world.
///
/// Each voxel has the value that the grid has at its centre, and is active if any voxel that this
/// value is made of is active. Voxels that are larger than those of the grid do not average: values
/// in between are passed over.
///
/// A level set is made anew from its surface, with distances in the new voxels and a band of as many
/// voxels as before. Their edges must be equal.
///
/// # Errors
/// If the grid is not of floats, the transform is not linear, or not one of cubes for a level set,
/// the result would exceed the limits, or it was cancelled.
pub fn resample(grid: &Grid, options: &Resample) -> Result<Grid, ToolError> {
    let tree = floats(grid)?;
    let world_from_new = options.transform.linear().ok_or(ToolError::NotLinear)?;
    if grid.class == GridClass::LevelSet {
        return resampled_level_set(grid, options, world_from_new);
    }
    let tree = sampled(tree, grid, options, options.progress.as_ref())?;
    Ok(Grid { transform: options.transform.clone(), ..replaced(grid, tree) })
}

fn resampled_level_set(
    grid: &Grid,
    options: &Resample,
    world_from_new: DAffine3,
) -> Result<Grid, ToolError> {
    let edge = cube_edge(&options.transform)?;
    if !grid.transform.is_linear() {
        // Distances in a frustum: as long as voxels are not much larger, its values have the surface.
        let own = options.progress.as_ref();
        let tree = sampled(floats(grid)?, grid, options, pass(own, 0, 2).as_ref())?;
        let between = Grid { transform: options.transform.clone(), ..replaced(grid, tree) };
        let limits = options.limits.clone();
        let again = Redistance { limits, progress: pass(own, 1, 2), ..Redistance::default() };
        return redistance(&between, &again);
    }
    // Voxels that are no cubes may become cubes: distances are in world units all the same.
    let tree = floats(grid)?;
    let own_edge = grid.transform.voxel_size().min_element();
    let half_width = half_width(tree, own_edge)?;
    // In the index space of the new voxels.
    let new_from_world = world_from_new.inverse();
    let own = grid.transform.linear().ok_or(ToolError::NotLinear)?;
    let new_from_index = Transform::affine(new_from_world * own).ok_or(ToolError::NotLinear)?;
    // The surface has about as many voxels as before for each square voxel.
    let ratio = own_edge / edge;
    check_size(tree.active_voxel_count() as f64 * ratio * ratio, &options.limits)?;
    let surface = LevelSetToMesh {
        limits: options.limits.clone(),
        progress: pass(options.progress.as_ref(), 0, 2),
        ..LevelSetToMesh::default()
    };
    let mesh = level_set_to_mesh(tree, &new_from_index, &surface)?;
    let band = MeshToLevelSet {
        half_width,
        inside: InsideRule::Positive,
        limits: options.limits.clone(),
        progress: pass(options.progress.as_ref(), 1, 2),
        ..MeshToLevelSet::new(1.0)
    };
    let made = from_mesh::level_set_of_closed(mesh, &band, edge)?;
    Ok(Grid { transform: options.transform.clone(), ..replaced(grid, made) })
}

/// Refuses results that surely exceed the limit, given an estimate of their voxels in leaves.
fn check_size(voxels: f64, limits: &Limits) -> Result<(), ToolError> {
    let limit = limits.tree_bytes;
    let bytes = voxels / Leaf::SIZE as f64 * size_of::<Leaf>() as f64;
    if bytes > limit as f64 { Err(ToolError::TooManyVoxels { voxels, limit }) } else { Ok(()) }
}

/// The farthest coordinate of a voxel.
const INDEX_SPACE: f64 = (1_u64 << 31) as f64;

/// The tree of the values at the voxels of the new transform.
fn sampled(
    tree: &Vdb543<f32>,
    grid: &Grid,
    options: &Resample,
    progress: Option<&Arc<ProgressFn>>,
) -> Result<Vdb543<f32>, ToolError> {
    let [from, to] = [&grid.transform, &options.transform].map(Transform::voxel_size);
    let voxels = tree.stats().active_leaf_voxels() as f64 * (from / to).element_product();
    check_size(voxels, &options.limits)?;
    let background = tree.background();
    let boxes = || content(tree).filter_map(|own| within_frustum(own, &grid.transform));
    // The image of a box is within the box around the images of its corners, for a frustum, too.
    let new_from_index =
        |p: DVec3| options.transform.index_from_world(grid.transform.world_from_index(p));
    let image_with = |own: Voxels, reach: f64| {
        let [low, high] = [own.low, own.high].map(|p| DVec3::from(p.map(|c| c as f64)));
        around(corners(low - reach, high + reach).map(new_from_index))
    };
    let farthest = boxes().map(|own| image_with(own, 0.0)).fold(0.0, |far: f64, [low, high]| {
        far.max(low.abs().max_element()).max(high.abs().max_element())
    });
    if farthest > INDEX_SPACE {
        return Err(ToolError::BeyondVoxels { voxels: farthest, limit: INDEX_SPACE });
    }
    let image = |own: Voxels| {
        let [low, high] = image_with(own, 1.0);
        Voxels::between(low.floor(), high.ceil())
    };
    let Some(content) = boxes().map(image).reduce(Voxels::union) else {
        return Ok(Vdb543::new(background));
    };
    let limit = options.limits.tree_bytes;
    let all = tree.active_voxel_count() as f64 * (from / to).element_product();
    let uppers =
        uppers(boxes().map(image)).ok_or(ToolError::TooManyVoxels { voxels: all, limit })?;
    let formula = Resampling {
        tree,
        background,
        places: Places::new(&grid.transform, &options.transform),
        interpolation: options.interpolation,
        content,
    };
    build(background, uppers, &formula, &options.limits, progress)
        .map_err(|stop| ToolError::stopped(stop, voxels))
}

/// What of a box is in a frustum, and one voxel around it. Beyond, a position may be behind the apex.
fn within_frustum(own: Voxels, transform: &Transform) -> Option<Voxels> {
    let Some([low, high]) = transform.frustum_box() else { return Some(own) };
    own.intersection(Voxels::between(low.floor() - 1.0, high.ceil() + 1.0))
}

struct Resampling<'a> {
    tree: &'a Vdb543<f32>,
    background: f32,
    places: Places<'a>,
    interpolation: Interpolation,
    /// All voxels that may differ from the background.
    content: Voxels,
}

impl Formula for Resampling<'_> {
    type Scratch = Samples;

    fn tile(&self, origin: IVec3, log2_dim: u32) -> Option<State> {
        if self.content.intersection(Voxels::around(origin, log2_dim, 0)).is_none() {
            return Some((self.background, false));
        }
        one_value(self.tree, self.places.voxels(origin, log2_dim)?)
    }

    fn fill(&self, leaf: &mut Leaf, samples: &mut Samples) {
        /// Voxels that are read as a box: more than that of a leaf turned by any angle, with voxels
        /// of the same size.
        const BOX: u64 = 1 << 14;
        let mut accessor = self.tree.accessor();
        // One more on each side, because far from the origin more is lost.
        let voxels = self.places.voxels(leaf.origin(), Leaf::TOTAL_LOG2_DIM);
        let voxels = voxels.map(|voxels| voxels.widened(1));
        // The edges first, because their product may overflow.
        let small = voxels.filter(|voxels| {
            let size = voxels.size();
            size.iter().all(|&edge| edge <= BOX) && size.iter().product::<u64>() <= BOX
        });
        if let Some(voxels) = small {
            samples.read(&mut accessor, self.background, voxels);
            self.fill_with(leaf, |ijk| {
                let at = samples.index(ijk);
                (samples.values[at], samples.active[at])
            });
        } else {
            self.fill_with(leaf, |ijk| probe(&mut accessor, ijk, self.background));
        }
    }
}

/// The value and the state of a voxel; the background outside the index space.
fn probe(accessor: &mut Accessor<Upper>, ijk: [i64; 3], background: f32) -> State {
    match ijk.map(i32::try_from) {
        [Ok(x), Ok(y), Ok(z)] => accessor.probe(IVec3::new(x, y, z)),
        _ => (background, false),
    }
}

impl Resampling<'_> {
    fn fill_with(&self, leaf: &mut Leaf, mut at: impl FnMut([i64; 3]) -> State) {
        for slot in 0..Leaf::SIZE {
            let p = self.places.of((leaf.origin() + Leaf::slot_offset(slot)).as_dvec3());
            let (value, active) = match self.interpolation {
                Interpolation::Nearest => at(whole(p + 0.5).0),
                Interpolation::Trilinear => trilinear(p, &mut at),
            };
            leaf.values_slice_mut()[slot] = value;
            leaf.value_mask_mut().set(slot, active);
        }
    }
}

/// The voxel below a point on each axis, and the rest.
fn whole(p: DVec3) -> ([i64; 3], DVec3) {
    let below = p.floor();
    (below.to_array().map(|c| c as i64), p - below)
}

fn trilinear(p: DVec3, at: &mut impl FnMut([i64; 3]) -> State) -> State {
    let nearest = (p + 0.5).floor();
    let is_near = (p - nearest).abs().cmplt(DVec3::splat(ROUNDING));
    let (cell, u) = whole(DVec3::select(is_near, nearest, p));
    let mut active = false;
    // The other end of an edge is not read where it has no weight.
    let mut along_z = |x: i64, y: i64| {
        let mut corner = |z: i64| {
            let (value, on) = at([cell[0] + x, cell[1] + y, cell[2] + z]);
            active |= on;
            f64::from(value)
        };
        let low = corner(0);
        if u.z > 0.0 { mix(low, corner(1), u.z) } else { low }
    };
    let mut along_y = |x: i64| {
        let low = along_z(x, 0);
        if u.y > 0.0 { mix(low, along_z(x, 1), u.y) } else { low }
    };
    let low = along_y(0);
    let value = if u.x > 0.0 { mix(low, along_y(1), u.x) } else { low };
    (value as f32, active)
}

fn mix(a: f64, b: f64, u: f64) -> f64 {
    a + (b - a) * u
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AnyTree;
    use crate::synth::{Random, fog};
    use crate::transform::{Affine, Frustum, Map};
    use crate::tree::CoordBox;

    /// Frustums cannot be made but by reading a file.
    fn frustum(taper: f64) -> Transform {
        let second = Affine::from_linear(DAffine3::from_translation(DVec3::new(3.0, 2.0, -9.0)));
        let (min, max) = (DVec3::ZERO, DVec3::new(63.0, 47.0, 79.0));
        let frustum = Frustum { min, max, taper, depth: 1.5, second: second.unwrap() };
        Transform { map: Map::NonlinearFrustum(frustum) }
    }

    #[test]
    fn grids_in_a_frustum_are_those_of_brute_force() {
        let bbox = CoordBox { min: IVec3::ZERO, max: IVec3::new(63, 47, 79) };
        let mut tree = fog::from_values(bbox, |ijk| {
            let seed = ijk.dot(IVec3::new(1, 1000, 1_000_000)) as u64;
            Random::new(seed).unit() as f32
        });
        for at in [IVec3::ZERO, IVec3::new(24, 16, 40)] {
            tree.fill_leaf(at, 0.5, true);
        }
        for taper in [0.3, 2.5] {
            let mut grid = Grid::new("density", AnyTree::Float(tree.clone().into()));
            grid.transform = frustum(taper);
            // The apex is outside of the frustum, and yet within the cubes of nodes.
            let to = Transform::uniform(0.02, DVec3::new(3.0, 2.0, -8.0)).unwrap();
            let made = resample(&grid, &Resample::new(to.clone())).unwrap();
            let AnyTree::Float(made) = &made.tree else { panic!("floats") };
            let mut active = 0;
            for x in -100..100 {
                for y in -60..60 {
                    for z in (-60..40).step_by(7) {
                        let ijk = IVec3::new(x, y, z);
                        let p = to.world_from_index(ijk.as_dvec3());
                        let p = grid.transform.index_from_world(p);
                        let at = |at: [i64; 3]| tree.probe(IVec3::from_array(at.map(|c| c as i32)));
                        let (value, on) = trilinear(p, &mut { at });
                        assert_eq!(made.probe(ijk), (value, on), "{ijk} at {p}");
                        active += u64::from(on);
                    }
                }
            }
            assert!(active > 1000, "{active}");
        }
    }
}
