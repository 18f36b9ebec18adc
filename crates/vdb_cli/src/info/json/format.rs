//! JSON in the format of OpenVDB's statistics in the test corpus: one grid per line, numbers as by
//! C's `%.17g`, and each byte of text that is not printable ASCII as a separate escape.

use std::io::{self, Write};

use serde_json::ser::{CharEscape, Formatter};

/// Depth of the array of grids within the object of a file.
const GRIDS: usize = 1;

#[derive(Default)]
pub struct Format {
    /// The number of open arrays and objects.
    depth: usize,
}

impl Formatter for Format {
    fn write_f64<W: ?Sized + Write>(&mut self, out: &mut W, value: f64) -> io::Result<()> {
        out.write_all(real(value).as_bytes())
    }

    fn write_string_fragment<W: ?Sized + Write>(
        &mut self,
        out: &mut W,
        text: &str,
    ) -> io::Result<()> {
        for byte in text.bytes() {
            match byte {
                b' '..=b'~' => out.write_all(&[byte])?,
                _ => write!(out, "\\u{byte:04x}")?,
            }
        }
        Ok(())
    }

    fn write_char_escape<W: ?Sized + Write>(
        &mut self,
        out: &mut W,
        escape: CharEscape,
    ) -> io::Result<()> {
        match escape {
            CharEscape::Quote => out.write_all(b"\\\""),
            CharEscape::ReverseSolidus => out.write_all(b"\\\\"),
            CharEscape::Solidus => out.write_all(b"/"),
            CharEscape::Backspace => out.write_all(b"\\u0008"),
            CharEscape::Tab => out.write_all(b"\\u0009"),
            CharEscape::LineFeed => out.write_all(b"\\u000a"),
            CharEscape::FormFeed => out.write_all(b"\\u000c"),
            CharEscape::CarriageReturn => out.write_all(b"\\u000d"),
            CharEscape::AsciiControl(byte) => write!(out, "\\u{byte:04x}"),
        }
    }

    fn begin_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        let lines = if self.depth == GRIDS { "[\n" } else { "[" };
        self.depth += 1;
        out.write_all(lines.as_bytes())
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, out: &mut W, first: bool) -> io::Result<()> {
        match (first, self.depth == GRIDS + 1) {
            (true, _) => Ok(()),
            (false, true) => out.write_all(b",\n"),
            (false, false) => out.write_all(b","),
        }
    }

    fn end_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.depth -= 1;
        out.write_all(if self.depth == GRIDS { b"\n]" } else { b"]" })
    }

    fn begin_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.depth += 1;
        out.write_all(b"{")
    }

    fn end_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.depth -= 1;
        out.write_all(b"}")
    }
}

/// A finite number with up to 17 significant digits, as C's `%.17g` prints it.
fn real(value: f64) -> String {
    let scientific = format!("{value:.16e}");
    let (digits, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let trimmed = |digits: &str| match digits.contains('.') {
        true => digits.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => digits.to_owned(),
    };
    if (-4..17).contains(&exponent) {
        let decimals = (16 - exponent).max(0) as usize;
        return trimmed(&format!("{value:.decimals$}"));
    }
    let sign = if exponent < 0 { '-' } else { '+' };
    format!("{}e{sign}{:02}", trimmed(digits), exponent.abs())
}
