//! Errors of packing.

use thiserror::Error;

use super::layout::PAYLOAD;

/// An error that prevents packing a grid.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PackError {
    /// The grid has more items than can be numbered.
    #[error(
        "the grid has {count} {what}, more than the {limit} that a GPU grid can address; \
         load it at a lower resolution or with a narrower band"
    )]
    TooLarge {
        /// The items of which there are too many.
        what: &'static str,
        /// The number of items.
        count: u64,
        /// The largest possible number.
        limit: u64,
    },
    /// Packing would take more memory than [`Limits`](crate::Limits) allow.
    #[error(
        "packing the grid takes {needed} bytes or more, which exceeds the limit of {limit} \
         (`Limits::{name}`); raise it if you trust the file"
    )]
    LimitExceeded {
        /// The field of [`Limits`](crate::Limits).
        name: &'static str,
        /// The bytes known to be needed so far.
        needed: u64,
        /// The bytes that packing this grid may take, less those of grids packed together with it.
        limit: u64,
    },
    /// The progress callback requested cancellation.
    #[error("packing was cancelled")]
    Cancelled,
}

pub(super) fn check(what: &'static str, count: u64) -> Result<(), PackError> {
    check_at_most(what, count, PAYLOAD.into())
}

pub(super) fn check_at_most(what: &'static str, count: u64, limit: u64) -> Result<(), PackError> {
    if count > limit { Err(PackError::TooLarge { what, count, limit }) } else { Ok(()) }
}
