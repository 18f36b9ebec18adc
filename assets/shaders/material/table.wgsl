// The table of custom materials: a row for each volume that has one, in the order of
// `src/render/extract/materials.rs`. Numbers of rows begin with 1; they come from the CPU, so each has its row.
#define_import_path bevy_vdb::material::table

@group(2) @binding(18) var materials: texture_2d<u32>;

// The texels of a row, and the rows beside each other, as in `src/render/view/materials.rs`. The first texel
// has the kind of material, three have the matrix from index space to the space of the entity, by rows, and the
// others the parameters.
const ROW_TEXELS: u32 = 8u;
const ROWS_ABREAST: u32 = 64u;
const MATRIX_TEXEL: u32 = 1u;
const PARAMETER_TEXEL: u32 = 4u;

fn material_texel(number: u32, i: u32) -> vec4<u32> {
    let row = number - 1u;
    let texel = vec2((row % ROWS_ABREAST) * ROW_TEXELS + i, row / ROWS_ABREAST);
    return textureLoad(materials, texel, 0);
}

// The kind of a material, from 1.
fn material_kind(number: u32) -> u32 {
    return material_texel(number, 0u).x;
}

// The words of a material's parameters.
fn material_words(number: u32) -> array<vec4<u32>, 4> {
    return array(
        material_texel(number, PARAMETER_TEXEL),
        material_texel(number, PARAMETER_TEXEL + 1u),
        material_texel(number, PARAMETER_TEXEL + 2u),
        material_texel(number, PARAMETER_TEXEL + 3u),
    );
}

// A point of index space in the space of the entity.
fn local_from_index(number: u32, point: vec3<f32>) -> vec3<f32> {
    let at = vec4(point, 1.0);
    return vec3(
        dot(bitcast<vec4<f32>>(material_texel(number, MATRIX_TEXEL)), at),
        dot(bitcast<vec4<f32>>(material_texel(number, MATRIX_TEXEL + 1u)), at),
        dot(bitcast<vec4<f32>>(material_texel(number, MATRIX_TEXEL + 2u)), at),
    );
}
