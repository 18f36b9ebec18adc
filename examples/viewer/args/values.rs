//! The values of options.

use std::ffi::{OsStr, OsString};
use std::path::PathBuf;
use std::str::FromStr;

use bevy::math::{DVec3, UVec2};
use bevy_vdb::{VdbOverlays, VdbRenderMode};

/// The largest edge of an image. The limit of the GPU, which is checked later, is lower.
const MAX_EDGE: u32 = 32_768;

/// The names of `--borders`.
pub const NODES: [(&str, fn(&mut VdbOverlays) -> &mut bool); 3] = [
    ("leaves", |overlays| &mut overlays.leaves),
    ("lower", |overlays| &mut overlays.lower),
    ("upper", |overlays| &mut overlays.upper),
];

/// The value of an option. Errors name the option and valid values.
pub fn value<T>(
    parser: &mut lexopt::Parser,
    option: &str,
    parse: impl Fn(&OsStr) -> Result<T, String>,
) -> Result<T, String> {
    let value = parser.value().map_err(|error| error.to_string())?;
    parse(&value).map_err(|why| format!("{option} {}: {why}", value.display()))
}

fn text(value: &OsStr) -> Result<&str, String> {
    value.to_str().ok_or_else(|| "it is not UTF-8".into())
}

pub fn name(value: &OsStr) -> Result<String, String> {
    Ok(text(value)?.to_owned())
}

/// Parses `NAME=ISO` or `NAME`; an `=` that is not followed by a number is part of the name.
pub fn surface(value: &OsStr) -> Result<(String, f32), String> {
    let text = text(value)?;
    let number = |iso: &str| f32::from_str(iso).ok().filter(|iso| iso.is_finite());
    let split = text.rsplit_once('=').and_then(|(name, iso)| Some((name, number(iso)?)));
    let (name, iso) = split.unwrap_or((text, 0.0));
    Ok((name.to_owned(), iso))
}

pub fn heat(value: &OsStr) -> Result<[f32; 2], String> {
    let (scale, offset) = text(value)?.split_once(',').ok_or("it is two numbers like 1000,0")?;
    let kelvin = |text: &str| number(text.as_ref(), 0.0, 1e6);
    Ok([kelvin(scale)? as f32, kelvin(offset)? as f32])
}

pub fn frame_number(value: &OsStr) -> Result<u64, String> {
    u64::from_str(text(value)?).map_err(|_| "it is the number of a frame, such as 12".into())
}

pub fn mode(value: &OsStr) -> Result<VdbRenderMode, String> {
    let name = text(value)?;
    let found = VdbRenderMode::ALL.iter().copied().find(|mode| mode.name() == name);
    found.ok_or_else(|| {
        let names: Vec<_> = VdbRenderMode::ALL.iter().map(|mode| mode.name()).collect();
        format!("it is one of {}", names.join(", "))
    })
}

pub fn size(value: &OsStr) -> Result<UVec2, String> {
    let edge = |text| u32::from_str(text).ok().filter(|edge| (1..=MAX_EDGE).contains(edge));
    text(value)?
        .split_once('x')
        .and_then(|(width, height)| Some(UVec2::new(edge(width)?, edge(height)?)))
        .ok_or_else(|| format!("a size is like 1280x720, each from 1 to {MAX_EDGE}"))
}

pub fn point(value: &OsStr) -> Result<DVec3, String> {
    let text = text(value)?;
    let numbers: Vec<f64> =
        text.split(',').filter_map(|number| f64::from_str(number.trim()).ok()).collect();
    match numbers[..] {
        [x, y, z] if text.split(',').count() == 3 && [x, y, z].iter().all(|x| x.is_finite()) => {
            Ok(DVec3::new(x, y, z))
        }
        _ => Err("a point is three numbers like 0,1.5,-2".into()),
    }
}

pub fn direction(value: &OsStr) -> Result<DVec3, String> {
    let direction = point(value)?;
    // The direction is converted to f32.
    let length = direction.as_vec3().length();
    let usable = length.is_normal() && length.recip().is_normal();
    usable.then_some(direction).ok_or_else(|| "it is not a direction".into())
}

pub fn overlays(value: &OsStr) -> Result<VdbOverlays, String> {
    let mut overlays = VdbOverlays::default();
    for name in text(value)?.split(',') {
        let Some((_, flag)) = NODES.iter().find(|(known, _)| *known == name) else {
            return Err(format!("{name:?} is none of leaves, lower, upper"));
        };
        *flag(&mut overlays) = true;
    }
    Ok(overlays)
}

pub fn fov(value: &OsStr) -> Result<f64, String> {
    Ok(number(value, 0.1, 175.0)?.to_radians())
}

pub fn density(value: &OsStr) -> Result<f32, String> {
    Ok(number(value, 0.0, 1e9)? as f32)
}

fn number(value: &OsStr, least: f64, most: f64) -> Result<f64, String> {
    f64::from_str(text(value)?)
        .ok()
        .filter(|number| (least..=most).contains(number))
        .ok_or_else(|| format!("it is a number from {least} to {most}"))
}

pub fn picture_path(value: &OsStr) -> Result<PathBuf, String> {
    let path = PathBuf::from(value);
    match path.extension() {
        Some(extension) if extension.eq_ignore_ascii_case("png") => Ok(path),
        _ => Err("only PNG is written; the name must end in .png".into()),
    }
}

/// Makes a path absolute: users mean the current folder, but Bevy the asset folder.
pub fn absolute(file: OsString) -> Result<PathBuf, String> {
    std::path::absolute(&file).map_err(|error| format!("{}: {error}", file.display()))
}
