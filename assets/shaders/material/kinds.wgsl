// Calls the function of a material by its kind. In an app with materials of its own, lines for each kind take the
// place of the two lines in angle brackets (`src/render/gpu/materials/modules.rs`).
#define_import_path bevy_vdb::material::kinds

#import bevy_vdb::material::{VdbHit, VdbSurface}
#import bevy_vdb::material::table::{material_kind, material_words}
// <imports>

fn surface_of_kind(number: u32, hit: VdbHit, surface: VdbSurface) -> VdbSurface {
    switch material_kind(number) {
        // <surfaces>
        default: {
            return surface;
        }
    }
}
