//! The number of bytes of a file that its reader needs.

use super::cursor::Cursor;
use super::descriptor::SMALLEST;
use super::{header, list};
use crate::cooked::signature;
use crate::nanovdb::is_nanovdb;
use crate::{Error, Limits};

/// The part of a file that the reader needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Demand {
    /// Nothing more: the bytes present are all that the reader needs, or enough for it to report
    /// what is wrong.
    Nothing,
    /// The file up to this byte; ask again then.
    UpTo(u64),
    /// The whole file: in a stream, nothing says where grids end.
    All,
}

/// Follows a file from its header to its metadata and from grid to grid, through their offsets.
#[derive(Debug, Default)]
pub(crate) struct Follower {
    /// The offset up to which the file has been examined.
    at: u64,
    stage: Stage,
}

#[derive(Clone, Copy, Debug, Default)]
enum Stage {
    #[default]
    Magic,
    Header,
    MetadataCount,
    /// Metadata entries left to examine.
    Metadata(u32),
    GridCount,
    /// Grids left to examine.
    Grids(u32),
    Stream,
    /// A cooked file or a NanoVDB file, which is read as a whole.
    Whole,
}

impl Follower {
    /// Whether the file starts with the magic number of a VDB file, a NanoVDB file or a cooked one.
    pub(crate) fn is_known(&self) -> bool {
        !matches!(self.stage, Stage::Magic)
    }

    /// What the reader needs beyond `bytes`, the start of the file. `length` is the length of the
    /// file, if it is known.
    ///
    /// # Errors
    /// If a grid ends beyond the end of the file.
    pub(crate) fn demand(
        &mut self,
        bytes: &[u8],
        length: Option<u64>,
        limits: &Limits,
    ) -> Result<Demand, Error> {
        loop {
            match self.step(bytes, limits) {
                Ok(()) => {}
                Err(Demand::UpTo(end)) if length.is_some_and(|length| end > length) => {
                    let length = length.unwrap_or_default();
                    if let Stage::Grids(_) = self.stage
                        && self.at > length
                    {
                        return Err(Error::invalid(list::cut_short(self.at, length)));
                    }
                    // The reader reports what is missing.
                    return Ok(Demand::UpTo(length));
                }
                Err(demand) => return Ok(demand),
            }
        }
    }

    /// Advances by one stage; fails with what it lacks.
    fn step(&mut self, bytes: &[u8], limits: &Limits) -> Result<(), Demand> {
        let mut ahead = Ahead { bytes, at: self.at, limits };
        let next = match self.stage {
            Stage::Magic => match ahead.take()? {
                header::MAGIC => Stage::Header,
                signature::MAGIC => Stage::Whole,
                magic if is_nanovdb(&magic) => Stage::Whole,
                _ => return Err(Demand::Nothing),
            },
            Stage::Header => {
                if bytes.len() < header::LONGEST {
                    return Err(Demand::UpTo(header::LONGEST as u64));
                }
                let mut cursor = Cursor::new(bytes);
                let header = header::read(&mut cursor).map_err(|_| Demand::Nothing)?;
                ahead.at = cursor.at() as u64;
                if header.has_offsets { Stage::MetadataCount } else { Stage::Stream }
            }
            Stage::MetadataCount => Stage::Metadata(ahead.count(limits.metadata_entries)?),
            Stage::Metadata(0) => Stage::GridCount,
            Stage::Metadata(left) => {
                for _ in 0..3 {
                    ahead.sized()?;
                }
                Stage::Metadata(left - 1)
            }
            Stage::GridCount => {
                let count = ahead.count(limits.grids)?;
                // The reader checks that all grids can fit before it reads the first.
                ahead.need(u64::from(count) * SMALLEST as u64)?;
                Stage::Grids(count)
            }
            Stage::Grids(0) => {
                // All bytes up to the end of the last grid.
                ahead.need(0)?;
                return Err(Demand::Nothing);
            }
            Stage::Grids(left) => {
                ahead.need(SMALLEST as u64)?;
                for _ in 0..3 {
                    ahead.sized()?;
                }
                let [_, _, end] = [ahead.i64()?, ahead.i64()?, ahead.i64()?];
                let past = ahead.at;
                // The reader rejects offsets that go backwards.
                ahead.at =
                    u64::try_from(end).ok().filter(|end| *end >= past).ok_or(Demand::Nothing)?;
                Stage::Grids(left - 1)
            }
            Stage::Stream | Stage::Whole => return Err(Demand::All),
        };
        (self.at, self.stage) = (ahead.at, next);
        Ok(())
    }
}

/// A position in bytes of which only the start may be present.
struct Ahead<'a> {
    bytes: &'a [u8],
    at: u64,
    limits: &'a Limits,
}

impl Ahead<'_> {
    /// Demands `count` bytes from here on.
    fn need(&self, count: u64) -> Result<(), Demand> {
        match self.at.saturating_add(count) {
            end if end > self.bytes.len() as u64 => Err(Demand::UpTo(end)),
            _ => Ok(()),
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], Demand> {
        self.need(N as u64)?;
        let taken = self.bytes[self.at as usize..].first_chunk::<N>();
        self.at += N as u64;
        taken.copied().ok_or(Demand::Nothing)
    }

    fn u32(&mut self) -> Result<u32, Demand> {
        self.take().map(u32::from_le_bytes)
    }

    /// A count that must not exceed `most`.
    fn count(&mut self, most: u64) -> Result<u32, Demand> {
        let count = self.u32()?;
        if u64::from(count) <= most { Ok(count) } else { Err(Demand::Nothing) }
    }

    fn i64(&mut self) -> Result<i64, Demand> {
        self.take().map(i64::from_le_bytes)
    }

    /// Skips a length and that many bytes, whether or not they are present.
    fn sized(&mut self) -> Result<(), Demand> {
        let length = u64::from(self.u32()?);
        if length > self.limits.metadata_bytes {
            return Err(Demand::Nothing);
        }
        self.at += length;
        Ok(())
    }
}
