//! Values of options: vectors, colours, lights, sizes.

use std::str::FromStr;

use glam::{DVec3, UVec2, Vec3};

/// The most pixels along an edge of a picture.
pub const MAX_EDGE: u32 = 16_384;
/// The most rays for one pixel.
pub const MAX_SAMPLES: u32 = 1_024;

/// Finite numbers between commas.
fn numbers(text: &str, what: &str) -> Result<Vec<f64>, String> {
    let number = |text: &str| text.trim().parse().ok().filter(|number: &f64| number.is_finite());
    text.split(',').map(number).collect::<Option<_>>().ok_or_else(|| what.to_owned())
}

/// Three finite numbers.
#[derive(Clone, Copy, Debug)]
pub struct Vector(pub DVec3);

impl FromStr for Vector {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let what = "this takes three numbers with commas, such as 1,-2.5,3";
        match numbers(text, what)?[..] {
            [x, y, z] => Ok(Self(DVec3::new(x, y, z))),
            _ => Err(what.to_owned()),
        }
    }
}

/// Linear RGB, without an upper bound.
#[derive(Clone, Copy, Debug)]
pub struct Rgb(pub Vec3);

impl FromStr for Rgb {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let what = "this takes red, green and blue from 0 to 1e6, such as 0.9,0.8,0.7";
        match numbers(text, what)?[..] {
            [r, g, b] => Ok(Self(amounts([r, g, b]).ok_or(what)?)),
            _ => Err(what.to_owned()),
        }
    }
}

/// Amounts of light that no sum makes infinite.
fn amounts(rgb: [f64; 3]) -> Option<Vec3> {
    let sound = rgb.iter().all(|amount| (0.0..=1e6).contains(amount));
    sound.then(|| Vec3::from_array(rgb.map(|amount| amount as f32)))
}

/// A light at infinity.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// The direction towards the light; not zero.
    pub direction: DVec3,
    /// The radiance of a white surface that faces it, linear RGB.
    pub color: Option<Vec3>,
}

impl FromStr for Light {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let what = "a light is a direction, and perhaps red, green and blue from 0 to 1e6, such as \
                    0.3,1,0.2 or 0.3,1,0.2,1,0.9,0.8";
        let (direction, color) = match numbers(text, what)?[..] {
            [x, y, z] => (DVec3::new(x, y, z), None),
            [x, y, z, r, g, b] => (DVec3::new(x, y, z), Some(amounts([r, g, b]).ok_or(what)?)),
            _ => return Err(what.to_owned()),
        };
        let direction = direction.try_normalize();
        let direction = direction.ok_or("the direction of the light has no length")?;
        Ok(Self { direction, color })
    }
}

/// Width and height in pixels.
#[derive(Clone, Copy, Debug)]
pub struct Size(pub UVec2);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let edges = text.split_once(['x', 'X']);
        let edge =
            |text: &str| text.trim().parse().ok().filter(|edge| (1..=MAX_EDGE).contains(edge));
        edges
            .and_then(|(width, height)| Some(Self(UVec2::new(edge(width)?, edge(height)?))))
            .ok_or_else(|| {
                format!("a size is two whole numbers from 1 to {MAX_EDGE}, such as 1280x720")
            })
    }
}

/// What is behind the volumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// Nothing: the picture has an alpha channel.
    Transparent,
    /// A colour, as the file will have it.
    Color([u8; 3]),
}

impl FromStr for Background {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = match text {
            "transparent" => return Ok(Self::Transparent),
            "black" => "000000",
            "white" => "ffffff",
            _ => text.strip_prefix('#').unwrap_or(text),
        };
        let plain = digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        let code = u32::from_str_radix(digits, 16).ok().filter(|_| plain);
        let [_, rgb @ ..] = code
            .ok_or("a background is `transparent`, `black`, `white` or a colour such as #20262e")?
            .to_be_bytes();
        Ok(Self::Color(rgb))
    }
}
