// A view and the volumes that it sees, or that throw shadows on what it sees.
#define_import_path bevy_vdb::scene

#import bevy_vdb::types::{View, Volume}

@group(2) @binding(4) var<uniform> view: View;
@group(2) @binding(5) var<storage, read> volumes: array<Volume>;

// One past the volumes that the view sees.
fn seen_end() -> u32 {
    return view.volume_first + view.volume_count;
}

// One past those that shadows and reflections look at too: what is out of the picture comes last.
fn scene_end() -> u32 {
    return seen_end() + view.volumes_beside;
}
