//! Standard output and standard error, either of which may be closed or full.

use std::io::{self, ErrorKind, Write};
use std::ops::ControlFlow;
use std::process::ExitCode;

use vdb_core::display::escaped;

/// The most characters of one line on standard error.
const LINE_CHARS: usize = 16 << 10;

/// Writes text to standard output. If no more can be written, breaks with an exit code: `code` if
/// the reader has closed the pipe, as `head` does after some lines; otherwise a failure, which is
/// reported.
pub fn print(text: &str, code: ExitCode) -> ControlFlow<ExitCode> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Ok(()) => ControlFlow::Continue(()),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => ControlFlow::Break(code),
        Err(error) => {
            complain(&format!("cannot write the output: {error}"));
            ControlFlow::Break(ExitCode::FAILURE)
        }
    }
}

/// Writes one line to standard error, escaped.
pub fn complain(line: &str) {
    let _ = writeln!(io::stderr(), "{}", escaped(line).at_most(LINE_CHARS));
}

/// A number of bytes for people.
pub fn bytes(count: u64) -> String {
    match count {
        0..10_000 => format!("{count} bytes"),
        10_000..10_000_000 => format!("{:.1} kB", count as f64 / 1e3),
        _ => format!("{:.1} MB", count as f64 / 1e6),
    }
}

/// Prints a summary, or the reason why there is none, and returns the exit code.
pub fn finish(made: Result<String, String>) -> ExitCode {
    match made {
        Ok(summary) => {
            let code = ExitCode::SUCCESS;
            print(&summary, code).break_value().unwrap_or(code)
        }
        Err(error) => {
            complain(&error);
            ExitCode::FAILURE
        }
    }
}
