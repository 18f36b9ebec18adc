// Layout of the octants that the lattice of scattered light is made from: two 16-bit floats a word. First the optical
// depth of a cell's edge and the anisotropy of scattering outside of the forward peak; then in each channel the
// optical depths of what is not scattered in the peak, and of what is scattered outside of it; the light that arrives;
// and the sum of its directions.
#define_import_path bevy_vdb::scattered_light::layout

// The number of a place in a box, `x` fastest.
fn number_in(place: vec3<u32>, size: vec3<u32>) -> u32 {
    return (place.z * size.y + place.y) * size.x + place.x;
}

// Words of an octant.
fn octant_words(channels: u32) -> u32 {
    return 1u + 3u * channels;
}

// The first word of an octant.
fn octant_word(octant: vec3<u32>, size: vec3<u32>, channels: u32) -> u32 {
    return number_in(octant, size) * octant_words(channels);
}
