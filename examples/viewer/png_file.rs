//! PNG files.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use bevy::math::UVec2;

/// Writes an image. `pixels` are sRGB with 8 bits per channel, row by row from the top left.
pub fn write(path: &Path, size: UVec2, pixels: &[[u8; 3]]) -> Result<(), String> {
    let write = || -> Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(BufWriter::new(File::create(path)?), size.x, size.y);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(pixels.as_flattened())?;
        writer.finish()
    };
    write().map_err(|error| format!("{}: the image could not be written: {error}", path.display()))
}
