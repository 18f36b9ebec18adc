//! Pictures in files.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// A picture of 8 bits per channel.
pub struct Picture {
    pub width: u32,
    pub height: u32,
    channels: usize,
    bytes: Vec<u8>,
}

impl Picture {
    pub fn open(path: &Path) -> Result<Self, String> {
        let told = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let file = File::open(path).map_err(|error| told(&error))?;
        let mut reader =
            png::Decoder::new(BufReader::new(file)).read_info().map_err(|error| told(&error))?;
        let size = reader.output_buffer_size().ok_or_else(|| told(&"too large"))?;
        let mut bytes = vec![0; size];
        let info = reader.next_frame(&mut bytes).map_err(|error| told(&error))?;
        let channels = info.color_type.samples();
        if info.bit_depth != png::BitDepth::Eight || channels < 3 {
            return Err(told(&"not a picture of 8 bits per channel"));
        }
        Ok(Self { width: info.width, height: info.height, channels, bytes })
    }

    /// The colour of a pixel, from the top left.
    pub fn at(&self, x: u32, y: u32) -> [u8; 3] {
        let first = (y as usize * self.width as usize + x as usize) * self.channels;
        std::array::from_fn(|i| self.bytes[first + i])
    }
}
