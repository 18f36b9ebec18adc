//! Minimal SVG output for charts.

use std::fmt::Write as _;

/// The colour of text.
pub const INK: &str = "#1f2933";
/// The colour of lines in the background.
pub const PALE: &str = "#d9e0e7";

/// An SVG document being written. Positions are in pixels.
#[derive(Clone, Debug)]
pub struct Svg(String);

impl Svg {
    /// An empty drawing with a white background.
    pub fn new(width: f64, height: f64) -> Self {
        Self(format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" font-family="sans-serif" font-size="10" fill="{INK}">
<rect width="{width}" height="{height}" fill="#ffffff"/>
"##
        ))
    }

    /// Adds text with its `start`, `middle` or `end` at a position; `style` is additional
    /// attributes.
    pub fn text(&mut self, x: f64, y: f64, anchor: &str, style: &str, text: &str) {
        let text = text.replace('&', "&amp;").replace('<', "&lt;");
        let _ = writeln!(
            self.0,
            r#"<text x="{x:.1}" y="{y:.1}" text-anchor="{anchor}" {style}>{text}</text>"#
        );
    }

    /// Adds a line.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64), color: &str, width: f64) {
        let ((x1, y1), (x2, y2)) = (from, to);
        let _ = writeln!(
            self.0,
            r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" stroke="{color}" stroke-width="{width}"/>"#
        );
    }

    /// Adds a bar to the right of a position, vertically centred on it.
    pub fn bar(&mut self, x: f64, y: f64, (width, height): (f64, f64), color: &str) {
        let top = y - height / 2.0;
        let _ = writeln!(
            self.0,
            r#"<rect x="{x:.1}" y="{top:.1}" width="{width:.1}" height="{height:.1}" fill="{color}"/>"#
        );
    }

    /// Adds a dot.
    pub fn dot(&mut self, x: f64, y: f64, color: &str) {
        let _ = writeln!(self.0, r#"<circle cx="{x:.1}" cy="{y:.1}" r="3.2" fill="{color}"/>"#);
    }

    /// Returns the finished document.
    pub fn finish(self) -> String {
        self.0 + "</svg>\n"
    }
}
