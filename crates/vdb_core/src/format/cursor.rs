//! Sequential reading from a byte slice.

use crate::{Error, Limits};

/// A position in the bytes of a file. All numbers are little-endian.
#[derive(Clone, Copy)]
pub(crate) struct Cursor<'a> {
    /// The file, from its byte `first` to the end of what this cursor may read.
    bytes: &'a [u8],
    first: usize,
    /// An index of `bytes`, never past their end.
    next: usize,
}

impl<'a> Cursor<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self::within(bytes, 0)
    }

    /// A cursor at the start of a part of a file, which begins with the file's byte `first`.
    pub(crate) fn within(bytes: &'a [u8], first: usize) -> Self {
        Self { bytes, first, next: 0 }
    }

    /// Bytes from the start of the file.
    pub(crate) fn at(&self) -> usize {
        self.first + self.next
    }

    pub(crate) fn remaining(&self) -> usize {
        self.bytes.len() - self.next
    }

    /// A cursor at another position in the same bytes, which must not be past their end.
    pub(crate) fn moved_to(&self, at: usize) -> Result<Self, Error> {
        match at.checked_sub(self.first) {
            Some(next) if next <= self.bytes.len() => Ok(Self { next, ..*self }),
            _ => {
                let what = format!("an offset past the end of the data at byte {}", self.end());
                Err(Error::invalid(what).at(at))
            }
        }
    }

    /// The end of the bytes, counted from the start of the file.
    pub(crate) fn end(&self) -> usize {
        self.first + self.bytes.len()
    }

    /// A cursor at the start of the same bytes that cannot read beyond `end`.
    pub(crate) fn bounded(&self, end: usize) -> Self {
        let length = end.saturating_sub(self.first).min(self.bytes.len());
        Self::within(&self.bytes[..length], self.first)
    }

    pub(crate) fn take(&mut self, length: usize) -> Result<&'a [u8], Error> {
        let Some(taken) = self.bytes[self.next..].get(..length) else {
            let there = self.remaining();
            let what = format!("{length} bytes are needed, but only {there} are left");
            return Err(Error::invalid(what).at(self.at()));
        };
        self.next += length;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let taken = self.take(N)?;
        // Cannot fail, since `take` returns exactly the bytes requested.
        taken.try_into().map_err(|_| Error::invalid("a value is cut short").at(self.at()))
    }

    pub(crate) fn u8(&mut self) -> Result<u8, Error> {
        Ok(self.array::<1>()?[0])
    }

    pub(crate) fn u32(&mut self) -> Result<u32, Error> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub(crate) fn i32(&mut self) -> Result<i32, Error> {
        Ok(i32::from_le_bytes(self.array()?))
    }

    pub(crate) fn i64(&mut self) -> Result<i64, Error> {
        Ok(i64::from_le_bytes(self.array()?))
    }

    pub(crate) fn f64(&mut self) -> Result<f64, Error> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    pub(crate) fn ivec3(&mut self) -> Result<glam::IVec3, Error> {
        Ok(glam::IVec3::new(self.i32()?, self.i32()?, self.i32()?))
    }

    pub(crate) fn dvec3(&mut self) -> Result<glam::DVec3, Error> {
        Ok(glam::DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    /// A length (u32) and that many bytes.
    pub(crate) fn sized_bytes(&mut self, limits: &Limits) -> Result<&'a [u8], Error> {
        let at = self.at();
        let length = self.u32()?;
        if u64::from(length) > limits.metadata_bytes {
            let what = format!("{length} bytes of one string or metadata value");
            return Err(Error::limit(what, "metadata_bytes", limits.metadata_bytes).at(at));
        }
        self.take(length as usize)
    }

    /// A length (u32) and that many bytes of text. Invalid UTF-8 becomes U+FFFD.
    pub(crate) fn string(&mut self, limits: &Limits) -> Result<String, Error> {
        Ok(String::from_utf8_lossy(self.sized_bytes(limits)?).into_owned())
    }
}
