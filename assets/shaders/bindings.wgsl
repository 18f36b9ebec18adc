// The pools that hold every packed grid. Groups 0 and 1 are Bevy's own: lights and environment maps.
#define_import_path bevy_vdb::bindings

#import bevy_vdb::types::Grid

@group(2) @binding(0) var<storage, read> grids: array<Grid>;
@group(2) @binding(1) var<storage, read> nodes: array<u32>;
@group(2) @binding(2) var<storage, read> masks: array<u32>;
@group(2) @binding(3) var<storage, read> values: array<f32>;
