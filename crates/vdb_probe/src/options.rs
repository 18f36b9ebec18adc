//! Command lines of the benchmark programs: options with one value each, and positional arguments.

use std::fmt::Display;
use std::ops::RangeBounds;
use std::process::ExitCode;
use std::str::FromStr;

use glam::UVec2;

/// The reason why a program does not run.
#[derive(Debug, PartialEq, Eq)]
pub enum Stop {
    /// There is nothing to do but print this text, such as the help.
    Told(String),
    /// The command line is wrong, with a message.
    Wrong(String),
}

impl From<String> for Stop {
    fn from(message: String) -> Self {
        Self::Wrong(message)
    }
}

/// Parses a command line.
pub struct Options {
    help: &'static str,
    words: std::vec::IntoIter<String>,
    option: String,
}

impl Options {
    /// The command line of this program.
    pub fn of_program(help: &'static str) -> Self {
        // `cargo bench` adds an option.
        Self::new(help, std::env::args().skip(1).filter(|word| word != "--bench").collect())
    }

    fn new(help: &'static str, words: Vec<String>) -> Self {
        Self { help, words: words.into_iter(), option: String::new() }
    }

    /// The next option, including its `--`, or the next positional argument. After an option, get
    /// its value with [`value`](Self::value) or [`list`](Self::list). Stops with the help text at
    /// `--help`.
    pub fn next_word(&mut self) -> Result<Option<String>, Stop> {
        let Some(word) = self.words.next() else { return Ok(None) };
        if word == "--help" {
            return Err(Stop::Told(self.help.into()));
        }
        self.option.clone_from(&word);
        Ok(Some(word))
    }

    fn text(&mut self) -> Result<String, Stop> {
        let value = self.words.next();
        Ok(value.ok_or_else(|| format!("{} needs a value; see --help", self.option))?)
    }

    /// The value of the current option.
    pub fn value<T>(&mut self, parse: impl Fn(&str) -> Option<T>) -> Result<T, Stop> {
        let text = self.text()?;
        Ok(parse(&text).ok_or_else(|| self.not_understood(&text))?)
    }

    /// The comma-separated values of the current option.
    pub fn list<T>(&mut self, parse: impl Fn(&str) -> Option<T>) -> Result<Vec<T>, Stop> {
        let text = self.text()?;
        let items =
            text.split(',').map(|part| parse(part).ok_or_else(|| self.not_understood(part)));
        Ok(items.collect::<Result<_, _>>()?)
    }

    fn not_understood(&self, value: &str) -> String {
        format!("{} {value}: not understood; see --help", self.option)
    }

    /// The error for an unknown option or argument.
    pub fn unknown(&self) -> Stop {
        Stop::Wrong(format!("{}: no such option; see --help", self.option))
    }
}

/// Parses a number within bounds.
pub fn number<T: FromStr + PartialOrd>(range: impl RangeBounds<T>) -> impl Fn(&str) -> Option<T> {
    move |text| text.parse().ok().filter(|number| range.contains(number))
}

/// Parses an image size, such as 1920x1080, with edges within bounds.
pub fn size(range: impl RangeBounds<u32>) -> impl Fn(&str) -> Option<UVec2> {
    let edge = number(range);
    move |text| {
        let (x, y) = text.split_once('x')?;
        Some(UVec2::new(edge(x)?, edge(y)?))
    }
}

/// Runs a program with its arguments, and reports errors.
pub fn run<A, E: Display>(
    name: &str,
    args: Result<A, Stop>,
    run: impl FnOnce(&A) -> Result<(), E>,
) -> ExitCode {
    let (code, message) = match args.map(|args| run(&args)) {
        Ok(Ok(())) => return ExitCode::SUCCESS,
        Ok(Err(error)) => (ExitCode::FAILURE, error.to_string()),
        Err(Stop::Wrong(message)) => (ExitCode::from(2), message),
        Err(Stop::Told(text)) => {
            println!("{}", text.trim_end());
            return ExitCode::SUCCESS;
        }
    };
    eprintln!("{name}: {message}");
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(words: &[&str]) -> Options {
        Options::new("the help", words.iter().map(|word| word.to_string()).collect())
    }

    #[test]
    fn options_have_values_and_words_none() {
        let mut all = options(&["a.vdb", "--size", "16x9", "--runs", "3,40", "--then"]);
        assert_eq!(all.next_word(), Ok(Some("a.vdb".into())));
        assert_eq!(all.next_word(), Ok(Some("--size".into())));
        assert_eq!(all.value(size(1..100)), Ok(UVec2::new(16, 9)));
        assert_eq!(all.next_word(), Ok(Some("--runs".into())));
        assert_eq!(all.list(number(3_u32..)), Ok(vec![3, 40]));
        assert_eq!(all.next_word(), Ok(Some("--then".into())));
        assert_eq!(all.next_word(), Ok(None));
    }

    #[test]
    fn what_is_wrong_is_told_with_its_option() {
        let wrong = |value: &str, range: std::ops::Range<u32>| {
            let mut all = options(&["--runs", value]);
            all.next_word().unwrap();
            all.list(number(range)).unwrap_err()
        };
        let told = |value: &str| Stop::Wrong(format!("--runs {value}: not understood; see --help"));
        assert_eq!(wrong("2,many", 0..9), told("many"));
        assert_eq!(wrong("9", 0..9), told("9"));
        let mut all = options(&["--runs"]);
        all.next_word().unwrap();
        let missing = Stop::Wrong("--runs needs a value; see --help".into());
        assert_eq!(all.value(number(0_u32..)), Err(missing));
        assert_eq!(all.unknown(), Stop::Wrong("--runs: no such option; see --help".into()));
    }

    #[test]
    fn help_stops_the_program() {
        assert_eq!(options(&["--help"]).next_word(), Err(Stop::Told("the help".into())));
    }

    #[test]
    fn sizes_are_within_bounds() {
        for wrong in ["16", "16x", "x9", "16x101", "0x9", "16x9x4", "-1x9", "1e1x9"] {
            assert_eq!(size(1..=100)(wrong), None, "{wrong}");
        }
        // NaN is within no bounds.
        assert_eq!(number(0.5..)("nan"), None);
    }
}
