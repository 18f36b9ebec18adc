//! Compares what was read with the figures that OpenVDB gave for the same file.

use std::path::Path;

use glam::{DVec3, IVec3};
use serde_json::Value as Json;
use vdb_core::tree::{Node, Tree};
use vdb_core::{AnyTree, Grid, GridClass, PointGrid, Transform, VdbFile};

/// Counts what was compared, and collects what differs, so that one run shows all of it.
#[derive(Default)]
pub struct Check {
    pub files: usize,
    pub grids: usize,
    /// Grids of types that are not supported, listed as they should be.
    pub skipped: usize,
    pub figures: usize,
    pub differences: Vec<String>,
    place: String,
}

impl Check {
    fn same<T: PartialEq + std::fmt::Debug>(&mut self, what: &str, ours: T, theirs: T) {
        self.figures += 1;
        if ours != theirs {
            let place = &self.place;
            self.differences.push(format!("{place}: {what} is {ours:?}, OpenVDB has {theirs:?}"));
        }
    }
}

/// A number, or one of the strings that stand for what JSON lacks.
fn number(json: &Json) -> f64 {
    match json.as_str() {
        Some("nan") => f64::NAN,
        Some("inf") => f64::INFINITY,
        Some("-inf") => f64::NEG_INFINITY,
        Some(text) => text.parse().unwrap(),
        None => json.as_f64().unwrap_or_else(|| panic!("{json} is no number")),
    }
}

/// A whole number, which stands in quotes where it may have 64 bits.
fn integer(json: &Json) -> i64 {
    json.as_str().map_or_else(|| json.as_i64().unwrap(), |text| text.parse().unwrap())
}

fn ivec3(json: &Json) -> IVec3 {
    IVec3::from_array([0, 1, 2].map(|i| i32::try_from(integer(&json[i])).unwrap()))
}

fn bits3(p: DVec3) -> [u64; 3] {
    p.to_array().map(f64::to_bits)
}

/// A value of a tree as bits, to be compared; all NaNs are one, as they are in the JSON.
trait Bits: Copy {
    fn bits(self) -> Vec<u64>;
    fn from_json(json: &Json) -> Vec<u64>;
}

impl Bits for f32 {
    fn bits(self) -> Vec<u64> {
        vec![if self.is_nan() { u64::MAX } else { self.to_bits().into() }]
    }
    fn from_json(json: &Json) -> Vec<u64> {
        let wide = number(json);
        assert!(wide.is_nan() || f64::from(wide as f32) == wide, "{wide} is no f32");
        (wide as f32).bits()
    }
}

impl Bits for f64 {
    fn bits(self) -> Vec<u64> {
        vec![if self.is_nan() { u64::MAX } else { self.to_bits() }]
    }
    fn from_json(json: &Json) -> Vec<u64> {
        number(json).bits()
    }
}

impl Bits for bool {
    fn bits(self) -> Vec<u64> {
        vec![self.into()]
    }
    fn from_json(json: &Json) -> Vec<u64> {
        json.as_bool().unwrap().bits()
    }
}

macro_rules! integer_bits {
    ($($t:ty),*) => {$(impl Bits for $t {
        fn bits(self) -> Vec<u64> {
            vec![i64::from(self) as u64]
        }
        fn from_json(json: &Json) -> Vec<u64> {
            vec![integer(json) as u64]
        }
    })*};
}
integer_bits!(i32, i64);

impl<T: Bits> Bits for [T; 3] {
    fn bits(self) -> Vec<u64> {
        self.into_iter().flat_map(T::bits).collect()
    }
    fn from_json(json: &Json) -> Vec<u64> {
        (0..3).flat_map(|i| T::from_json(&json[i])).collect()
    }
}

fn check_values<C: Node>(check: &mut Check, tree: &Tree<C>, json: &Json)
where
    C::Value: Bits,
{
    if let Some(background) = json.get("background") {
        check.same("background", tree.background().bits(), C::Value::from_json(background));
    }
    let mut accessor = tree.accessor();
    for sample in json.get("samples").and_then(Json::as_array).into_iter().flatten() {
        let ijk = ivec3(&sample["ijk"]);
        let (value, active) = tree.probe(ijk);
        check.same(&format!("state at {ijk}"), active, sample["on"].as_bool().unwrap());
        let theirs = C::Value::from_json(&sample["value"]);
        check.same(&format!("value at {ijk}"), value.bits(), theirs.clone());
        check.same(&format!("value by accessor at {ijk}"), accessor.get(ijk).bits(), theirs);
    }
}

fn check_tree(check: &mut Check, tree: &AnyTree, json: &Json) {
    let known = [
        "name",
        "type",
        "class",
        "half",
        "map_type",
        "linear",
        "index_to_world",
        "value_type",
        "background",
        "active_voxels",
        "active_tiles",
        "leaf_count",
        "active_leaf_voxels",
        "active_bbox",
        "samples",
    ];
    for key in json.as_object().unwrap().keys() {
        assert!(known.contains(&key.as_str()), "{}: no check for {key:?}", check.place);
    }
    check.same("value type", tree.value_type(), json["value_type"].as_str().unwrap());
    let stats = tree.stats();
    let count = |key: &str| json.get(key).map(|json| integer(json) as u64);
    for (key, ours) in [
        ("active_voxels", tree.active_voxel_count()),
        ("active_tiles", stats.active_tiles()),
        ("leaf_count", stats.leaf_count()),
        ("active_leaf_voxels", stats.active_leaf_voxels()),
    ] {
        if let Some(theirs) = count(key) {
            check.same(key, ours, theirs);
        }
    }
    let bbox = json.get("active_bbox").map(|json| (ivec3(&json[0]), ivec3(&json[1])));
    check.same("active bbox", tree.active_bbox().map(|b| (b.min, b.max)), bbox);
    match tree {
        AnyTree::Float(tree) => check_values(check, tree, json),
        AnyTree::Double(tree) => check_values(check, tree, json),
        AnyTree::Int32(tree) => check_values(check, tree, json),
        AnyTree::Int64(tree) => check_values(check, tree, json),
        AnyTree::Bool(tree) => check_values(check, tree, json),
        AnyTree::Mask(tree) => check_values(check, tree, json),
        AnyTree::Vec3s(tree) => check_values(check, tree, json),
        AnyTree::Vec3d(tree) => check_values(check, tree, json),
        AnyTree::Vec3i(tree) => check_values(check, tree, json),
    }
}

fn check_transform(check: &mut Check, transform: &Transform, json: &Json) {
    check.same("map type", transform.map_type(), json["map_type"].as_str().unwrap());
    check.same("linear", transform.is_linear(), json["linear"].as_bool().unwrap());
    check.same("matrix", transform.linear().is_some(), json["linear"].as_bool().unwrap());
    for pair in json["index_to_world"].as_array().unwrap() {
        let index = ivec3(&pair[0]).as_dvec3();
        let world = DVec3::from_array([0, 1, 2].map(|i| number(&pair[1][i])));
        let ours = transform.world_from_index(index);
        check.same(&format!("world position of {index}"), bits3(ours), bits3(world));
        let back = transform.index_from_world(ours);
        assert!((back - index).abs().max_element() < 1e-9, "{}: {index} {back}", check.place);
    }
}

/// A name: the JSON has its bytes, each one as a character.
fn name_of(json: &Json) -> String {
    let bytes = json["name"].as_str().unwrap().chars().map(|c| u8::try_from(c).unwrap());
    String::from_utf8(bytes.collect()).unwrap()
}

/// What a grid says of itself.
struct Head<'a> {
    name: &'a str,
    type_name: &'a str,
    class: GridClass,
    half: bool,
    transform: &'a Transform,
}

fn check_head(check: &mut Check, head: &Head<'_>, json: &Json) {
    check.same("name", head.name, &name_of(json));
    check.same("type", head.type_name, json["type"].as_str().unwrap());
    check.same("class", head.class.name(), json["class"].as_str().unwrap());
    check.same("half", head.half, json["half"].as_bool().unwrap());
    check_transform(check, head.transform, json);
}

fn grid_head(grid: &Grid) -> Head<'_> {
    Head {
        name: &grid.name,
        type_name: &grid.type_name,
        class: grid.class,
        half: grid.saved_as_half,
        transform: &grid.transform,
    }
}

fn points_head(grid: &PointGrid) -> Head<'_> {
    Head {
        name: &grid.name,
        type_name: &grid.type_name,
        class: GridClass::Unknown,
        half: false,
        transform: &grid.transform,
    }
}

impl Check {
    /// Compares a file with the figures in the `.json` beside it.
    pub fn file(&mut self, path: &Path, file: &VdbFile) {
        let json = std::fs::read(path.with_extension("json")).unwrap();
        let json: Json = serde_json::from_slice(&json).unwrap();
        self.files += 1;
        self.place = path.display().to_string();
        self.same("file version", i64::from(file.version), integer(&json["file_version"]));
        // Where OpenVDB refuses the file there is nothing to compare, and we must read it.
        let Some(theirs) = json.get("grids").and_then(Json::as_array) else {
            assert!(json.get("openvdb_refuses").is_some(), "{} has no grids", self.place);
            assert!(!file.grids.is_empty(), "{}: no grid was read", self.place);
            self.grids += file.grids.len();
            self.skipped += file.skipped.len();
            return;
        };
        let mut grids: Vec<&Grid> = file.grids.iter().collect();
        let mut points: Vec<&PointGrid> = file.points.iter().collect();
        for json in theirs {
            let name = name_of(json);
            self.place = format!("{}, grid {name:?}", path.display());
            // OpenVDB lists by name, those of one name in the order of the file.
            if let Some(count) = json.get("points") {
                let at = points.iter().position(|grid| grid.name == name);
                let grid = points.remove(at.expect("a grid was not read"));
                check_head(self, &points_head(grid), json);
                self.same("points", grid.points.len() as i64, integer(count));
                self.grids += 1;
            } else {
                let at = grids.iter().position(|grid| grid.name == name);
                let grid = grids.remove(at.expect("a grid was not read"));
                check_head(self, &grid_head(grid), json);
                check_tree(self, &grid.tree, json);
                self.grids += 1;
            }
        }
        let none_left = grids.is_empty() && points.is_empty() && file.skipped.is_empty();
        assert!(none_left, "{}: more grids", self.place);
    }

    /// Prints the counts, and fails if anything differs.
    pub fn finish(&self) {
        println!(
            "{} files, {} grids read, {} of unsupported type listed, {} figures compared",
            self.files, self.grids, self.skipped, self.figures
        );
        assert!(self.differences.is_empty(), "{}", self.differences.join("\n"));
        assert!(self.files > 0 && self.figures > 0, "nothing was compared");
    }
}
