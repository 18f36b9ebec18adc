//! The `ffmpeg` program, which receives raw images through a pipe.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::PathBuf;
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use bevy::math::UVec2;

use super::pulse::Pulse;
use super::target::{Encoder, cannot_write, is_free, part_of, write_in_parts};
use super::{VdbRecordError, VdbRecordFormat, VdbRecordSettings};

/// The time to wait for the program's last output after it exits, because a child of the program
/// may keep the pipe open.
const LAST_WORDS: Duration = Duration::from_secs(1);

pub(super) struct Ffmpeg<'a> {
    settings: &'a VdbRecordSettings,
    /// Owns the child process.
    pulse: &'a Pulse,
    part: PathBuf,
    /// Closed at the end, which tells the program that there is no more input.
    pictures: Option<ChildStdin>,
    /// The end of the program's output.
    said: Receiver<String>,
}

impl<'a> Ffmpeg<'a> {
    pub fn start(
        settings: &'a VdbRecordSettings,
        pulse: &'a Pulse,
        size: UVec2,
    ) -> Result<Self, VdbRecordError> {
        let part = part_of(settings).unwrap_or_else(|| settings.target.clone());
        reserve(settings, &part)?;
        let started = Command::new(&settings.ffmpeg)
            .args(arguments(settings, size))
            // With an explicit protocol, so that no name is taken for an option or another
            // protocol.
            .arg([OsString::from("file:"), part.clone().into()].into_iter().collect::<OsString>())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = started.map_err(|error| {
            fs::remove_file(&part).ok();
            match error.kind() {
                io::ErrorKind::NotFound => {
                    VdbRecordError::FfmpegMissing { program: settings.ffmpeg.clone() }
                }
                _ => VdbRecordError::Ffmpeg {
                    status: "it did not start".into(),
                    said: error.to_string(),
                },
            }
        })?;
        let (pictures, stderr) = (child.stdin.take(), child.stderr.take());
        // Reads all output, or the program would block on a full pipe.
        let (words, said) = mpsc::channel();
        thread::spawn(move || words.send(stderr.map(end_of).unwrap_or_default()).ok());
        pulse.guard(child);
        Ok(Self { settings, pulse, part, pictures, said })
    }

    fn wait(&mut self) -> Result<(), VdbRecordError> {
        self.pictures = None;
        let status = match self.status() {
            Ok(status) if status.success() => return Ok(()),
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        let said = self.said.recv_timeout(LAST_WORDS).unwrap_or_default();
        let said = if said.is_empty() { "no output".into() } else { said };
        Err(VdbRecordError::Ffmpeg { status, said })
    }

    /// Waits for the program to exit. A growing file is a sign of progress.
    fn status(&self) -> io::Result<ExitStatus> {
        let mut known = 0;
        loop {
            if let Some(status) = self.pulse.try_wait()? {
                return Ok(status);
            }
            let length = fs::metadata(&self.part).map_or(known, |file| file.len());
            if length != known {
                known = length;
                self.pulse.beat();
            }
            // A killed program that does not exit hangs in a system call.
            let is_given_up = self.pulse.is_given_up();
            thread::sleep(Duration::from_millis(if is_given_up { 1000 } else { 5 }));
        }
    }

    /// Renames the video to its final name.
    fn name(&self) -> Result<(), VdbRecordError> {
        let target = &self.settings.target;
        if !self.settings.overwrite {
            is_free(target)?;
        }
        fs::rename(&self.part, target).map_err(|error| cannot_write(target, error))
    }
}

/// Creates the file that the program will write, so that no other recording does.
fn reserve(settings: &VdbRecordSettings, part: &PathBuf) -> Result<(), VdbRecordError> {
    let made = if settings.overwrite { File::create(part) } else { File::create_new(part) };
    made.map(drop).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => VdbRecordError::Exists { path: part.clone() },
        _ => cannot_write(part, error),
    })
}

impl Encoder for Ffmpeg<'_> {
    fn write(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError> {
        let Some(pipe) = &mut self.pictures else { return Ok(()) };
        write_in_parts(pipe, pixels, self.pulse).map_err(|error| VdbRecordError::Write {
            path: "the pipe to ffmpeg".into(),
            source: Arc::new(error),
        })
    }

    fn repeat(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError> {
        self.write(pixels)
    }

    fn finish(mut self: Box<Self>) -> Result<(), VdbRecordError> {
        let result = self.wait();
        // Removes the reserved file if the program has written nothing.
        if fs::metadata(&self.part).is_ok_and(|file| file.is_file() && file.len() == 0) {
            fs::remove_file(&self.part).ok();
        }
        result.and_then(|()| self.name())
    }
}

/// The last 1,000 bytes of an output.
fn end_of(mut stderr: impl Read) -> String {
    const KEPT: usize = 1000;
    let (mut end, mut chunk) = (Vec::new(), [0; 4096]);
    while let Ok(count @ 1..) = stderr.read(&mut chunk) {
        end.extend_from_slice(&chunk[..count]);
        end.drain(..end.len().saturating_sub(KEPT));
    }
    String::from_utf8_lossy(&end).trim().to_owned()
}

fn arguments(settings: &VdbRecordSettings, size: UVec2) -> Vec<OsString> {
    let is_mp4 = settings.format == VdbRecordFormat::Mp4;
    let rate = settings.frame_rate.to_string();
    let mut list = format!(
        "-hide_banner -loglevel error -y -f rawvideo -pixel_format rgb0 -video_size {}x{} \
         -framerate {rate} -i pipe:0 -vf",
        size.x, size.y
    );
    // Chroma has half the resolution, which every player supports. For that, H.264 needs even
    // sizes.
    list += if is_mp4 { " crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0," } else { " " };
    // Tags the colours as sRGB, which has the primaries of BT.709 and its own transfer function.
    list += "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p -colorspace bt709 \
             -color_primaries bt709 -color_trc iec61966-2-1 -color_range tv";
    list += if is_mp4 {
        " -c:v libx264 -preset veryfast -crf 18 -movflags +frag_keyframe+empty_moov+default_base_moof"
    } else {
        " -c:v libvpx-vp9 -crf 24 -b:v 0 -row-mt 1 -deadline realtime -cpu-used 5"
    };
    // One key frame per second, because a fragment ends before each key frame.
    list += &format!(" -g {rate} -f {}", if is_mp4 { "mp4" } else { "webm" });
    let mut list: Vec<OsString> = list.split(' ').map(OsString::from).collect();
    list.extend(settings.ffmpeg_args.iter().map(OsString::from));
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_program_is_told() {
        let target = std::env::temp_dir().join(format!("missing_{}.mp4", std::process::id()));
        let settings = VdbRecordSettings {
            ffmpeg: "ffmpeg-that-is-not-there".into(),
            ..VdbRecordSettings::new(target, VdbRecordFormat::Mp4)
        };
        let pulse = Pulse::default();
        let result = Ffmpeg::start(&settings, &pulse, UVec2::splat(2));
        let Err(error) = result else { panic!("it was there") };
        assert!(matches!(error, VdbRecordError::FfmpegMissing { .. }), "{error:?}");
        let said = error.to_string();
        assert!(
            said.contains("apt install ffmpeg") && said.contains("that-is-not-there"),
            "{said}"
        );
        assert!(!part_of(&settings).unwrap().exists(), "an empty file is left behind");
    }

    #[test]
    fn the_end_of_what_is_said_is_kept() {
        let said = "x".repeat(20_000) + "the reason\n";
        let end = end_of(said.as_bytes());
        assert!(end.len() <= 1000 && end.ends_with("the reason"));
    }
}
