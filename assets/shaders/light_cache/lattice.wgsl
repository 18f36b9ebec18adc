// Layout of the light cache: optical depths towards lights, at points of a coarse lattice through each fog. A
// lattice is a box of texels in one texture, so that the sampler of textures can interpolate.
// `src/render/light_cache/packing.rs` places the boxes.
#define_import_path bevy_vdb::light_cache::lattice

// In place of an optical depth, for a sample beside which there is no fog.
const NO_FOG: f32 = -1.0;

// The first texel of a lattice, given its packed position.
fn first_texel(lattice: u32) -> vec3<u32> {
    return vec3((lattice & 0x3ffu) << 1u, (lattice >> 10u) & 0x7ffu, lattice >> 21u);
}
