// Stores the samples of a lattice: in the texture itself where the adapter supports `r16float` as a storage
// format, which WebGPU does not guarantee; elsewhere in a buffer that is copied to the texture.
#define_import_path bevy_vdb::light_cache::store

#ifdef VDB_STORABLE_LATTICE
#import bevy_vdb::light_cache::lattice::first_texel

@group(2) @binding(7) var lattices: texture_storage_3d<r16float, write>;
#else
// Two 16-bit floats a word, in lines of `line_words`.
@group(2) @binding(7) var<storage, read_write> staging: array<u32>;
#endif

// Where a lattice is stored.
struct Place {
    samples: vec3<u32>,
    lattice: u32,       // its packed position in the texture
    line_words: u32,    // of a line of samples in the buffer
}

// Stores two samples along x, the first at an even coordinate. Lines have room for an even number.
fn store_samples(place: Place, sample: vec3<u32>, first: f32, second: f32) {
#ifdef VDB_STORABLE_LATTICE
    let texel = first_texel(place.lattice) + sample;
    textureStore(lattices, texel, vec4(first));
    textureStore(lattices, texel + vec3(1u, 0u, 0u), vec4(second));
#else
    let line = sample.z * place.samples.y + sample.y;
    staging[line * place.line_words + sample.x / 2u] = pack2x16float(vec2(first, second));
#endif
}
