//! Transforms: the name of a map, then its numbers.

use glam::DVec3;

use super::cursor::Cursor;
use super::header::{FLOAT_FRUSTUM_BBOX, NEW_TRANSFORM};
use super::metadata::write_sized;
use crate::display::quoted;
use crate::transform::{Affine, Frustum, Map};
use crate::{Error, Limits, Transform};

pub(crate) fn read(
    cursor: &mut Cursor<'_>,
    version: u32,
    limits: &Limits,
) -> Result<Transform, Error> {
    let at = cursor.at();
    let name = cursor.string(limits)?;
    let map = if version < NEW_TRANSFORM {
        read_old(cursor, &name)
    } else if name == "NonlinearFrustumMap" {
        read_frustum(cursor, version, limits).map(Map::NonlinearFrustum)
    } else {
        read_linear(cursor, &name)
    };
    map.and_then(|map| Transform { map }.checked()).map_err(|error| error.at(at))
}

fn read_linear(cursor: &mut Cursor<'_>, name: &str) -> Result<Map, Error> {
    Ok(match name {
        "UniformScaleMap" => Map::UniformScale(read_scale(cursor)?),
        "ScaleMap" => Map::Scale(read_scale(cursor)?),
        "TranslationMap" => Map::Translation(cursor.dvec3()?),
        "UniformScaleTranslateMap" => {
            let translation = cursor.dvec3()?;
            Map::UniformScaleTranslate { scale: read_scale(cursor)?, translation }
        }
        "ScaleTranslateMap" => {
            let translation = cursor.dvec3()?;
            Map::ScaleTranslate { scale: read_scale(cursor)?, translation }
        }
        "UnitaryMap" => Map::Unitary(read_affine(cursor)?),
        "AffineMap" => Map::Affine(read_affine(cursor)?),
        _ => return Err(Error::not_supported(format!("the map {} is not known", quoted(name)))),
    })
}

/// Reads a scale, and skips the voxel size and three kinds of inverse, all of which follow from it.
fn read_scale(cursor: &mut Cursor<'_>) -> Result<DVec3, Error> {
    let scale = cursor.dvec3()?;
    cursor.take(4 * 3 * size_of::<f64>())?;
    Ok(scale)
}

fn read_rows(cursor: &mut Cursor<'_>) -> Result<[[f64; 4]; 4], Error> {
    let mut rows = [[0.0; 4]; 4];
    for number in rows.as_flattened_mut() {
        *number = cursor.f64()?;
    }
    Ok(rows)
}

fn read_affine(cursor: &mut Cursor<'_>) -> Result<Affine, Error> {
    affine(read_rows(cursor)?)
}

fn affine(rows: [[f64; 4]; 4]) -> Result<Affine, Error> {
    Affine::new(rows).ok_or_else(|| {
        Error::invalid(format!("the matrix {rows:?} of the map is not affine or has no inverse"))
    })
}

fn read_frustum(cursor: &mut Cursor<'_>, version: u32, limits: &Limits) -> Result<Frustum, Error> {
    let (min, max) = if version < FLOAT_FRUSTUM_BBOX {
        (cursor.ivec3()?.as_dvec3(), cursor.ivec3()?.as_dvec3())
    } else {
        (cursor.dvec3()?, cursor.dvec3()?)
    };
    let (taper, depth) = (cursor.f64()?, cursor.f64()?);
    let name = cursor.string(limits)?;
    let second = Transform { map: read_linear(cursor, &name)? }.checked()?;
    let second = match second.map {
        Map::Unitary(affine) | Map::Affine(affine) => affine,
        // OpenVDB also converts the map to a matrix and writes it as one.
        _ => affine(rows_of(&second)?)?,
    };
    Ok(Frustum { min, max, taper, depth, second })
}

/// The matrix of a map that scales and translates.
fn rows_of(map: &Transform) -> Result<[[f64; 4]; 4], Error> {
    let linear = map.linear().ok_or_else(|| Error::invalid("a frustum within a frustum"))?;
    let [x, y, z] = linear.matrix3.to_cols_array_2d();
    let row = |[a, b, c]: [f64; 3], d| [a, b, c, d];
    Ok([row(x, 0.0), row(y, 0.0), row(z, 0.0), row(linear.translation.to_array(), 1.0)])
}

/// Reads a transform of version 218: four matrices, of which two make up the map.
fn read_old(cursor: &mut Cursor<'_>, name: &str) -> Result<Map, Error> {
    if name != "LinearTransform" {
        return Err(Error::not_supported(format!(
            "the transform {} of format version 218; open the file in a current version of its \
             program and save it again",
            quoted(name)
        )));
    }
    let _box = (cursor.ivec3()?, cursor.ivec3()?);
    let world_from_local = read_rows(cursor)?;
    let _local_from_world = read_rows(cursor)?;
    let local_from_voxel = read_rows(cursor)?;
    let _voxel_from_local = read_rows(cursor)?;
    let product = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            (0..4).map(|k| local_from_voxel[i][k] * world_from_local[k][j]).sum()
        })
    });
    Ok(simplify(affine(product)?))
}

/// The simplest equivalent map, as OpenVDB chooses it for old files.
pub(crate) fn simplify(affine: Affine) -> Map {
    let m = affine.rows;
    let off_diagonal = (0..3).any(|i| (0..3).any(|j| i != j && m[i][j] != 0.0));
    if off_diagonal {
        return Map::Affine(affine);
    }
    let scale = DVec3::new(m[0][0], m[1][1], m[2][2]);
    let translation = DVec3::new(m[3][0], m[3][1], m[3][2]);
    // OpenVDB's tolerance for approximately equal f64 numbers.
    let uniform = (scale - DVec3::splat(scale.x)).abs().max_element() <= 1e-15;
    match (uniform, translation == DVec3::ZERO) {
        (true, true) => Map::UniformScale(DVec3::splat(scale.x)),
        (false, true) => Map::Scale(scale),
        (true, false) => Map::UniformScaleTranslate { scale: DVec3::splat(scale.x), translation },
        (false, false) => Map::ScaleTranslate { scale, translation },
    }
}

/// Writes a transform.
pub(crate) fn write(out: &mut Vec<u8>, transform: &Transform) -> Result<(), Error> {
    write_sized(out, transform.map_type().as_bytes())?;
    match &transform.map {
        Map::UniformScale(scale) | Map::Scale(scale) => write_scale(out, *scale),
        Map::Translation(translation) => write_vec3(out, *translation),
        Map::UniformScaleTranslate { scale, translation }
        | Map::ScaleTranslate { scale, translation } => {
            write_vec3(out, *translation);
            write_scale(out, *scale);
        }
        Map::Unitary(affine) | Map::Affine(affine) => {
            write_numbers(out, affine.rows.as_flattened())
        }
        Map::NonlinearFrustum(frustum) => {
            write_vec3(out, frustum.min);
            write_vec3(out, frustum.max);
            write_numbers(out, &[frustum.taper, frustum.depth]);
            write_sized(out, b"AffineMap")?;
            write_numbers(out, frustum.second.rows.as_flattened());
        }
    }
    Ok(())
}

fn write_numbers(out: &mut Vec<u8>, numbers: &[f64]) {
    out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

fn write_vec3(out: &mut Vec<u8>, vector: DVec3) {
    write_numbers(out, &vector.to_array());
}

/// Writes a scale and the values that OpenVDB stores with it: voxel size, inverse, square of the
/// inverse, and half of the inverse.
fn write_scale(out: &mut Vec<u8>, scale: DVec3) {
    let inverse = scale.recip();
    for vector in [scale, scale.abs(), inverse, inverse * inverse, inverse / 2.0] {
        write_vec3(out, vector);
    }
}
