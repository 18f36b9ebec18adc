//! The `.vdb` format, one file per part.

use crate::{Error, ReadOptions, VdbFile};

pub(crate) fn read_file(_: &[u8], _: &ReadOptions) -> Result<VdbFile, Error> {
    Err(Error::not_supported("reading is not built yet"))
}
