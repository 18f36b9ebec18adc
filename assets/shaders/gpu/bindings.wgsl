// The pool of all packed grids. Groups 0 and 1 are Bevy's: lights and environment maps.
#define_import_path bevy_vdb::gpu::bindings

#import bevy_vdb::gpu::types::Grid

@group(2) @binding(0) var<storage, read> grids: array<Grid>;
@group(2) @binding(1) var<storage, read> page_a: array<u32>;
#ifdef VDB_PAGED
// Pages of 2^PAGE_BITS words, for pools larger than one binding can hold.
@group(2) @binding(2) var<storage, read> page_b: array<u32>;
@group(2) @binding(3) var<storage, read> page_c: array<u32>;
#endif

// A word of the pool.
fn word_at(i: u32) -> u32 {
#ifdef VDB_PAGED
    let rest = i & ((1u << #{VDB_PAGE_BITS}u) - 1u);
    switch i >> #{VDB_PAGE_BITS}u {
        case 0u: {
            return page_a[rest];
        }
        case 1u: {
            return page_b[rest];
        }
        default: {
            return page_c[rest];
        }
    }
#else
    return page_a[i];
#endif
}
