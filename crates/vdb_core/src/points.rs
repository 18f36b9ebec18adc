//! Grids of points: positions and attributes.

use std::sync::Arc;

use glam::DVec3;

use crate::{Compression, Metadata, Transform};

/// A grid of points, as OpenVDB's `PointDataGrid` stores particles: positions, and attributes such
/// as a radius or a velocity.
///
/// ```no_run
/// use vdb_core::VdbFile;
///
/// let file = VdbFile::open("spray.vdb")?;
/// for grid in &file.points {
///     let radii = grid.points.floats("pscale").unwrap_or_default();
///     println!("{} points, {} radii", grid.points.len(), radii.len());
///     for position in grid.world_positions() {
///         println!("{position}");
///     }
/// }
/// # Ok::<(), vdb_core::Error>(())
/// ```
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PointGrid {
    /// The name; may be empty or shared by several grids of a file.
    pub name: String,
    /// The name, with a number if it is empty or shared: `points[1]`.
    pub unique_name: String,
    /// The type of the tree as OpenVDB spells it: `Tree_ptdataidx32_5_4_3`.
    pub type_name: String,
    /// How the grid is compressed in the file. The attributes are compressed with Blosc or not at
    /// all.
    pub compression: Compression,
    /// The length of the grid in the file it was read from, in bytes; 0 if it was not read from
    /// one.
    pub file_bytes: u64,
    /// The unique name of the grid whose points this one shares.
    pub instance_of: Option<String>,
    /// The transform from index space to world space.
    pub transform: Transform,
    /// The metadata of the grid.
    pub metadata: Metadata,
    /// The points.
    pub points: Arc<Points>,
}

impl PointGrid {
    /// The type of all grids of points, as OpenVDB spells it.
    pub const TYPE_NAME: &str = "Tree_ptdataidx32_5_4_3";

    /// Makes a grid of points whose index space is the world.
    pub fn new(name: impl Into<String>, points: Points) -> Self {
        let name = name.into();
        Self {
            unique_name: name.clone(),
            name,
            type_name: Self::TYPE_NAME.to_owned(),
            compression: Compression::default(),
            file_bytes: 0,
            instance_of: None,
            transform: Transform::default(),
            metadata: Metadata::default(),
            points: Arc::new(points),
        }
    }

    /// The same grid with other points, which are its own.
    pub(crate) fn with_points(&self, points: Points) -> Self {
        Self { points: Arc::new(points), instance_of: None, file_bytes: 0, ..self.clone() }
    }

    /// The positions of the points in world space, in the order of [`Points::positions`].
    pub fn world_positions(&self) -> impl ExactSizeIterator<Item = DVec3> + '_ {
        self.points.positions().iter().map(|position| self.transform.world_from_index(*position))
    }
}

/// Points with their attributes. All values are in the order of the positions, which is that of
/// OpenVDB: leaf by leaf, and voxel by voxel in each leaf.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Points {
    pub(crate) positions: Vec<DVec3>,
    pub(crate) attributes: Vec<PointAttribute>,
    pub(crate) groups: Vec<PointGroup>,
}

impl Points {
    /// The attribute with the positions.
    pub(crate) const POSITION: &str = "P";

    /// The attribute with the radii, by convention.
    pub const RADIUS: &str = "pscale";

    /// Points at these positions in index space, without attributes.
    pub fn new(positions: Vec<DVec3>) -> Self {
        Self { positions, ..Self::default() }
    }

    /// The same points with one more attribute of floats, such as the radius `pscale`. One with the
    /// same name is replaced.
    ///
    /// `None` if there is not one value for each point, or the name is empty or `P`, which is that
    /// of the positions.
    pub fn with_floats(mut self, name: impl Into<String>, values: Vec<f32>) -> Option<Self> {
        let name = name.into();
        if values.len() != self.len() || name.is_empty() || name == Self::POSITION {
            return None;
        }
        let own = PointAttribute {
            name,
            value_type: "float".to_owned(),
            codec: "null".to_owned(),
            values_per_point: 1,
            values: Some(PointValues::Float(values)),
        };
        // Groups refer to attributes by their places, so none may move.
        match self.attributes.iter().position(|attribute| attribute.name == own.name) {
            Some(place) => {
                self.groups.retain(|group| group.attribute != place);
                self.attributes[place] = own;
            }
            None => self.attributes.push(own),
        }
        Some(self)
    }

    /// The points that are to be kept, given one flag for each.
    pub(crate) fn kept(&self, flags: &[bool]) -> Self {
        let attribute = |attribute: &PointAttribute| {
            let each = attribute.values_per_point as usize;
            let values = attribute.values.as_ref().map(|values| values.kept(flags, each));
            PointAttribute { values, ..attribute.clone() }
        };
        Self {
            positions: chosen(&self.positions, flags, 1),
            attributes: self.attributes.iter().map(attribute).collect(),
            groups: self.groups.clone(),
        }
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The positions in index space, in voxels: the sum in f64 of the coordinates of the voxel and
    /// the offset from its centre that the file stores. They may be NaN or infinite if the file
    /// says so.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// The attributes in the order of the file, with those that cannot be read.
    pub fn attributes(&self) -> &[PointAttribute] {
        &self.attributes
    }

    /// The attribute with a name.
    pub fn attribute(&self, name: &str) -> Option<&PointAttribute> {
        self.attributes.iter().find(|attribute| attribute.name == name)
    }

    /// The values of an attribute that has one float per point, whatever its codec; `None` if there
    /// is no such attribute.
    pub fn floats(&self, name: &str) -> Option<&[f32]> {
        match self.attribute(name)? {
            PointAttribute { values: Some(PointValues::Float(values)), .. }
                if values.len() == self.len() =>
            {
                Some(values)
            }
            _ => None,
        }
    }

    /// The groups, by name.
    pub fn groups(&self) -> &[PointGroup] {
        &self.groups
    }

    /// For each point, whether it is in the group with a name; `None` if there is no such group.
    pub fn in_group<'a>(&'a self, name: &str) -> Option<impl ExactSizeIterator<Item = bool> + 'a> {
        let group = self.groups.iter().find(|group| group.name == name)?;
        match &self.attributes.get(group.attribute)?.values {
            Some(PointValues::Groups(bits)) if bits.len() == self.len() => {
                Some(bits.iter().map(|bits| bits >> group.bit & 1 == 1))
            }
            _ => None,
        }
    }

    /// The box around all points in index space, as its lower and its upper corner; `None` if there
    /// are no points. Coordinates that are NaN are left out.
    pub fn bounds(&self) -> Option<[DVec3; 2]> {
        let low = self.positions.iter().copied().reduce(DVec3::min)?;
        let high = self.positions.iter().copied().reduce(DVec3::max)?;
        Some([low, high])
    }

    /// The memory of the positions and the values, in bytes.
    pub fn bytes(&self) -> u64 {
        let values = self.attributes.iter().filter_map(|attribute| attribute.values.as_ref());
        let values: usize = values.map(PointValues::bytes).sum();
        (size_of_val(&*self.positions) + values) as u64
    }
}

/// An attribute of points.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PointAttribute {
    /// The name: `P` for the positions, and by convention `pscale` for the radius and `v` for the
    /// velocity.
    pub name: String,
    /// The type of the values as OpenVDB spells it: `float`, `vec3s`, …
    pub value_type: String,
    /// The codec of the values as OpenVDB spells it: `null` for uncompressed values, `trnc` for 16
    /// bits, `fxpt8` and `fxpt16` for fractions of a voxel, `ufxpt8` and `ufxpt16` for numbers from
    /// 0 to 1, `uvec` for directions, `grp` for groups, `str` for strings.
    pub codec: String,
    /// The values per point, which is more than 1 for arrays; 0 if it differs from point to point.
    pub values_per_point: u32,
    /// The values, [`Self::values_per_point`] for each point. `None` for `P`, whose values are
    /// [`Points::positions`], and for types that are not read: strings, matrices, quaternions and
    /// attributes with different numbers of values.
    pub values: Option<PointValues>,
}

impl PointAttribute {
    /// Whether the values are read: for `P`, as [`Points::positions`]. Attributes that are not read
    /// are not written either.
    pub fn is_read(&self) -> bool {
        self.values.is_some() || self.name == Points::POSITION
    }

    /// The positions, in full.
    pub(crate) fn position() -> Self {
        Self {
            name: Points::POSITION.to_owned(),
            value_type: "vec3s".to_owned(),
            codec: "null".to_owned(),
            values_per_point: 1,
            values: None,
        }
    }
}

/// The values of an attribute, decoded.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum PointValues {
    /// `bool`
    Bool(Vec<bool>),
    /// `int8`, `int16` and `int32`
    Int32(Vec<i32>),
    /// `int64`
    Int64(Vec<i64>),
    /// `float`, and `half` of newer versions of OpenVDB
    Float(Vec<f32>),
    /// `double`
    Double(Vec<f64>),
    /// `vec3i`
    Vec3i(Vec<[i32; 3]>),
    /// `vec3s`
    Vec3s(Vec<[f32; 3]>),
    /// `vec3d`
    Vec3d(Vec<[f64; 3]>),
    /// The membership of points in eight groups, one bit for each; see [`Points::in_group`].
    Groups(Vec<u8>),
}

impl PointValues {
    /// The number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Bool(values) => values.len(),
            Self::Int32(values) => values.len(),
            Self::Int64(values) => values.len(),
            Self::Float(values) => values.len(),
            Self::Double(values) => values.len(),
            Self::Vec3i(values) => values.len(),
            Self::Vec3s(values) => values.len(),
            Self::Vec3d(values) => values.len(),
            Self::Groups(values) => values.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The values of the points whose flag is set; each point has `each` values.
    fn kept(&self, flags: &[bool], each: usize) -> Self {
        match self {
            Self::Bool(values) => Self::Bool(chosen(values, flags, each)),
            Self::Int32(values) => Self::Int32(chosen(values, flags, each)),
            Self::Int64(values) => Self::Int64(chosen(values, flags, each)),
            Self::Float(values) => Self::Float(chosen(values, flags, each)),
            Self::Double(values) => Self::Double(chosen(values, flags, each)),
            Self::Vec3i(values) => Self::Vec3i(chosen(values, flags, each)),
            Self::Vec3s(values) => Self::Vec3s(chosen(values, flags, each)),
            Self::Vec3d(values) => Self::Vec3d(chosen(values, flags, each)),
            Self::Groups(values) => Self::Groups(chosen(values, flags, each)),
        }
    }

    /// The memory of the values, in bytes.
    fn bytes(&self) -> usize {
        let each = match self {
            Self::Bool(_) | Self::Groups(_) => 1,
            Self::Int32(_) | Self::Float(_) => 4,
            Self::Int64(_) | Self::Double(_) => 8,
            Self::Vec3i(_) | Self::Vec3s(_) => 12,
            Self::Vec3d(_) => 24,
        };
        self.len() * each
    }
}

/// The values whose flag is set; each flag covers `each` values.
fn chosen<T: Copy>(values: &[T], flags: &[bool], each: usize) -> Vec<T> {
    let of_points = values.chunks(each.max(1)).zip(flags);
    of_points.filter(|(_, is_kept)| **is_kept).flat_map(|(values, _)| values).copied().collect()
}

/// A named group of points.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct PointGroup {
    /// The name.
    pub name: String,
    /// The index of the attribute with the membership, and the bit in its values.
    pub(crate) attribute: usize,
    pub(crate) bit: u8,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attribute(name: &str, value_type: &str) -> PointAttribute {
        PointAttribute {
            name: name.to_owned(),
            value_type: value_type.to_owned(),
            codec: "null".to_owned(),
            values_per_point: 1,
            values: None,
        }
    }

    #[test]
    fn groups_stay_with_their_attribute_when_another_is_replaced() {
        let group = PointGroup { name: "wet".to_owned(), attribute: 1, bit: 3 };
        let points = Points {
            positions: vec![DVec3::ZERO],
            attributes: vec![attribute("pscale", "half"), attribute("groups", "uint8")],
            groups: vec![group.clone()],
        };
        let replaced = points.clone().with_floats("pscale", vec![2.0]).unwrap();
        assert_eq!(replaced.attributes.len(), 2);
        assert_eq!(replaced.attributes[0].values, Some(PointValues::Float(vec![2.0])));
        assert_eq!(replaced.attributes[1].name, "groups");
        assert_eq!(replaced.groups, [group]);
        // Without their attribute, groups have no members.
        let without = points.with_floats("groups", vec![1.0]).unwrap();
        assert_eq!((without.attributes.len(), without.groups.len()), (2, 0));
    }
}
