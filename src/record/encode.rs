//! Frames into files, on a thread of their own.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use bevy::math::UVec2;

use super::ffmpeg::Ffmpeg;
use super::session::Frame;
use super::{VdbRecordError, VdbRecordFormat, VdbRecordSettings};

/// Where frames of one size go.
pub(super) trait Encoder {
    fn write(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError>;

    /// Writes the frame before once more.
    fn repeat(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError>;

    /// Makes the file whole; also after an error, which it may say more of.
    fn finish(self: Box<Self>) -> Result<(), VdbRecordError>;
}

/// Encodes until no more frames can come; calls back for each that has been written.
pub(super) fn encode(
    settings: &VdbRecordSettings,
    frames: &Receiver<Frame>,
    mut written: impl FnMut(),
) -> Result<(), VdbRecordError> {
    let is_sequence = settings.format == VdbRecordFormat::PngSequence;
    let folder = if is_sequence { Some(&*settings.target) } else { settings.target.parent() };
    // So that this error comes even if no frame does.
    if let Some(folder) = folder.filter(|folder| !folder.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(|error| cannot_write(folder, error))?;
    }
    let Ok(mut frame) = frames.recv() else { return Err(VdbRecordError::NoFrames) };
    let mut encoder: Box<dyn Encoder> = match settings.format {
        VdbRecordFormat::PngSequence => Box::new(PngSequence::new(&settings.target, frame.size)),
        VdbRecordFormat::Mp4 | VdbRecordFormat::WebM => {
            Box::new(Ffmpeg::start("ffmpeg", settings, frame.size)?)
        }
    };
    let mut write_all = || {
        loop {
            encoder.write(&frame.pixels)?;
            written();
            let Ok(next) = frames.recv() else { return Ok(()) };
            for _ in frame.slot + 1..next.slot {
                encoder.repeat(&frame.pixels)?;
                written();
            }
            frame = next;
        }
    };
    let result: Result<(), VdbRecordError> = write_all();
    // What went wrong at the pipe is told better by how the program ended.
    encoder.finish().and(result)
}

pub(super) fn cannot_write(path: &Path, error: std::io::Error) -> VdbRecordError {
    VdbRecordError::Write { path: path.to_owned(), source: Arc::new(error) }
}

struct PngSequence {
    folder: PathBuf,
    size: UVec2,
    /// The number of the next file.
    next: u64,
    rgb: Vec<u8>,
    /// The last file.
    file: Vec<u8>,
}

impl PngSequence {
    fn new(folder: &Path, size: UVec2) -> Self {
        Self { folder: folder.to_owned(), size, next: 0, rgb: Vec::new(), file: Vec::new() }
    }

    fn compress(&mut self) -> Result<(), png::EncodingError> {
        self.file.clear();
        let mut encoder = png::Encoder::new(&mut self.file, self.size.x, self.size.y);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        // Frames must come as fast as the app draws them.
        encoder.set_compression(png::Compression::Fast);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish()
    }

    fn save(&mut self) -> Result<(), VdbRecordError> {
        let path = self.folder.join(format!("{:08}.png", self.next));
        self.next += 1;
        fs::write(&path, &self.file).map_err(|error| {
            // Half a picture would spoil the sequence.
            fs::remove_file(&path).ok();
            cannot_write(&path, error)
        })
    }
}

impl Encoder for PngSequence {
    fn write(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError> {
        self.rgb.clear();
        self.rgb.extend(pixels.chunks_exact(4).flat_map(|pixel| &pixel[..3]));
        self.compress().map_err(|error| cannot_write(&self.folder, error.into()))?;
        self.save()
    }

    fn repeat(&mut self, _: &[u8]) -> Result<(), VdbRecordError> {
        self.save()
    }

    fn finish(self: Box<Self>) -> Result<(), VdbRecordError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests;
