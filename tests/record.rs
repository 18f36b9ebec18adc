//! Recording in a Bevy app: what a camera draws is what stands in the files.
