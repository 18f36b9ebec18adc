//! The encoder thread, which writes frames to files.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Receiver;

use bevy::math::UVec2;

use super::ffmpeg::Ffmpeg;
use super::pulse::Pulse;
use super::session::{Frame, Session};
use super::target::{Encoder, cannot_write, is_free, part_of, write_in_parts};
use super::{VdbRecordError, VdbRecordFormat, VdbRecordSettings};

/// Encodes frames until no more can arrive.
pub(super) fn encode(session: &Session, frames: &Receiver<Frame>) -> Result<(), VdbRecordError> {
    let (settings, pulse) = (&session.settings, &session.pulse);
    // Before the first frame, so that these errors are reported even if none arrives.
    make_folder(settings)?;
    refuse_existing(settings)?;
    let receive = || {
        pulse.set_idle(true);
        let frame = frames.recv().ok();
        pulse.set_idle(false);
        frame
    };
    let Some(mut frame) = receive() else { return Err(VdbRecordError::NoFrames) };
    let mut encoder: Box<dyn Encoder + '_> = match settings.format {
        VdbRecordFormat::PngSequence => Box::new(PngSequence::new(settings, pulse, frame.size)),
        VdbRecordFormat::Mp4 | VdbRecordFormat::WebM => {
            Box::new(Ffmpeg::start(settings, pulse, frame.size)?)
        }
    };
    let mut write_all = || {
        loop {
            encoder.write(&frame.pixels)?;
            session.count_written();
            let Some(next) = receive() else { return Ok(()) };
            for _ in frame.slot + 1..next.slot {
                encoder.repeat(&frame.pixels)?;
                session.count_written();
            }
            frame = next;
        }
    };
    let result: Result<(), VdbRecordError> = write_all();
    // The program's exit status explains a broken pipe better than the pipe does.
    encoder.finish().and(result)
}

fn make_folder(settings: &VdbRecordSettings) -> Result<(), VdbRecordError> {
    let is_sequence = settings.format == VdbRecordFormat::PngSequence;
    let folder = if is_sequence { Some(&*settings.target) } else { settings.target.parent() };
    match folder.filter(|folder| !folder.as_os_str().is_empty()) {
        Some(folder) => fs::create_dir_all(folder).map_err(|error| cannot_write(folder, error)),
        None => Ok(()),
    }
}

/// Refuses to replace files of an earlier recording, or to leave some of them after the end of this
/// one, unless requested.
fn refuse_existing(settings: &VdbRecordSettings) -> Result<(), VdbRecordError> {
    if settings.overwrite {
        return Ok(());
    }
    match part_of(settings) {
        Some(part) => is_free(&part).and_then(|()| is_free(&settings.target)),
        None => {
            let pictures = pictures_in(&settings.target)
                .map_err(|error| cannot_write(&settings.target, error))?;
            match pictures.into_iter().min() {
                Some((_, path)) => Err(VdbRecordError::Exists { path }),
                None => Ok(()),
            }
        }
    }
}

/// The file name of an image in a sequence.
fn picture(number: u64) -> String {
    format!("{number:08}.png")
}

/// The images of a sequence in a folder, with their numbers.
fn pictures_in(folder: &Path) -> io::Result<Vec<(u64, PathBuf)>> {
    let mut pictures = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let number = name.to_str().and_then(|name| name.strip_suffix(".png")?.parse().ok());
        if let Some(number) = number.filter(|number| *name == *picture(*number)) {
            pictures.push((number, entry.path()));
        }
    }
    Ok(pictures)
}

struct PngSequence<'a> {
    folder: &'a Path,
    /// The path of an incomplete image.
    part: PathBuf,
    overwrite: bool,
    pulse: &'a Pulse,
    size: UVec2,
    /// The number of the next file.
    next: u64,
    rgb: Vec<u8>,
    /// The last file.
    file: Vec<u8>,
}

impl<'a> PngSequence<'a> {
    fn new(settings: &'a VdbRecordSettings, pulse: &'a Pulse, size: UVec2) -> Self {
        static SEQUENCES: AtomicU64 = AtomicU64::new(0);
        let own = SEQUENCES.fetch_add(1, Ordering::Relaxed);
        Self {
            folder: &settings.target,
            // Unique, in case another recording uses the same folder.
            part: settings.target.join(format!("vdb_record_{}_{own}.part", std::process::id())),
            overwrite: settings.overwrite,
            pulse,
            size,
            next: 0,
            rgb: Vec::new(),
            file: Vec::new(),
        }
    }

    fn compress(&mut self) -> Result<(), png::EncodingError> {
        self.file.clear();
        let mut encoder = png::Encoder::new(&mut self.file, self.size.x, self.size.y);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        // Compression must keep up with the app's frame rate.
        encoder.set_compression(png::Compression::Fast);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish()
    }

    fn save(&mut self) -> Result<(), VdbRecordError> {
        let path = self.folder.join(picture(self.next));
        self.next += 1;
        if !self.overwrite {
            is_free(&path)?;
        }
        self.save_as(&path).map_err(|error| {
            fs::remove_file(&self.part).ok();
            cannot_write(&path, error)
        })
    }

    /// Writes to a temporary name first, so an incomplete file never has the name of an image.
    fn save_as(&self, path: &Path) -> io::Result<()> {
        let mut file = File::create(&self.part)?;
        write_in_parts(&mut file, &self.file, self.pulse)?;
        drop(file);
        fs::rename(&self.part, path)?;
        self.pulse.beat();
        Ok(())
    }
}

impl Encoder for PngSequence<'_> {
    fn write(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError> {
        self.rgb.clear();
        self.rgb.extend(pixels.chunks_exact(4).flat_map(|pixel| &pixel[..3]));
        self.compress().map_err(|error| cannot_write(self.folder, error.into()))?;
        self.save()
    }

    fn repeat(&mut self, _: &[u8]) -> Result<(), VdbRecordError> {
        self.save()
    }

    /// Removes images of an overwritten sequence beyond the end of this one.
    fn finish(self: Box<Self>) -> Result<(), VdbRecordError> {
        if !self.overwrite || self.next == 0 || self.pulse.is_given_up() {
            return Ok(());
        }
        let cannot = |error| cannot_write(self.folder, error);
        for (number, path) in pictures_in(self.folder).map_err(cannot)? {
            if number >= self.next {
                fs::remove_file(&path).map_err(|error| cannot_write(&path, error))?;
                self.pulse.beat();
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
