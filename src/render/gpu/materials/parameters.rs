//! The parameters of a material: the struct of the shader, derived from the component, and the
//! words that fill it.

use std::any::TypeId;
use std::fmt::Write;

use bevy::prelude::*;
use bevy::reflect::structs::Struct;
use bevy::reflect::{PartialReflect, TypeInfo, Typed};
use naga_oil::compose::{ComposableModuleDescriptor, Composer, NagaModuleDescriptor};

/// The most 32-bit words of parameters: `material_words` in `assets/shaders/material/table.wgsl`.
pub(crate) const MOST_WORDS: usize = 16;

/// The parameters of a material in words, the rest of which are 0.
pub(crate) type Words = [u32; MOST_WORDS];

/// The type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FieldType {
    F32,
    I32,
    U32,
    /// Two to four `f32`.
    Vector(usize),
}

impl FieldType {
    fn words(self) -> usize {
        if let Self::Vector(n) = self { n } else { 1 }
    }

    fn wgsl(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::I32 => "i32",
            Self::U32 => "u32",
            Self::Vector(2) => "vec2<f32>",
            Self::Vector(3) => "vec3<f32>",
            Self::Vector(_) => "vec4<f32>",
        }
    }

    /// The expression for a value from words of the table, from `first` on.
    fn read(self, first: usize) -> String {
        let word = |i: usize| format!("words[{}].{}", i / 4, ["x", "y", "z", "w"][i % 4]);
        let float = |i| format!("bitcast<f32>({})", word(i));
        match self {
            Self::F32 => float(first),
            Self::I32 => format!("bitcast<i32>({})", word(first)),
            Self::U32 => word(first),
            Self::Vector(n) => {
                let all: Vec<_> = (first..first + n).map(float).collect();
                format!("{}({})", self.wgsl(), all.join(", "))
            }
        }
    }
}

/// The names and types of a material's parameters.
#[derive(Clone, Debug)]
pub(crate) struct Parameters {
    /// The short name of the component, which is that of the struct.
    pub name: &'static str,
    fields: Vec<(&'static str, FieldType)>,
}

impl Parameters {
    /// The parameters of a component, or why it cannot have a struct in a shader.
    pub fn of<M: Typed>() -> Result<Self, String> {
        let name = M::type_info().type_path_table().ident().unwrap_or_default();
        // Names of structs and fields go through `naga_oil`, which numbers equal names.
        if name.ends_with(|c: char| c.is_ascii_digit()) {
            return Err("its name ends with a digit, which a struct in a shader must not".into());
        }
        let TypeInfo::Struct(info) = M::type_info() else {
            return Err("it is not a struct with named fields".into());
        };
        let mut fields = Vec::new();
        for field in info.iter() {
            let path = field.type_path();
            let ty = FieldType::new(field.type_id()).ok_or_else(|| {
                format!("its field {} has the type {path}, which shaders do not have", field.name())
            })?;
            if !is_name(field.name()) {
                return Err(format!(
                    "its field {} has a name that shaders cannot use; rename it",
                    field.name()
                ));
            }
            fields.push((field.name(), ty));
        }
        let words: usize = fields.iter().map(|(_, ty)| ty.words()).sum();
        if words > MOST_WORDS {
            return Err(format!("its fields have {words} numbers; the limit is {MOST_WORDS}"));
        }
        Ok(Self { name, fields })
    }

    pub fn is_empty(&self) -> bool {
        self.fields.is_empty()
    }

    /// The struct in WGSL.
    pub fn declaration(&self) -> String {
        let mut text = format!("\nstruct {} {{\n", self.name);
        for (name, ty) in &self.fields {
            let _ = writeln!(text, "    {name}: {},", ty.wgsl());
        }
        text + "}\n"
    }

    /// The expression that makes the struct from an array `words`.
    pub fn read(&self) -> String {
        let mut first = 0;
        let mut all = Vec::with_capacity(self.fields.len());
        for (_, ty) in &self.fields {
            all.push(ty.read(first));
            first += ty.words();
        }
        format!("{}({})", self.name, all.join(", "))
    }
}

/// Whether a field of a struct that a module imports can have this name: no keyword, for example, and no name
/// that ends with a digit.
fn is_name(name: &str) -> bool {
    let given = format!("#define_import_path given\nstruct Given {{ {name}: f32 }}");
    let user = format!("#import given::Given\nfn user(own: Given) -> f32 {{ return own.{name}; }}");
    let mut composer = Composer::default();
    let given = ComposableModuleDescriptor { source: &given, ..default() };
    let user = NagaModuleDescriptor { source: &user, ..default() };
    composer.add_composable_module(given).is_ok() && composer.make_naga_module(user).is_ok()
}

/// The parameters of a material in words, field by field.
pub(crate) fn words_of(material: &dyn Struct) -> Words {
    let mut words = Words::default();
    let mut free = words.iter_mut();
    for i in 0..material.field_len() {
        let Some(field) = material.field_at(i) else { continue };
        // Registration has refused what does not fit.
        field_words(field).into_iter().zip(&mut free).for_each(|(word, place)| *place = word);
    }
    words
}

/// The types that fields may have: the type in the shader, and the words of a value.
macro_rules! field_types {
    ($($Type:ty => $type:expr, $words:expr;)*) => {
        impl FieldType {
            fn new(id: TypeId) -> Option<Self> {
                $(if id == TypeId::of::<$Type>() {
                    return Some($type);
                })*
                None
            }
        }

        fn field_words(field: &dyn PartialReflect) -> Vec<u32> {
            $(if let Some(value) = field.try_downcast_ref::<$Type>() {
                let words: fn($Type) -> Vec<u32> = $words;
                return words(*value);
            })*
            Vec::new()
        }
    };
}
field_types! {
    f32 => FieldType::F32, |x| floats(&[x]);
    i32 => FieldType::I32, |x| vec![x.cast_unsigned()];
    u32 => FieldType::U32, |x| vec![x];
    bool => FieldType::U32, |x| vec![u32::from(x)];
    Vec2 => FieldType::Vector(2), |v| floats(&v.to_array());
    Vec3 => FieldType::Vector(3), |v| floats(&v.to_array());
    Vec4 => FieldType::Vector(4), |v| floats(&v.to_array());
    Color => FieldType::Vector(4), |color| floats(&color.to_linear().to_f32_array());
    LinearRgba => FieldType::Vector(4), |color| floats(&color.to_f32_array());
}

fn floats(all: &[f32]) -> Vec<u32> {
    all.iter().map(|x| x.to_bits()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Reflect)]
    struct All {
        level: f32,
        count: i32,
        seed: u32,
        is_wet: bool,
        across: Vec2,
        #[reflect(ignore)]
        #[allow(dead_code, reason = "it is left out")]
        name: String,
        wind: Vec3,
        color: Color,
    }

    #[test]
    fn fields_become_words_in_their_order() {
        let parameters = Parameters::of::<All>().unwrap();
        assert_eq!(
            parameters.declaration(),
            "\nstruct All {\n    level: f32,\n    count: i32,\n    seed: u32,\n    is_wet: u32,\n    \
             across: vec2<f32>,\n    wind: vec3<f32>,\n    color: vec4<f32>,\n}\n"
        );
        let all = All {
            level: 0.5,
            count: -3,
            seed: 7,
            is_wet: true,
            across: Vec2::new(1.0, 2.0),
            name: "sand".into(),
            wind: Vec3::new(3.0, 4.0, 5.0),
            color: Color::linear_rgba(0.1, 0.2, 0.3, 0.4),
        };
        let f = f32::to_bits;
        let expected = [f(0.5), 3_u32.wrapping_neg(), 7, 1, f(1.0), f(2.0), f(3.0), f(4.0), f(5.0)];
        let colors = [0.1, 0.2, 0.3, 0.4].map(f);
        let words = words_of(&all);
        assert_eq!(words[..9], expected);
        assert_eq!(words[9..13], colors);
        assert_eq!(words[13..], [0; 3]);
        // The shader reads each number where it was written.
        let read = parameters.read();
        assert!(
            read.starts_with("All(bitcast<f32>(words[0].x), bitcast<i32>(words[0].y), words[0].z,")
        );
        assert!(read.ends_with(
            "vec4<f32>(bitcast<f32>(words[2].y), bitcast<f32>(words[2].z), \
             bitcast<f32>(words[2].w), bitcast<f32>(words[3].x)))"
        ));
    }

    #[test]
    fn what_shaders_cannot_have_is_refused() {
        #[derive(Reflect)]
        struct Name {
            name: String,
        }
        #[derive(Reflect)]
        struct Large {
            all: [f32; 2],
        }
        #[derive(Reflect)]
        struct Many {
            a: Vec4,
            b: Vec4,
            c: Vec4,
            d: Vec4,
            e: f32,
        }
        #[derive(Reflect)]
        struct Sand2 {
            level: f32,
        }
        #[derive(Reflect)]
        struct Keyword {
            target: f32,
        }
        #[derive(Reflect)]
        struct Digit {
            color2: Color,
        }
        #[derive(Reflect)]
        struct Tuple(f32);
        let why = |result: Result<Parameters, String>| result.unwrap_err();
        assert!(why(Parameters::of::<Name>()).contains("field name has the type"));
        assert!(why(Parameters::of::<Large>()).contains("field all has the type"));
        assert!(why(Parameters::of::<Many>()).contains("17 numbers"));
        assert!(why(Parameters::of::<Sand2>()).contains("digit"));
        assert!(why(Parameters::of::<Keyword>()).contains("field target has a name"));
        assert!(why(Parameters::of::<Digit>()).contains("field color2 has a name"));
        assert!(why(Parameters::of::<Tuple>()).contains("named fields"));
    }
}
