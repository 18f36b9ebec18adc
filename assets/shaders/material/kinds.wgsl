// Calls the functions of materials by their kinds. In an app with custom materials, lines for each kind take
// the place of the lines in angle brackets (`src/render/gpu/materials/modules.rs`).
#define_import_path bevy_vdb::material::kinds

#import bevy_vdb::material::{VdbFog, VdbFogPoint, VdbHit, VdbSurface}
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

fn fog_of_kind(number: u32, at: VdbFogPoint, fog: VdbFog) -> VdbFog {
    switch material_kind(number) {
        // <fogs>
        default: {
            return fog;
        }
    }
}
