//! The resources a file demands, checked against its limits.

use crate::{Error, Limits};

/// Running totals of what a file has demanded so far.
#[derive(Clone)]
pub(crate) struct Budget<'a> {
    pub(crate) limits: &'a Limits,
    nodes: u64,
    voxels: u64,
    bytes: u64,
    entries: u64,
    text: u64,
}

impl<'a> Budget<'a> {
    pub(crate) fn new(limits: &'a Limits) -> Self {
        Self { limits, nodes: 0, voxels: 0, bytes: 0, entries: 0, text: 0 }
    }

    /// Adds the entries of one metadata map.
    pub(crate) fn add_entries(&mut self, count: u32) -> Result<(), Error> {
        self.entries += u64::from(count);
        let limit = self.limits.metadata_entries;
        if self.entries > limit {
            let what = format!("{} metadata entries", self.entries);
            return Err(Error::limit(what, "metadata_entries", limit));
        }
        Ok(())
    }

    /// Adds bytes of names, types or metadata values.
    pub(crate) fn add_text(&mut self, bytes: usize) -> Result<(), Error> {
        self.text = self.text.saturating_add(bytes as u64);
        let limit = self.limits.metadata_bytes;
        if self.text > limit {
            let what = format!("{} bytes of names and metadata", self.text);
            return Err(Error::limit(what, "metadata_bytes", limit));
        }
        Ok(())
    }

    /// Checks that `bytes` more can be taken beside all trees, for as long as a grid is read.
    pub(crate) fn check_more(&self, bytes: usize) -> Result<(), Error> {
        let (sum, limit) = (self.bytes.saturating_add(bytes as u64), self.limits.tree_bytes);
        if sum > limit {
            let what = format!("{sum} bytes of memory for trees and an unpacked grid");
            return Err(Error::limit(what, "tree_bytes", limit));
        }
        Ok(())
    }

    /// Adds the memory of points, which count together with trees.
    pub(crate) fn add_points(&mut self, points: u64, bytes: u64) -> Result<(), Error> {
        self.bytes = self.bytes.saturating_add(bytes);
        let (sum, limit) = (self.bytes, self.limits.tree_bytes);
        if sum > limit {
            let what = format!("{sum} bytes of memory for trees and {points} points");
            return Err(Error::limit(what, "tree_bytes", limit));
        }
        Ok(())
    }

    /// Adds `count` nodes of `bytes` bytes and `voxels` voxels each.
    pub(crate) fn add(&mut self, count: usize, bytes: usize, voxels: usize) -> Result<(), Error> {
        let add = |sum: &mut u64, each: usize| {
            *sum = sum.saturating_add((count as u64).saturating_mul(each as u64));
            *sum
        };
        let limits = self.limits;
        for (sum, limit, name) in [
            (add(&mut self.nodes, 1), limits.nodes, "nodes"),
            (add(&mut self.voxels, voxels), limits.voxels, "voxels"),
            (add(&mut self.bytes, bytes), limits.tree_bytes, "tree_bytes"),
        ] {
            if sum > limit {
                let unit = if name == "tree_bytes" { "bytes of memory for trees" } else { name };
                return Err(Error::limit(format!("{sum} {unit}"), name, limit));
            }
        }
        Ok(())
    }
}
