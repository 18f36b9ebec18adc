//! The program `ffmpeg`, which is given raw pictures through a pipe.

use std::ffi::OsString;
use std::io::{self, Read, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use bevy::math::UVec2;

use super::encode::Encoder;
use super::{VdbRecordError, VdbRecordFormat, VdbRecordSettings};

pub(super) struct Ffmpeg {
    child: Child,
    /// Closed at the end, which tells the program that all has come.
    pictures: Option<ChildStdin>,
    /// Reads what the program says, so that it never waits for somebody who does.
    said: Option<JoinHandle<String>>,
}

impl Ffmpeg {
    /// Starts a program of that name on the `PATH`.
    pub fn start(
        program: &str,
        settings: &VdbRecordSettings,
        size: UVec2,
    ) -> Result<Self, VdbRecordError> {
        let mut child = Command::new(program)
            .args(arguments(settings, size))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => VdbRecordError::FfmpegMissing,
                _ => VdbRecordError::Ffmpeg {
                    status: "it did not start".into(),
                    said: error.to_string(),
                },
            })?;
        let pictures = child.stdin.take();
        let said = child.stderr.take().map(|stderr| thread::spawn(|| end_of(stderr)));
        Ok(Self { child, pictures, said })
    }

    fn wait(&mut self) -> Result<(), VdbRecordError> {
        self.pictures = None;
        let status = self.child.wait();
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        let status = match status {
            Ok(status) if status.success() => return Ok(()),
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        let said = if said.is_empty() { "it said nothing".into() } else { said };
        Err(VdbRecordError::Ffmpeg { status, said })
    }
}

impl Encoder for Ffmpeg {
    fn write(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError> {
        let Some(pipe) = &mut self.pictures else { return Ok(()) };
        pipe.write_all(pixels).map_err(|error| VdbRecordError::Write {
            path: "the pipe to ffmpeg".into(),
            source: Arc::new(error),
        })
    }

    fn repeat(&mut self, pixels: &[u8]) -> Result<(), VdbRecordError> {
        self.write(pixels)
    }

    fn finish(mut self: Box<Self>) -> Result<(), VdbRecordError> {
        self.wait()
    }
}

impl Drop for Ffmpeg {
    /// No process stays behind that nobody has waited for.
    fn drop(&mut self) {
        self.pictures = None;
        self.child.wait().ok();
    }
}

/// The last of what is said, at most a few lines.
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
    // Chroma has half the resolution: what every player can show. H.264 wants even sizes for that.
    list += if is_mp4 { " crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0," } else { " " };
    // Colours as they are: sRGB has the primaries of BT.709 and a curve of its own.
    list += "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p -colorspace bt709 \
             -color_primaries bt709 -color_trc iec61966-2-1 -color_range tv";
    list += if is_mp4 {
        " -c:v libx264 -preset veryfast -crf 18 -movflags +frag_keyframe+empty_moov+default_base_moof"
    } else {
        " -c:v libvpx-vp9 -crf 24 -b:v 0 -row-mt 1 -deadline realtime -cpu-used 5"
    };
    // A key frame a second: with it a fragment is whole.
    list += &format!(" -g {rate} -f {}", if is_mp4 { "mp4" } else { "webm" });
    let mut list: Vec<OsString> = list.split(' ').map(OsString::from).collect();
    list.extend(settings.ffmpeg_args.iter().map(OsString::from));
    // With its protocol, so that no name can be taken for an option or another protocol.
    let mut file = OsString::from("file:");
    file.push(&settings.target);
    list.push(file);
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_program_is_told() {
        let settings = VdbRecordSettings::new("a.mp4", VdbRecordFormat::Mp4);
        let result = Ffmpeg::start("ffmpeg-that-is-not-there", &settings, UVec2::splat(2));
        let Err(error) = result else { panic!("it was there") };
        assert!(matches!(error, VdbRecordError::FfmpegMissing), "{error:?}");
        assert!(error.to_string().contains("apt install ffmpeg"), "{error}");
    }

    #[test]
    fn the_end_of_what_is_said_is_kept() {
        let said = "x".repeat(20_000) + "the reason\n";
        let end = end_of(said.as_bytes());
        assert!(end.len() <= 1000 && end.ends_with("the reason"));
    }
}
