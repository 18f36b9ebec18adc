//! JSON output: the statistics of a file with the keys, order and digits of OpenVDB's in the test
//! corpus.

mod format;

use std::path::Path;

use glam::IVec3;
use serde::Serialize;
use vdb_core::tree::{Node, Tree};
use vdb_core::{
    AnyTree, Grid, GridClass, PointAttribute, PointGrid, PointGroup, Points, SkippedGrid,
    Transform, VdbFile,
};

use format::Format;

/// Every `active / STEPS`th active value is sampled, `PLACES` of them at most.
const STEPS: usize = 24;
const PLACES: usize = 14;

pub fn file(path: &Path, file: &VdbFile, has_offsets: bool) -> serde_json::Result<String> {
    let mut grids: Vec<GridFigures> = file.grids.iter().map(grid).collect();
    grids.extend(file.points.iter().map(points));
    grids.extend(file.skipped.iter().map(skipped));
    if has_offsets {
        // OpenVDB lists grids by name, and those with equal names in file order.
        grids.sort_by_key(|grid| grid.name);
    }
    let file = FileFigures {
        file: &path.file_name().unwrap_or_default().to_string_lossy(),
        file_version: file.version,
        grids,
    };
    let mut out = Vec::new();
    file.serialize(&mut serde_json::Serializer::with_formatter(&mut out, Format::default()))?;
    out.push(b'\n');
    // JSON output is pure ASCII, so this replaces nothing.
    Ok(String::from_utf8_lossy(&out).into_owned())
}

#[derive(Serialize)]
struct FileFigures<'a> {
    file: &'a str,
    file_version: u32,
    grids: Vec<GridFigures<'a>>,
}

#[derive(Serialize)]
struct GridFigures<'a> {
    name: &'a str,
    r#type: &'a str,
    class: &'static str,
    half: bool,
    #[serde(flatten)]
    transform: Option<TransformFigures>,
    value_type: &'a str,
    #[serde(flatten)]
    values: Option<ValueFigures>,
    #[serde(flatten)]
    points: Option<PointFigures<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    skipped: Option<String>,
}

#[derive(Serialize)]
struct TransformFigures {
    map_type: &'static str,
    linear: bool,
    index_to_world: Vec<([i32; 3], [Real; 3])>,
}

#[derive(Serialize)]
struct ValueFigures {
    #[serde(skip_serializing_if = "Option::is_none")]
    background: Option<Value>,
    active_voxels: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    active_tiles: Option<String>,
    leaf_count: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    active_leaf_voxels: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    active_bbox: Option<[[i32; 3]; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    samples: Option<Vec<Sample>>,
}

#[derive(Serialize)]
struct PointFigures<'a> {
    points: usize,
    attributes: Vec<AttributeFigures<'a>>,
    groups: Vec<GroupFigures<'a>>,
}

#[derive(Serialize)]
struct AttributeFigures<'a> {
    name: &'a str,
    r#type: &'a str,
    codec: &'a str,
    values_per_point: u32,
    read: bool,
}

#[derive(Serialize)]
struct GroupFigures<'a> {
    name: &'a str,
    points: usize,
}

#[derive(Serialize)]
struct Sample {
    ijk: [i32; 3],
    on: bool,
    value: Value,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Value {
    Bool(bool),
    Int(i32),
    /// As a string: many JSON readers lose precision beyond 53 bits.
    Long(String),
    Real(Real),
    Ints([i32; 3]),
    Reals([Real; 3]),
}

/// A number; NaN and infinities, which JSON lacks, are written as strings.
#[derive(Clone, Copy)]
struct Real(f64);

impl Serialize for Real {
    fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            value if value.is_nan() => to.serialize_str("nan"),
            f64::INFINITY => to.serialize_str("inf"),
            f64::NEG_INFINITY => to.serialize_str("-inf"),
            value => to.serialize_f64(value),
        }
    }
}

fn grid(grid: &Grid) -> GridFigures<'_> {
    let real = |value: f64| Value::Real(Real(value));
    let values = match &grid.tree {
        AnyTree::Float(tree) => values(tree, &|v| real(v.into())),
        AnyTree::Double(tree) => values(tree, &real),
        AnyTree::Int32(tree) => values(tree, &Value::Int),
        AnyTree::Int64(tree) => values(tree, &|v| Value::Long(v.to_string())),
        AnyTree::Bool(tree) => values(tree, &Value::Bool),
        AnyTree::Mask(tree) => mask(tree),
        AnyTree::Vec3s(tree) => values(tree, &|v| Value::Reals(v.map(|c| Real(c.into())))),
        AnyTree::Vec3d(tree) => values(tree, &|v| Value::Reals(v.map(Real))),
        AnyTree::Vec3i(tree) => values(tree, &Value::Ints),
    };
    GridFigures {
        values: Some(values),
        value_type: grid.tree.value_type(),
        skipped: None,
        ..head(&grid.name, &grid.type_name, grid.class, grid.saved_as_half, Some(&grid.transform))
    }
}

fn points(grid: &PointGrid) -> GridFigures<'_> {
    let points = &grid.points;
    GridFigures {
        value_type: "ptdataidx32",
        points: Some(PointFigures {
            points: points.len(),
            attributes: points.attributes().iter().map(attribute).collect(),
            groups: points.groups().iter().map(|named| group(points, named)).collect(),
        }),
        ..head(&grid.name, &grid.type_name, GridClass::Unknown, false, Some(&grid.transform))
    }
}

fn attribute(attribute: &PointAttribute) -> AttributeFigures<'_> {
    AttributeFigures {
        name: &attribute.name,
        r#type: &attribute.value_type,
        codec: &attribute.codec,
        values_per_point: attribute.values_per_point,
        read: attribute.is_read(),
    }
}

fn group<'a>(points: &Points, group: &'a PointGroup) -> GroupFigures<'a> {
    let members = points.in_group(&group.name).map_or(0, |all| all.filter(|is| *is).count());
    GroupFigures { name: &group.name, points: members }
}

fn skipped(grid: &SkippedGrid) -> GridFigures<'_> {
    let transform = grid.transform.as_ref();
    let value_type = grid.type_name.strip_prefix("Tree_").unwrap_or(&grid.type_name);
    GridFigures {
        value_type: value_type.split('_').next().unwrap_or_default(),
        skipped: Some(grid.reason.to_string()),
        ..head(&grid.name, &grid.type_name, grid.class, grid.saved_as_half, transform)
    }
}

fn head<'a>(
    name: &'a str,
    type_name: &'a str,
    class: GridClass,
    half: bool,
    transform: Option<&Transform>,
) -> GridFigures<'a> {
    let transform = transform.map(|transform| TransformFigures {
        map_type: transform.map_type(),
        linear: transform.is_linear(),
        index_to_world: (0..6)
            .map(|i| {
                let index = IVec3::new(3 * i - 2, i * i - 1, 5 - 2 * i);
                let world = transform.world_from_index(index.as_dvec3());
                (index.to_array(), world.to_array().map(Real))
            })
            .collect(),
    });
    GridFigures {
        name,
        r#type: type_name,
        class: class.name(),
        half,
        transform,
        value_type: "",
        values: None,
        points: None,
        skipped: None,
    }
}

fn values<C: Node>(tree: &Tree<C>, show: &dyn Fn(C::Value) -> Value) -> ValueFigures {
    let stats = tree.stats();
    let count = (stats.active_leaf_voxels() + stats.active_tiles()) as usize;
    let active = tree.active_values().step_by((count / STEPS).max(1)).take(PLACES);
    let mut places: Vec<IVec3> = Vec::new();
    for value in active {
        // The voxel, its neighbour, and one that may lie in another leaf.
        let ijk = value.origin;
        places.extend([IVec3::ZERO, IVec3::X, IVec3::new(-3, 5, -7)].map(|d| ijk.wrapping_add(d)));
    }
    places.extend([IVec3::ZERO, IVec3::new(100_000, -100_000, 77)]);
    let samples = places.into_iter().map(|ijk| {
        let (value, on) = tree.probe(ijk);
        Sample { ijk: ijk.to_array(), on, value: show(value) }
    });
    ValueFigures {
        background: Some(show(tree.background())),
        active_tiles: Some(stats.active_tiles().to_string()),
        active_leaf_voxels: Some(stats.active_leaf_voxels().to_string()),
        samples: Some(samples.collect()),
        ..mask(tree)
    }
}

/// The statistics of a tree without values.
fn mask<C: Node>(tree: &Tree<C>) -> ValueFigures {
    ValueFigures {
        background: None,
        active_voxels: tree.active_voxel_count().to_string(),
        active_tiles: None,
        leaf_count: tree.stats().leaf_count(),
        active_leaf_voxels: None,
        active_bbox: tree.active_bbox().map(|bbox| [bbox.min, bbox.max].map(|c| c.to_array())),
        samples: None,
    }
}
