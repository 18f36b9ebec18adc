//! How different two pictures look, for scripts/peer-pictures.
//!
//! Usage: `flip A.pfm B.pfm`. Both are colour pictures in 32-bit floats, linear, from 0 to 1, of a screen.
//! Prints the mean and the largest FLIP.

use std::{env, error::Error, fs, process::ExitCode};

use glam::{UVec2, Vec3};

// The one implementation, which the tests of the plugin have.
#[path = "../../../tests/picture/flip.rs"]
mod flip;

/// The picture of the plugin's tests.
mod common {
    use glam::{UVec2, Vec4};

    pub struct Picture {
        pub size: UVec2,
        pub pixels: Vec<Vec4>,
    }
}

/// Reads a portable float map of three components, whose rows begin at the bottom.
fn read(path: &str) -> Result<common::Picture, Box<dyn Error>> {
    let bytes = fs::read(path)?;
    let mut lines = bytes.splitn(4, |byte| *byte == b'\n');
    let mut line = || lines.next().ok_or("the header is cut off");
    let (kind, size, order, data) = (line()?, line()?, line()?, line()?);
    if kind != b"PF" || !order.starts_with(b"-") {
        return Err("it is not a colour picture in little-endian floats".into());
    }
    let sizes = str::from_utf8(size)?.split_whitespace().map(str::parse);
    let [width, height] = sizes.collect::<Result<Vec<u32>, _>>()?[..] else {
        return Err("it has no size".into());
    };
    if width == 0 || data.len() as u64 != 12 * u64::from(width) * u64::from(height) {
        return Err("its size is not that of its pixels".into());
    }
    let float = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let rows = data.chunks_exact(12 * width as usize).rev();
    let pixels = rows.flat_map(|row| row.chunks_exact(12)).map(|pixel| {
        Vec3::new(float(&pixel[..4]), float(&pixel[4..8]), float(&pixel[8..])).extend(1.0)
    });
    Ok(common::Picture { size: UVec2::new(width, height), pixels: pixels.collect() })
}

fn main() -> ExitCode {
    let paths: Vec<String> = env::args().skip(1).collect();
    let [a, b] = &paths[..] else {
        eprintln!("flip A.pfm B.pfm");
        return ExitCode::FAILURE;
    };
    let read = |path: &String| read(path).map_err(|error| format!("{path}: {error}"));
    let (a, b) = match (read(a), read(b)) {
        (Ok(a), Ok(b)) => (a, b),
        (Err(error), _) | (_, Err(error)) => {
            eprintln!("flip: {error}");
            return ExitCode::FAILURE;
        }
    };
    if a.size != b.size {
        eprintln!("flip: the pictures have two sizes: {} and {}", a.size, b.size);
        return ExitCode::FAILURE;
    }
    let all = flip::flip(&a, &b);
    println!("{:.6} {:.6}", flip::mean(&all), all.iter().copied().fold(0.0, f64::max));
    ExitCode::SUCCESS
}
