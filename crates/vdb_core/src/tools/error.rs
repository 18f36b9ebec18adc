//! Errors of tools.

use crate::display::quoted;
use crate::work::Stop;

/// Why a tool could not do its work. `Display` is one line: what is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ToolError {
    /// A setting is out of its range.
    #[error("{setting} is {value}; it must be {range}")]
    BadSetting {
        /// The name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// A mesh has no triangles.
    #[error("the mesh has no triangles; a level set needs a surface")]
    NoTriangles,
    /// A coordinate of a vertex is NaN or infinite.
    #[error(
        "vertex {vertex} of the mesh is at {position:?}, which is not a finite point; repair the mesh"
    )]
    NotFinite {
        /// The index of the vertex.
        vertex: usize,
        /// Its position.
        position: [f32; 3],
    },
    /// A triangle refers to a vertex that does not exist.
    #[error(
        "triangle {triangle} of the mesh refers to vertex {vertex}, but there are only {vertices} \
         vertices; repair the mesh"
    )]
    NoSuchVertex {
        /// The index of the triangle.
        triangle: usize,
        /// The index of the missing vertex.
        vertex: u32,
        /// The number of vertices.
        vertices: usize,
    },
    /// A vertex is too far from the origin for the size of a voxel.
    #[error(
        "vertex {vertex} of the mesh is {voxels:.1e} voxels from the origin, more than {limit:.1e}; \
         use larger voxels, or move the mesh to the origin"
    )]
    TooFar {
        /// The index of the vertex.
        vertex: usize,
        /// Its largest coordinate, in voxels.
        voxels: f64,
        /// The largest possible coordinate, in voxels.
        limit: f64,
    },
    /// A grid of points has none.
    #[error("the grid has no points; a volume needs some")]
    NoPoints,
    /// A level set of points would have no surface.
    #[error("all points have a radius of 0; a level set needs a radius")]
    NoRadii,
    /// Points do not have an attribute.
    #[error(
        "the points have no attribute {} with one float per point; `vdb info` lists their attributes",
        quoted(name)
    )]
    NoSuchAttribute {
        /// The name of the attribute.
        name: String,
    },
    /// A coordinate of a point is NaN or infinite.
    #[error("point {point} is at {position:?}, which is not a finite point; remove it")]
    PointNotFinite {
        /// The index of the point.
        point: usize,
        /// Its position in world space.
        position: [f64; 3],
    },
    /// A point is too far from the origin for the size of a voxel.
    #[error(
        "point {point} reaches {voxels:.1e} voxels from the origin, more than {limit:.1e}; use \
         larger voxels, or move the points to the origin"
    )]
    PointTooFar {
        /// The index of the point.
        point: usize,
        /// Its largest coordinate plus its radius, in voxels.
        voxels: f64,
        /// The largest possible coordinate, in voxels.
        limit: f64,
    },
    /// The radius or the density of a point is negative or not finite.
    #[error("{setting} of point {point} is {value}; it must be a number from 0")]
    BadPointValue {
        /// The name of the setting.
        setting: &'static str,
        /// The index of the point.
        point: usize,
        /// The value.
        value: f64,
    },
    /// The result would have too many voxels for the limits.
    #[error(
        "the result takes about {voxels:.1e} voxels, and more memory than the limit of {limit} \
         bytes (`Limits::tree_bytes`); use larger voxels, or raise it"
    )]
    TooManyVoxels {
        /// An estimate of the active voxels.
        voxels: f64,
        /// The limit.
        limit: u64,
    },
    /// A result would be too far from the origin for the size of a voxel.
    #[error(
        "the result reaches {voxels:.1e} voxels from the origin, more than {limit:.1e}; use larger \
         voxels, or a transform with its origin near the grid"
    )]
    BeyondVoxels {
        /// The largest coordinate, in voxels.
        voxels: f64,
        /// The largest possible coordinate, in voxels.
        limit: f64,
    },
    /// A grid has values of another type.
    #[error("this needs grids of floats; convert the grid")]
    NotFloats,
    /// Two grids do not have the same voxels.
    #[error("the grids have different transforms; resample one to the voxels of the other")]
    TransformsDiffer,
    /// Two level sets do not have the same background, or it is not positive.
    #[error(
        "the grids have backgrounds of {} and {}, but level sets with bands of the same width \
         have the same one, above 0; redistance them", backgrounds[0], backgrounds[1]
    )]
    BandsDiffer {
        /// The backgrounds.
        backgrounds: [f32; 2],
    },
    /// The voxels of a grid are no cubes.
    #[error("distances need cubic voxels, and those of the grid are {size:?}; resample it")]
    NotCubes {
        /// The edges of a voxel in world units.
        size: [f64; 3],
    },
    /// A grid is no level set.
    #[error(
        "this needs a level set, and the class of the grid is `{class}`; set it, or convert it"
    )]
    NotLevelSet {
        /// The class of the grid.
        class: &'static str,
    },
    /// The background of a level set is not the half width of a band.
    #[error(
        "the background of the level set is {background}, with voxels of {edge}; it must be at least \
         one voxel, so redistance it"
    )]
    NoBand {
        /// The background.
        background: f32,
        /// The edge of a voxel in world units.
        edge: f64,
    },
    /// A level set would have no surface any more.
    #[error("{after}, the level set has no surface any more; do less")]
    NothingLeft {
        /// After what.
        after: String,
    },
    /// A box is none.
    #[error("the box from {low:?} to {high:?} has no inside; give the lower corner first")]
    BadBox {
        /// The lower corner.
        low: [f64; 3],
        /// The upper corner.
        high: [f64; 3],
    },
    /// The transform of a grid is a frustum.
    #[error("this needs a linear transform, and the grid is in a frustum; resample it")]
    NotLinear,
    /// A mesh would have more vertices than can be numbered.
    #[error("the mesh has {vertices} vertices, more than 4294967295; use larger voxels")]
    TooManyVertices {
        /// The number of vertices.
        vertices: u64,
    },
    /// The progress callback requested cancellation.
    #[error("making the volume was cancelled")]
    Cancelled,
}

impl ToolError {
    /// The error for work stopped before it exceeded a limit, with the estimated number of voxels.
    pub(super) fn stopped(stop: Stop, voxels: f64) -> Self {
        match stop {
            Stop::Cancelled => Self::Cancelled,
            Stop::Memory { limit, .. } => Self::TooManyVoxels { voxels, limit },
        }
    }
}
