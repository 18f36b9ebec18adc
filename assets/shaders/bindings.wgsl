// The pools that hold every packed grid.
#define_import_path bevy_vdb::bindings

#import bevy_vdb::types::Grid

@group(0) @binding(0) var<storage, read> grids: array<Grid>;
@group(0) @binding(1) var<storage, read> nodes: array<u32>;
@group(0) @binding(2) var<storage, read> masks: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<f32>;
