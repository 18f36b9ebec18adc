// The volumes that a segment may hit, and where the search in each can start.
#define_import_path bevy_vdb::trace::candidates

#import bevy_vdb::view::scene::{scene_end, visible_end, view}
#ifdef VDB_LEVELS
#import bevy_vdb::view::scene::volumes
#endif
#import bevy_vdb::trace::segment::Segment
#ifdef VDB_MANY
#import bevy_vdb::trace::bvh::next_intersected
#endif

#ifdef VDB_BEAMS
// For each tile of 8×8 pixels, one bit for each volume, or group of volumes, of the view that can stop a ray
// of the tile. If there is room, these are followed by the t before which nothing can stop a ray, for each
// volume and tile.
@group(2) @binding(9) var<storage, read> tiles: array<u32>;

fn tile_index(pixel: vec2<u32>) -> u32 {
    return pixel.y / 8u * ((view.size.x + 7u) / 8u) + pixel.x / 8u;
}
#endif

// The first volume from index `i` that a segment may hit before `t_max`; past the last index if there is
// none.
fn next_candidate(segment: Segment, pixel: vec2<u32>, i: u32, t_max: f32) -> u32 {
#ifdef VDB_MANY
    if !segment.is_view {
        return next_intersected(segment, i, t_max);
    }
#endif
#ifdef VDB_BEAMS
    // Secondary rays, and volumes outside the view, have no tile bits.
    if segment.is_view && i < visible_end() {
        let words = tile_index(pixel) * view.tile_words;
        let bit = (i - view.volume_first) >> view.group_bits;
        var word = bit >> 5u;
        var bits = tiles[words + word] & (0xffffffffu << (bit & 31u));
        while bits == 0u && word + 1u < view.tile_words {
            word++;
            bits = tiles[words + word];
        }
        let next = view.volume_first + ((32u * word + firstTrailingBit(bits)) << view.group_bits);
        return select(max(i, next), visible_end(), bits == 0u);
    }
#endif
    return i;
}

// The t before which nothing in a volume can stop a ray.
fn start_t(segment: Segment, volume: u32, pixel: vec2<u32>) -> f32 {
#ifdef VDB_BEAMS
    if segment.is_view && view.has_tile_starts != 0u {
        let size = (view.size + 7u) / 8u;
        let starts = size.x * size.y * (view.tile_words + volume - view.volume_first);
        return bitcast<f32>(tiles[starts + tile_index(pixel)]);
    }
#endif
#ifdef VDB_LEVELS
    if segment.is_view {
        return max(segment.t_min, volumes[volume].t_first);
    }
#endif
    return segment.t_min;
}

// One past the last volume that a segment can hit.
fn volume_end(segment: Segment) -> u32 {
    return select(scene_end(), visible_end(), segment.is_view);
}
