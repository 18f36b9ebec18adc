//! Why a grid cannot be packed.

use thiserror::Error;

use super::layout::PAYLOAD;

/// Why a grid could not be packed.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PackError {
    /// More of something than can be numbered.
    #[error(
        "the grid has {count} {what}, more than the {limit} that a GPU grid can address; \
         load it at a lower resolution or with a narrower band"
    )]
    TooLarge {
        /// What there is too much of.
        what: &'static str,
        /// How much there is.
        count: u64,
        /// How much there may be.
        limit: u64,
    },
    /// More memory than [`Limits`](crate::Limits) allow.
    #[error(
        "packing the grid takes {needed} bytes or more, which exceeds the limit of {limit} \
         (`Limits::{name}`); raise it if the file is to be trusted"
    )]
    LimitExceeded {
        /// The field of [`Limits`](crate::Limits).
        name: &'static str,
        /// The bytes that were known to be needed.
        needed: u64,
        /// The bytes that packing this grid may take, less those of grids packed together with it.
        limit: u64,
    },
    /// The progress function cancelled it.
    #[error("packing was cancelled")]
    Cancelled,
}

pub(super) fn check(what: &'static str, count: u64) -> Result<(), PackError> {
    check_at_most(what, count, PAYLOAD.into())
}

pub(super) fn check_at_most(what: &'static str, count: u64, limit: u64) -> Result<(), PackError> {
    if count > limit { Err(PackError::TooLarge { what, count, limit }) } else { Ok(()) }
}
