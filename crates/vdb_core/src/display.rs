//! Safe display of text from files.
//!
//! Names, types and metadata in a file can contain anything: terminal escape sequences, line breaks that
//! forge log entries, characters that reverse the writing direction, or megabytes of text. They are stored
//! unchanged, so that a grid can be looked up by its name and written back under it, and are escaped only
//! for display. The `Display` implementations of [`Error`](crate::Error), [`Place`](crate::Place) and
//! [`MetaValue`](crate::MetaValue) already do this; pass plain `String`s, such as
//! [`Grid::name`](crate::Grid::name), through [`escaped`] or [`quoted`].

use std::fmt::{self, Display, Formatter, Write};

/// The most characters of text from a file to show, unless [`Escaped::at_most`] sets another limit.
pub const SHOWN_CHARS: usize = 256;

/// The most characters of an error's description to show: room for several names of [`SHOWN_CHARS`].
pub(crate) const ERROR_CHARS: usize = 4 * SHOWN_CHARS;

/// Invisible characters that Unicode nevertheless classes as printable: the Hangul fillers and the
/// Braille blank.
const BLANK: [char; 5] = ['\u{115f}', '\u{1160}', '\u{3164}', '\u{ffa0}', '\u{2800}'];

/// Text that displays with plain, visible characters only; made by [`escaped`] and [`quoted`].
#[derive(Clone, Copy, Debug)]
pub struct Escaped<'a> {
    text: &'a str,
    quotes: bool,
    most: usize,
}

/// Escapes text so that it displays on one line.
///
/// Control characters, direction changes, and invisible or unassigned characters become escapes such as
/// `\n` and `\u{1b}`. Quotes and backslashes are left alone, so that escaping twice changes nothing more.
/// Text longer than [`SHOWN_CHARS`] ends in an ellipsis.
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

/// Escapes text as [`escaped`] does and puts it in double quotes. Double quotes and backslashes within it
/// get a backslash, as in `{:?}`.
pub fn quoted(text: &str) -> Escaped<'_> {
    Escaped { quotes: true, ..escaped(text) }
}

impl Escaped<'_> {
    /// Limits the display to the first `chars` characters of the text.
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
        // Quotes, backslashes and blanks, which `str::escape_debug` would treat differently.
        let apart = |c: char| "\"'\\".contains(c) || BLANK.contains(&c);
        for piece in shown.split_inclusive(apart) {
            let last = piece.chars().next_back().filter(|last| apart(*last));
            let plain = &piece[..piece.len() - last.map_or(0, char::len_utf8)];
            // Escapes the piece as a whole, so that a combining mark stays with the letter before
            // it.
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
            // Escaping is idempotent.
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
