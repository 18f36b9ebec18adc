//! Comparison of points: their number, positions, attributes and groups.

use vdb_core::display::quoted;
use vdb_core::{PointAttribute, PointValues, Points};

/// The differences between points, which are compared in file order; empty if they are
/// equal within the tolerance. Positions are those in voxels.
pub fn compare(a: &Points, b: &Points, tolerance: f64) -> Vec<String> {
    if a.len() != b.len() {
        return vec![format!("{} points and {}", a.len(), b.len())];
    }
    let mut different = Vec::new();
    let places = |points: &Points| {
        PointValues::Vec3d(points.positions().iter().map(|p| p.to_array()).collect())
    };
    different.extend(values("positions", &places(a), &places(b), 1, tolerance));
    let both = a.attributes().iter().filter_map(|own| Some((own, b.attribute(&own.name)?)));
    for (own, theirs) in both {
        different.extend(attributes(own, theirs, tolerance));
    }
    let missing = |a: &Points, b: &Points| -> Vec<String> {
        let attributes = a.attributes().iter().filter(|own| b.attribute(&own.name).is_none());
        attributes
            .map(|own| format!("attribute {} is in one file only", quoted(&own.name)))
            .collect()
    };
    different.extend(missing(a, b));
    different.extend(missing(b, a));
    let mut groups: Vec<&str> = [a, b].iter().flat_map(|p| p.groups()).map(|g| &*g.name).collect();
    groups.sort_unstable();
    groups.dedup();
    for name in groups {
        let name_shown = quoted(name);
        match (a.in_group(name), b.in_group(name)) {
            (Some(own), Some(theirs)) => {
                let count = own.zip(theirs).filter(|(own, theirs)| own != theirs).count();
                if count > 0 {
                    let of = a.len();
                    different.push(format!("group {name_shown}: {count} of {of} points differ"));
                }
            }
            _ => different.push(format!("group {name_shown} is in one file only")),
        }
    }
    different
}

/// The differences between two attributes of one name. Their codecs may differ, and the bits of groups
/// are compared by the names of the groups.
fn attributes(a: &PointAttribute, b: &PointAttribute, tolerance: f64) -> Option<String> {
    let name = format!("attribute {}", quoted(&a.name));
    let each = a.values_per_point;
    if each != b.values_per_point {
        return Some(format!("{name}: {each} values for each point and {}", b.values_per_point));
    }
    match (&a.values, &b.values) {
        (Some(PointValues::Groups(_)), Some(PointValues::Groups(_))) => None,
        (Some(own), Some(theirs)) => values(&name, own, theirs, each as usize, tolerance),
        _ if a.is_read() && b.is_read() => None,
        _ => Some(format!("{name} cannot be compared, as it is not read")),
    }
}

/// The differences between the values of an attribute; each point may have several.
fn values(
    name: &str,
    a: &PointValues,
    b: &PointValues,
    each: usize,
    tolerance: f64,
) -> Option<String> {
    let Some(gaps) = gaps(a, b) else {
        return Some(format!("{name}: values of different types"));
    };
    let of_point = each * gaps.len() / a.len().max(1);
    let is_apart = |gaps: &&[f64]| gaps.iter().any(|gap| *gap > tolerance);
    let count = gaps.chunks(of_point.max(1)).filter(is_apart).count();
    let largest = gaps.iter().copied().fold(0.0, f64::max);
    let of = gaps.len() / of_point.max(1);
    (count > 0).then(|| format!("{name}: {count} of {of} points differ, by up to {largest}"))
}

/// The distance between each two numbers; `None` if their types differ.
fn gaps(a: &PointValues, b: &PointValues) -> Option<Vec<f64>> {
    use PointValues::{Bool, Double, Float, Int32, Int64, Vec3d, Vec3i, Vec3s};
    let float = |(a, b): (f64, f64)| match (a - b).abs() {
        _ if a == b || a.is_nan() && b.is_nan() => 0.0,
        gap if gap.is_nan() => f64::INFINITY,
        gap => gap,
    };
    macro_rules! each {
        ($a:expr, $b:expr, $gap:expr) => {
            $a.iter().zip($b).map($gap).collect()
        };
    }
    Some(match (a, b) {
        (Bool(a), Bool(b)) => each!(a, b, |(a, b)| f64::from(a != b)),
        (Int32(a), Int32(b)) => each!(a, b, |(a, b)| a.abs_diff(*b).into()),
        (Int64(a), Int64(b)) => each!(a, b, |(a, b)| a.abs_diff(*b) as f64),
        (Float(a), Float(b)) => each!(a, b, |(a, b)| float(((*a).into(), (*b).into()))),
        (Double(a), Double(b)) => each!(a, b, |(a, b)| float((*a, *b))),
        (Vec3i(a), Vec3i(b)) => {
            each!(a.as_flattened(), b.as_flattened(), |(a, b)| a.abs_diff(*b).into())
        }
        (Vec3s(a), Vec3s(b)) => {
            let numbers = a.as_flattened().iter().zip(b.as_flattened());
            numbers.map(|(a, b)| float(((*a).into(), (*b).into()))).collect()
        }
        (Vec3d(a), Vec3d(b)) => {
            each!(a.as_flattened(), b.as_flattened(), |(a, b)| float((*a, *b)))
        }
        _ => return None,
    })
}
