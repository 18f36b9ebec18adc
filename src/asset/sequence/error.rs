//! Errors of sequences.

use thiserror::Error;

use super::frames::MOST_FRAMES;

/// Why a sequence could not be loaded. Bevy logs it.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum VdbSequenceError {
    /// A pattern has no placeholder for the frame number.
    #[error(
        "'{0}' has no placeholder for the frame number; write `#` for each of its digits, as in \
         `fire_####.vdb`"
    )]
    NoPlace(String),
    /// A pattern has several placeholders for the frame number.
    #[error(
        "'{0}' has more than one placeholder for the frame number; keep the one in the file name \
         that counts frames"
    )]
    SeveralPlaces(String),
    /// The placeholder is in the name of a folder, or its width is out of range.
    #[error(
        "'{0}' cannot be used as a pattern: the frame number must be in the file name, and have at \
         most 15 digits"
    )]
    Place(String),
    /// The path begins with an asset source that the app does not have, or is empty.
    #[error("the sequence '{0}' leads to no folder: {1}")]
    Path(String, String),
    /// The folder could not be listed.
    #[error(
        "the folder '{0}' of the sequence cannot be listed: {1}; check the path, or give the \
         first and the last frame in a .vdbseq file if its source cannot list folders"
    )]
    Folder(String, String),
    /// No file of the folder is a frame.
    #[error(
        "the folder '{0}' has no frame of the sequence '{1}'; frames have a number in their name \
         and one of the extensions {2}"
    )]
    NoFrames(String, String, String),
    /// There are more frames than a sequence can have.
    #[error("the sequence '{0}' has {1} frames or more, which exceeds the limit of {MOST_FRAMES}")]
    TooMany(String, u64),
    /// The first frame is after the last one.
    #[error("the first frame, {0}, is after the last one, {1}; exchange them")]
    Range(u64, u64),
    /// Only one end of the range is given.
    #[error(
        "the sequence has only one of `first` and `last`; give both, or neither to list the folder"
    )]
    HalfRange,
    /// The rate is out of range.
    #[error("rate is {0}; it must be more than 0 and at most 1,000 frames per second")]
    Rate(f32),
    /// The file is too large to be a description of a sequence.
    #[error("a .vdbseq file has at most {0} bytes; this one is something else")]
    Size(usize),
    /// The file is not UTF-8 text.
    #[error("a .vdbseq file is text in UTF-8; this one is something else")]
    Text,
    /// The file could not be read.
    #[error("reading the description of the sequence failed: {0}")]
    Read(String),
    /// The file does not describe a sequence.
    #[error(
        "line {line}, column {column}: {problem}; a sequence is described as in `(frames: \
         \"fire_####.vdb\", first: 1, last: 240, rate: 24.0, repeat: Loop)`"
    )]
    Syntax {
        /// The line, from 1.
        line: usize,
        /// The column, from 1.
        column: usize,
        /// The parser's message.
        problem: String,
    },
    /// A value in the file is out of range.
    #[error("line {line}: {problem}")]
    Value {
        /// The line, from 1.
        line: usize,
        /// The problem with the value.
        problem: Box<VdbSequenceError>,
    },
}
