// Opacity maps: the optical depth of a fog along the rays of a light, between slices. They are Kim and Neumann's
// (2001, "Opacity shadow maps"), except that the slices of each ray lie between where it enters and where it leaves
// the fog's box, so that they follow the fog, as Yuksel and Keyser's do (2008, "Deep opacity maps").
//
// A map is in nine layers of a texture. The first has the places along the ray where the slices begin and end, from 0
// at `t_first` to 1 at `t_last`, and what is lost when these are rounded. Each of the others holds the optical depths at
// the ends of four slices.
#define_import_path bevy_vdb::shadow_maps::opacity

#import bevy_vdb::gpu::types::OpacityMap

// The slices of a ray, and the layers that have them: `LAYERS` in `src/render/shadow_maps/opacity.rs` is one more.
const SLICES: u32 = 32u;
const SLICE_LAYERS: u32 = 8u;

// For each volume in the shadow maps, if it is a fog.
@group(0) @binding(0) var<storage, read> opacity_maps: array<OpacityMap>;
