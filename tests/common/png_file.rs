//! PNG files as the programs of this crate write them: RGB, 8 bits.

use std::path::Path;

use bevy::math::UVec2;

pub struct Png {
    pub size: UVec2,
    /// sRGB, row by row from the top left.
    pub pixels: Vec<[u8; 3]>,
}

impl Png {
    pub fn read(path: &Path) -> Self {
        let file = std::fs::File::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
        let pixels = bytes[..info.buffer_size()].as_chunks::<3>().0.to_vec();
        Self { size: UVec2::new(info.width, info.height), pixels }
    }
}
