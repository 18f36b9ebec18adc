//! Names of frames: patterns with a placeholder for the number, and the series in a folder.

use std::collections::BTreeMap;
use std::path::Path;

use vdb_core::display::escaped;

use super::error::VdbSequenceError;

/// The largest number of digits, so that frame numbers and times are exact in f64.
const MOST_DIGITS: usize = 15;

/// The extensions of frame files, for folders without a pattern.
pub(super) const EXTENSIONS: &[&str] = &["vdb", "nvdb", COOKED];

/// The extension of cooked files.
const COOKED: &str = vdb_core::cooked::EXTENSION;

/// The name of a file with a placeholder for the frame number: `fire_####.vdb`, `fire_%04d.vdb` or
/// Houdini's `fire.$F4.vdb`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pattern {
    before: String,
    /// The minimum number of digits, padded with zeros.
    digits: usize,
    after: String,
}

impl Pattern {
    pub fn parse(name: &str) -> Result<Self, VdbSequenceError> {
        let shown = || escaped(name).to_string();
        let mut places = places(name).into_iter();
        let Some((start, end, digits)) = places.next() else {
            return Err(VdbSequenceError::NoPlace(shown()));
        };
        if places.next().is_some() {
            return Err(VdbSequenceError::SeveralPlaces(shown()));
        }
        if digits > MOST_DIGITS {
            return Err(VdbSequenceError::Place(shown()));
        }
        let (before, after) = (name[..start].to_owned(), name[end..].to_owned());
        Ok(Self { before, digits, after })
    }

    /// The pattern with `#` for each digit, for messages.
    pub fn shown(&self) -> String {
        format!("{}{}{}", self.before, "#".repeat(self.digits), self.after)
    }

    /// The name of a frame.
    pub fn name(&self, number: u64) -> String {
        format!("{}{number:0width$}{}", self.before, self.after, width = self.digits)
    }

    /// The number of the frame with a name; `None` if the name does not match the pattern.
    pub fn number(&self, name: &str) -> Option<u64> {
        let digits = name.strip_prefix(&*self.before)?.strip_suffix(&*self.after)?;
        number(digits).filter(|number| self.name(*number) == name)
    }
}

/// Whether a name has the extension of a frame.
pub(super) fn is_frame(name: &str) -> bool {
    name.rsplit_once('.').is_some_and(|(_, extension)| EXTENSIONS.contains(&extension))
}

/// Whether a name has a placeholder for the frame number.
pub(super) fn has_place(name: &str) -> bool {
    !places(name).is_empty()
}

/// The placeholders for the number in a name, each with its start, its end and its number of digits.
fn places(name: &str) -> Vec<(usize, usize, usize)> {
    let (mut places, mut at) = (Vec::new(), 0);
    while let Some(rest) = name.get(at..).filter(|rest| !rest.is_empty()) {
        match place(rest) {
            Some((length, digits)) => {
                places.push((at, at + length, digits));
                at += length;
            }
            None => at += rest.chars().next().map_or(1, char::len_utf8),
        }
    }
    places
}

/// The length of a placeholder at the start of a text, and its number of digits.
fn place(text: &str) -> Option<(usize, usize)> {
    let leading = |text: &str, is: fn(char) -> bool| text.chars().take_while(|c| is(*c)).count();
    // A width without digits is 1, and one with too many is refused as too wide.
    let width =
        |digits: &str| if digits.is_empty() { 1 } else { digits.parse().unwrap_or(usize::MAX) };
    let hashes = leading(text, |c| c == '#');
    if hashes > 0 {
        return Some((hashes, hashes));
    }
    if let Some(rest) = text.strip_prefix("$F") {
        let count = leading(rest, |c| c.is_ascii_digit());
        return Some((2 + count, width(&rest[..count]).max(1)));
    }
    let rest = text.strip_prefix('%')?;
    let count = leading(rest, |c| c.is_ascii_digit());
    let is_number = rest[count..].starts_with('d') && (count == 0 || rest.starts_with('0'));
    is_number.then(|| (2 + count, width(&rest[..count]).max(1)))
}

/// A number from its digits.
fn number(digits: &str) -> Option<u64> {
    let is_number = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    let significant = digits.trim_start_matches('0').len();
    if is_number && significant <= MOST_DIGITS { digits.parse().ok() } else { None }
}

/// Files of a folder that belong together: their names differ only in their last number.
#[derive(Debug, PartialEq)]
pub(super) struct Series {
    /// The name with `#` for the number.
    pub shown: String,
    /// The frames, by number and name.
    pub frames: Vec<(u64, String)>,
}

/// The series among file names, the longest first; of equally long ones, those of cooked files come
/// first, and then they are sorted by name.
pub(super) fn series(names: impl IntoIterator<Item = String>) -> Vec<Series> {
    let mut all: BTreeMap<(String, String), Vec<(u64, String)>> = BTreeMap::new();
    for name in names {
        // Digits in the extension are no number of a frame.
        let stem = name.rfind('.').unwrap_or(name.len());
        let Some(end) = name[..stem].rfind(|c: char| c.is_ascii_digit()) else { continue };
        let (head, after) = (&name[..=end], &name[end + 1..]);
        let start = head.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        let Some(number) = number(&head[start..]) else { continue };
        all.entry((head[..start].to_owned(), after.to_owned())).or_default().push((number, name));
    }
    let mut series: Vec<_> = all
        .into_iter()
        .map(|((before, after), mut frames)| {
            frames.sort();
            Series { shown: format!("{before}#{after}"), frames }
        })
        .collect();
    series.sort_by_key(|series| {
        let is_cooked = Path::new(&series.shown).extension().is_some_and(|own| own == COOKED);
        std::cmp::Reverse((series.frames.len(), is_cooked))
    });
    series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_notations_of_programs_are_patterns() {
        for (pattern, number, name) in [
            ("fire_####.vdb", 7, "fire_0007.vdb"),
            ("fire_####.vdb", 12_345, "fire_12345.vdb"),
            ("fire_%04d.vdb", 7, "fire_0007.vdb"),
            ("fire_%d.vdb", 70, "fire_70.vdb"),
            ("fire.$F4.vdb", 7, "fire.0007.vdb"),
            ("fire.$F.vdb", 7, "fire.7.vdb"),
            ("#", 0, "0"),
            ("Rauch für_##.vdb", 3, "Rauch für_03.vdb"),
            ("100%_###.vdb", 3, "100%_003.vdb"),
        ] {
            let parsed = Pattern::parse(pattern).unwrap();
            assert_eq!(parsed.name(number), name);
            assert_eq!(parsed.number(name), Some(number), "{pattern}");
        }
    }

    #[test]
    fn only_frames_of_a_pattern_match_it() {
        let pattern = Pattern::parse("fire_####.vdb").unwrap();
        for other in [
            "fire_007.vdb",
            "fire_00007.vdb",
            "fire_0007.vdb.bak",
            "smoke_0007.vdb",
            "fire_.vdb",
            "fire_-001.vdb",
            "fire_00a7.vdb",
            "fire_9999999999999999.vdb",
            "fire_.",
            "",
        ] {
            assert_eq!(pattern.number(other), None, "{other}");
        }
        // What is before the number and what is after it do not share letters.
        assert_eq!(Pattern::parse("aa#aa").unwrap().number("aaa"), None);
    }

    #[test]
    fn patterns_without_one_place_are_errors() {
        let problem = |name: &str| Pattern::parse(name).unwrap_err().to_string();
        assert!(problem("fire_0001.vdb").contains("`fire_####.vdb`"));
        assert!(problem("fire_%4x.vdb").contains("no placeholder"));
        assert!(problem("take_$F2_####.vdb").contains("more than one placeholder"));
        let digits = "at most 15 digits";
        assert!(problem(&"#".repeat(16)).contains(digits));
        assert!(problem("fire_$F99999999999999999999999.vdb").contains(digits));
        // A name cannot break a line of the log.
        for name in ["a\nb.vdb", "a#\nb#.vdb", "\n$F16.vdb"] {
            assert!(!problem(name).contains('\n'), "{}", problem(name));
        }
        assert!(has_place("a%d") && !has_place("a%s$E"));
    }

    #[test]
    fn the_longest_series_comes_first() {
        let names = [
            "smoke_v2.0001.vdb",
            "smoke_v2.0002.vdb",
            "fire_10.vdb",
            "fire_9.vdb",
            "fire_8.vdb",
            "readme.vdb",
            "1",
            "x99999999999999999999.vdb",
        ];
        let all = series(names.map(String::from));
        let shown: Vec<_> = all.iter().map(|series| series.shown.as_str()).collect();
        assert_eq!(shown, ["fire_#.vdb", "smoke_v2.#.vdb", "#"]);
        let numbers: Vec<_> = all[0].frames.iter().map(|(number, _)| *number).collect();
        assert_eq!(numbers, [8, 9, 10]);
        assert_eq!(all[1].frames[0], (1, "smoke_v2.0001.vdb".into()));
        let both = ["a1.vdb", "a1.vdbc", "a2.vdb", "a2.vdbc", "b1.vdb", "b2.vdb"];
        let all = series(both.map(String::from));
        let shown: Vec<_> = all.iter().map(|series| series.shown.as_str()).collect();
        assert_eq!(shown, ["a#.vdbc", "a#.vdb", "b#.vdb"]);
        // A number is a number in the name, not in the extension.
        assert_eq!(series(["a1.v2".to_owned()])[0].shown, "a#.v2");
    }
}
