//! Text from files, made safe to show.
//!
//! Names, types and metadata are whatever a file says: escapes that a terminal obeys, line breaks that forge a
//! line of a log, marks that turn the direction of writing, megabytes. They are kept as they are, so that
//! a grid is found by its name and written back under it, and escaped where they are shown. What
//! implements `Display` here does so by itself: [`Error`](crate::Error), [`Place`](crate::Place),
//! [`MetaValue`](crate::MetaValue). Plain `String`s, such as [`Grid::name`](crate::Grid::name), go
//! through [`escaped`] or [`quoted`].

use std::fmt::{self, Display, Formatter, Write};

/// Characters of text from a file that are shown, unless [`Escaped::at_most`] says otherwise.
pub const SHOWN_CHARS: usize = 256;

/// Characters of an error's description that are shown: room for several names of [`SHOWN_CHARS`].
pub(crate) const ERROR_CHARS: usize = 4 * SHOWN_CHARS;

/// Letters that have no ink, and that Unicode counts as printable all the same: fillers of Hangul and
/// the blank of Braille.
const BLANK: [char; 5] = ['\u{115f}', '\u{1160}', '\u{3164}', '\u{ffa0}', '\u{2800}'];

/// Text in which nothing but plain, visible characters is left: see [`escaped`] and [`quoted`].
#[derive(Clone, Copy, Debug)]
pub struct Escaped<'a> {
    text: &'a str,
    quotes: bool,
    most: usize,
}

/// Text on one line: `\n`, `\u{1b}` and the like stand for control characters, changes of direction,
/// invisible and unassigned characters. Quotes and backslashes stay, so that it may be applied twice.
/// Beyond [`SHOWN_CHARS`] an ellipsis stands for the rest.
///
/// ```
/// use vdb_core::display::escaped;
///
/// assert_eq!(escaped("density").to_string(), "density");
/// assert_eq!(escaped("\u{1b}[31mred\n\u{202e}").to_string(), r"\u{1b}[31mred\n\u{202e}");
/// assert_eq!(escaped("smoke").at_most(3).to_string(), "smo…");
/// ```
pub fn escaped(text: &str) -> Escaped<'_> {
    Escaped { text, quotes: false, most: SHOWN_CHARS }
}

/// The same in double quotes; those within have a backslash, as in `{:?}`.
pub fn quoted(text: &str) -> Escaped<'_> {
    Escaped { quotes: true, ..escaped(text) }
}

impl Escaped<'_> {
    /// The same with so many characters of the text at most.
    #[must_use]
    pub fn at_most(self, chars: usize) -> Self {
        Self { most: chars, ..self }
    }
}

impl Display for Escaped<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let cut = self.text.char_indices().nth(self.most).map_or(self.text.len(), |(at, _)| at);
        let (shown, rest) = self.text.split_at(cut);
        let quote = if self.quotes { "\"" } else { "" };
        f.write_str(quote)?;
        // What `str::escape_debug` would escape and shall stay, or would leave and shall not.
        let apart = |c: char| "\"'\\".contains(c) || BLANK.contains(&c);
        for piece in shown.split_inclusive(apart) {
            let last = piece.chars().next_back().filter(|last| apart(*last));
            let plain = &piece[..piece.len() - last.map_or(0, char::len_utf8)];
            // As a whole, so that marks that combine with the letter before them stay.
            write!(f, "{}", plain.escape_debug())?;
            match last {
                Some(blank) if BLANK.contains(&blank) => write!(f, "{}", blank.escape_unicode())?,
                Some(mark) if self.quotes && mark != '\'' => write!(f, "\\{mark}")?,
                Some(mark) => f.write_char(mark)?,
                None => {}
            }
        }
        f.write_str(if rest.is_empty() { "" } else { "…" })?;
        f.write_str(quote)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_text_stays() {
        let texts =
            ["", "density", "Dichte für Rauch", "煙", "дым", "e\u{301}", "it's \"C:\\smoke\" 🔥"];
        for text in texts {
            assert_eq!(escaped(text).to_string(), text);
        }
        assert_eq!(quoted(r#"it's "C:\smoke""#).to_string(), r#""it's \"C:\\smoke\"""#);
    }

    #[test]
    fn what_harms_is_escaped() {
        let control = (0..0x20).chain(0x7f..0xa0);
        let invisible = [0xad, 0x61c, 0x180e, 0xfeff, 0x2028, 0x2029, 0xe0041]
            .into_iter()
            .chain(0x200b..=0x200f)
            .chain(0x202a..=0x202e)
            .chain(0x2060..=0x206f);
        let blank = BLANK.map(u32::from);
        for code in control.chain(invisible).chain(blank) {
            let Some(c) = char::from_u32(code) else { continue };
            let shown = escaped(&format!("a{c}b{c}")).to_string();
            assert!(!shown.contains(c) && shown.starts_with("a\\"), "U+{code:04x}: {shown}");
            // What has been escaped stays as it is.
            assert_eq!(escaped(&shown).to_string(), shown);
            assert!(!quoted(&format!("a{c}b")).to_string().contains(c));
        }
    }

    #[test]
    fn what_is_long_is_cut() {
        let long = "é".repeat(100_000);
        assert_eq!(escaped(&long).to_string(), "é".repeat(SHOWN_CHARS) + "…");
        assert_eq!(quoted(&long).at_most(2).to_string(), "\"éé…\"");
        assert_eq!(escaped("ab").at_most(2).to_string(), "ab");
    }
}
