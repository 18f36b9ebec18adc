//! The text of a `.vdbseq` file.

use ron::extensions::Extensions;
use ron::options::Options;
use serde::Deserialize;
use vdb_core::display::escaped;

use super::error::VdbSequenceError;
use super::frames::{DEFAULT_RATE, MOST_FRAMES, VdbRepeat, is_rate};
use super::pattern::Pattern;
use crate::VdbLoaderSettings;

/// The largest frame number.
const LAST_NUMBER: u64 = 999_999_999_999_999;

/// A `.vdbseq` file as written.
#[derive(Deserialize)]
// The name is in messages.
#[serde(rename = "VdbSequence", deny_unknown_fields)]
struct Written {
    frames: String,
    #[serde(default)]
    first: Option<u64>,
    #[serde(default)]
    last: Option<u64>,
    #[serde(default)]
    rate: Option<f32>,
    #[serde(default)]
    repeat: VdbRepeat,
    #[serde(default)]
    settings: Option<VdbLoaderSettings>,
}

/// The description of a sequence.
#[derive(Debug)]
pub(super) struct Description {
    /// The folder of the frames, relative to the file; may be empty.
    pub folder: String,
    pub pattern: Pattern,
    /// The first and the last frame; `None` to list the folder.
    pub range: Option<(u64, u64)>,
    pub rate: f32,
    pub repeat: VdbRepeat,
    pub settings: Option<VdbLoaderSettings>,
}

impl Description {
    pub fn parse(text: &str) -> Result<Self, VdbSequenceError> {
        let options = Options::default().with_default_extension(Extensions::IMPLICIT_SOME);
        let written: Written = options.from_str(text).map_err(|error| {
            let problem = escaped(&error.code.to_string()).to_string();
            let at = error.span.start;
            VdbSequenceError::Syntax { line: at.line, column: at.col, problem }
        })?;
        let at = |field: &'static str| {
            let line = line_of(text, field);
            move |problem| VdbSequenceError::Value { line, problem: Box::new(problem) }
        };
        let (folder, name) = written.frames.rsplit_once('/').unwrap_or(("", &written.frames));
        let pattern = Pattern::parse(name).map_err(at("frames"))?;
        let rate = written.rate.unwrap_or(DEFAULT_RATE);
        if !is_rate(rate) {
            return Err(at("rate")(VdbSequenceError::Rate(rate)));
        }
        let range = match (written.first, written.last) {
            (None, None) => None,
            (Some(first), Some(last)) => {
                Some(range(&written.frames, first, last).map_err(at("last"))?)
            }
            (Some(_), None) => return Err(at("first")(VdbSequenceError::HalfRange)),
            (None, Some(_)) => return Err(at("last")(VdbSequenceError::HalfRange)),
        };
        let (repeat, settings) = (written.repeat, written.settings);
        Ok(Self { folder: folder.to_owned(), pattern, range, rate, repeat, settings })
    }
}

/// The first and the last frame, if there are not too many.
fn range(frames: &str, first: u64, last: u64) -> Result<(u64, u64), VdbSequenceError> {
    if first > last {
        return Err(VdbSequenceError::Range(first, last));
    }
    if last > LAST_NUMBER {
        return Err(VdbSequenceError::Place(escaped(frames).to_string()));
    }
    let count = last - first + 1;
    if count > MOST_FRAMES {
        return Err(VdbSequenceError::TooMany(escaped(frames).to_string(), count));
    }
    Ok((first, last))
}

/// The line, from 1, on which a field is written.
fn line_of(text: &str, field: &str) -> usize {
    let is_there = |line: &str| {
        line.match_indices(field).any(|(at, _)| {
            let before = line[..at].chars().next_back();
            let after = line[at + field.len()..].trim_start();
            !before.is_some_and(|c| c.is_alphanumeric() || c == '_') && after.starts_with(':')
        })
    };
    1 + text.lines().position(is_there).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::VdbValues;

    #[test]
    fn a_description_has_defaults() {
        let own = Description::parse("(frames: \"fire_####.vdb\")").unwrap();
        assert_eq!((own.folder.as_str(), own.range, own.rate), ("", None, 24.0));
        assert_eq!((own.repeat, own.settings), (VdbRepeat::Loop, None));
        let text = "// Houdini\n(\n  frames: \"cache/fire.$F4.vdb\",\n  first: 1, last: 240,\n  \
                    rate: 30, repeat: PingPong,\n  settings: (values: Half, grids: [\"density\"]),\n)";
        let own = Description::parse(text).unwrap();
        assert_eq!((own.folder.as_str(), own.range, own.rate), ("cache", Some((1, 240)), 30.0));
        assert_eq!(own.pattern.name(7), "fire.0007.vdb");
        let settings = own.settings.unwrap();
        assert_eq!((own.repeat, settings.values), (VdbRepeat::PingPong, VdbValues::Half));
        assert_eq!(settings.grids, Some(vec!["density".to_owned()]));
    }

    #[test]
    fn each_mistake_has_its_line_and_a_remedy() {
        for (text, line, said) in [
            ("(\nframes: \"a_#.vdb\",\nfrist: 1,\n)", 3, "frist"),
            ("(\nframes: \"a_0001.vdb\",\n)", 2, "`#`"),
            ("(frames: \"a_#.vdb\",\nfirst: 9,\nlast: 1)", 3, "exchange"),
            ("(frames: \"a_#.vdb\",\nfirst: 0,\nlast: 100_000)", 3, "limit of 100000"),
            ("(frames: \"a_#.vdb\",\nfirst: 1, last: 18446744073709551615)", 2, "15 digits"),
            ("(frames: \"a_#.vdb\",\n\nlast: 5)", 3, "give both"),
            ("(frames: \"a_#.vdb\", first: 5)", 1, "give both"),
            ("(frames: \"a_#.vdb\",\nrate: 0)", 2, "1,000"),
            ("(frames: \"a_#.vdb\",\nrate: NaN)", 2, "1,000"),
            ("(frames: \"a_#.vdb\",\nrepeat: Forever)", 2, "Forever"),
            ("(frames: \"a_#.vdb\",\nfirst: -1, last: 5)", 2, "fire_####.vdb"),
            ("(first: 1, last: 5)", 1, "frames"),
            ("", 1, "fire_####.vdb"),
            ("\u{1b}[2J", 1, "fire_####.vdb"),
        ] {
            let problem = Description::parse(text).unwrap_err().to_string();
            assert!(problem.starts_with(&format!("line {line}")), "{text:?}: {problem}");
            assert!(problem.contains(said) && !problem.contains('\u{1b}'), "{text:?}: {problem}");
        }
    }
}
