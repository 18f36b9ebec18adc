//! `vdb between`: frames in between the frames of a sequence.

mod check;
mod frame;
mod write;

use std::borrow::Cow;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;

use vdb_core::between::{BetweenOptions, Frame, Method, fit_velocity_scale, in_between};
use vdb_core::display::quoted;
use vdb_core::{Grid, VdbFile};

use crate::files::shown;
use crate::limits::LimitArgs;
use crate::terminal;
use frame::Numbered;

/// Make frames in between: N for each step from one frame of a sequence to the next
#[derive(clap::Args)]
pub struct Args {
    /// The frames, in any order: files whose names differ in their last number
    #[arg(required = true, value_name = "FRAME")]
    frames: Vec<PathBuf>,

    /// The folder for the new sequence, whose frame numbers are multiplied by N + 1; created if
    /// missing
    #[arg(long, value_name = "DIR", required_unless_present = "check")]
    out: Option<PathBuf>,

    /// Frames in between for each step of the numbers
    #[arg(long, value_name = "N", default_value = "1")]
    steps: NonZeroU32,

    /// How they are made
    #[arg(long, value_enum, default_value_t = Way::Register)]
    method: Way,

    /// The grids, separated by commas; by default all grids of floats except level sets
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    grids: Vec<String>,

    /// The grid of velocities; by default `velocity`, `vel` or `v`
    #[arg(long, value_name = "NAME")]
    velocity: Option<String>,

    /// World units moved per frame at a velocity of 1: 1 / fps for Houdini. Fitted to the frames by
    /// default
    #[arg(long, value_name = "X", default_value = "auto", allow_negative_numbers = true)]
    velocity_scale: Scale,

    /// Write nothing: leave out every second frame, make it, and print how much it differs from
    /// the one left out
    #[arg(long, conflicts_with_all = ["out", "steps"])]
    check: bool,

    /// For --check: the extinction of rays per world unit at a value of 1. By default such that the
    /// densest ray of each frame has an optical depth of 3
    #[arg(long, value_name = "X", requires = "check", conflicts_with = "out", value_parser = extinction)]
    extinction: Option<f64>,

    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Way {
    /// Along the velocities, if there are any, and the motion found by matching the frames
    Register,
    /// Along the velocities alone
    Advect,
    /// Cross-faded without motion
    Fade,
}

impl From<Way> for Method {
    fn from(way: Way) -> Self {
        match way {
            Way::Register => Self::Register,
            Way::Advect => Self::Advect,
            Way::Fade => Self::CrossFade,
        }
    }
}

#[derive(Clone, Copy)]
enum Scale {
    Auto,
    Given(f64),
}

impl std::str::FromStr for Scale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        match text.parse::<f64>() {
            Ok(scale) if scale.is_finite() => Ok(Self::Given(scale)),
            _ => Err("give a finite number, or `auto`".into()),
        }
    }
}

fn extinction(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(extinction) if extinction.is_finite() && extinction >= 0.0 => Ok(extinction),
        _ => Err("give a number that is not negative".into()),
    }
}

/// Makes the sequence, or measures it. The exit code is a failure if a frame is missing.
pub fn run(args: &Args) -> ExitCode {
    let done = frame::series(&args.frames).and_then(|frames| {
        if args.check { check::run(args, &frames) } else { write::run(args, &frames) }
    });
    done.unwrap_or_else(|error| {
        terminal::complain(&error);
        ExitCode::FAILURE
    })
}

/// What stays the same from one pair of frames to the next.
struct Maker<'a> {
    args: &'a Args,
    /// The last velocity scale that was found, per number of a frame.
    found: Option<f64>,
}

/// Two frames that follow each other.
struct Pair<'a> {
    from: (&'a Numbered, &'a VdbFile),
    to: (&'a Numbered, &'a VdbFile),
}

impl Pair<'_> {
    /// The difference of their numbers.
    fn gap(&self) -> u64 {
        self.to.0.number - self.from.0.number
    }
}

impl Maker<'_> {
    /// The names of a frame's grids to make: those asked for, or all that can be.
    fn names(&self, file: &VdbFile) -> Vec<String> {
        if !self.args.grids.is_empty() {
            return self.args.grids.clone();
        }
        let all = file.grids.iter().filter(|grid| frame::can_be_made(grid));
        all.map(|grid| grid.unique_name.clone()).collect()
    }

    /// The names of the grids to make between two frames.
    fn names_between(&self, pair: &Pair) -> Vec<String> {
        let mut names = self.names(pair.from.1);
        for name in self.names(pair.to.1) {
            if pair.from.1.grid(&name).is_none() && !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// The grids of a name in both frames. Programs leave out empty grids, so one that a single
    /// file lacks is empty there.
    fn grids<'b>(&self, pair: &Pair<'b>, name: &str) -> Result<[Cow<'b, Grid>; 2], String> {
        let [from, to] = [pair.from.1.grid(name), pair.to.1.grid(name)];
        match (from, to) {
            (Some(from), Some(to)) => Ok([Cow::Borrowed(from), Cow::Borrowed(to)]),
            (Some(from), None) => Ok([Cow::Borrowed(from), Cow::Owned(frame::empty(from))]),
            (None, Some(to)) => Ok([Cow::Owned(frame::empty(to)), Cow::Borrowed(to)]),
            (None, None) => Err(lacks(pair.from.0, name)),
        }
    }

    /// The velocities of a frame.
    fn velocity<'b>(&self, at: (&Numbered, &'b VdbFile)) -> Result<Option<&'b Grid>, String> {
        match &self.args.velocity {
            Some(name) => at.1.grid(name).map(Some).ok_or_else(|| lacks(at.0, name)),
            None => Ok(frame::velocity(at.1)),
        }
    }

    /// The options for a pair. The velocity scale is found from the first grid that shows one, and
    /// holds for all of them; where none can be found, the last one holds.
    fn options(&mut self, pair: &Pair, names: &[String]) -> Result<BetweenOptions, String> {
        let per_number = match self.args.velocity_scale {
            Scale::Given(scale) => Some(scale),
            Scale::Auto if !matches!(self.args.method, Way::Fade) => {
                for name in names {
                    if let Some(scale) = self.fitted(pair, name)? {
                        self.found = Some(scale / pair.gap() as f64);
                        break;
                    }
                }
                self.found
            }
            Scale::Auto => None,
        };
        Ok(BetweenOptions {
            method: self.args.method.into(),
            // No scale fits: nothing moves along the velocities.
            velocity_scale: Some(per_number.unwrap_or(0.0) * pair.gap() as f64),
            limits: self.args.limits.limits(),
        })
    }

    fn fitted(&self, pair: &Pair, name: &str) -> Result<Option<f64>, String> {
        let [from, to] = self.grids(pair, name)?;
        let [a, b] = [self.velocity(pair.from)?, self.velocity(pair.to)?];
        fit_velocity_scale(Frame { grid: &from, velocity: a }, Frame { grid: &to, velocity: b })
            .map_err(|error| error.in_file(&pair.from.0.path).to_string())
    }

    /// A grid between two frames.
    fn make(
        &self,
        pair: &Pair,
        name: &str,
        t: f64,
        options: &BetweenOptions,
    ) -> Result<Grid, String> {
        let [from, to] = self.grids(pair, name)?;
        let [a, b] = [self.velocity(pair.from)?, self.velocity(pair.to)?];
        let frames = [Frame { grid: &from, velocity: a }, Frame { grid: &to, velocity: b }];
        in_between(frames[0], frames[1], t, options)
            .map_err(|error| error.in_file(&pair.from.0.path).to_string())
    }
}

fn lacks(frame: &Numbered, name: &str) -> String {
    format!("{}: the file has no grid {}", shown(&frame.path), quoted(name))
}
