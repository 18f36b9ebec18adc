//! What packs the bytes of values: zlib, Blosc, 16-bit floats.
