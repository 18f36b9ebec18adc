//! The roles of a file's grids: which one is the fog, which one is its fire, and which surfaces to show.
//! Programs identify them by name.

/// Names of densities in OpenVDB, Blender, Houdini and `EmberGen`.
const DENSITIES: [&str; 2] = ["density", "smoke"];

/// Names of emission grids, and the temperatures in kelvin for values of 0 and 1. Names of fire
/// come before those of heat, because smoke without fire has heat, too.
const FIRES: [(&str, [f32; 2]); 7] = [
    ("flame", FLAMES),
    ("flames", FLAMES),
    ("fire", FLAMES),
    ("burn", FLAMES),
    ("temperature", HEAT),
    ("heat", HEAT),
    ("temp", HEAT),
];
/// Ignition and maximum temperature of fuel: Blender's defaults.
const FLAMES: [f32; 2] = [1_500.0, 3_000.0];
/// The default temperature of Blender's Principled Volume.
const HEAT: [f32; 2] = [0.0, 1_000.0];

/// Temperatures above this are in kelvin; other units stay far below.
const KELVIN: f32 = 100.0;

/// Houdini's name for a surface.
const SURFACE: &str = "surface";

/// The prefix of auxiliary surfaces in Blender's fluid simulations.
const HELPERS: &str = "phi_";

/// Names of signed distances that Houdini's cloud tools save beside a fog.
const DISTANCES: [&str; 3] = ["distance", "sdf", "signed_distance"];

/// Names of colours: Houdini's, and common ones.
pub const COLORS: [&str; 4] = ["cd", "color", "colour", "albedo"];

/// Names of velocities in Blender and Houdini.
pub const VELOCITIES: [&str; 3] = ["velocity", "vel", "v"];

/// Suffixes of the components of a vector that is saved as three float grids, in Houdini and Blender.
const COMPONENTS: [[&str; 3]; 3] = [[".x", ".y", ".z"], ["_x", "_y", "_z"], ["_r", "_g", "_b"]];

/// The properties of a grid that determine its role.
#[derive(Clone, Copy, Debug)]
pub struct Candidate<'a> {
    /// The name.
    pub name: &'a str,
    /// Whether it is shown as fog, not as a surface.
    pub is_fog: bool,
    /// Whether the grid has nothing to display.
    pub is_empty: bool,
}

/// Roles, as positions in a list of grids.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parts {
    /// The surfaces to show.
    pub surfaces: Vec<usize>,
    /// The fog to show.
    pub density: Option<usize>,
    /// What emits light in the fog.
    pub fire: Option<usize>,
}

/// The fogs, by position, without components of vectors, which are fogs only by class.
fn fogs(all: &[Candidate]) -> impl Iterator<Item = usize> {
    (0..all.len()).filter(|i| all[*i].is_fog && !is_component(all[*i].name))
}

/// Whether a name stands for one component of a colour or velocity.
fn is_component(name: &str) -> bool {
    COLORS.iter().chain(&VELOCITIES).any(|vector| component_of(name, vector).is_some())
}

/// The spelling and the axis of a name that stands for one component of a vector.
pub fn component_of(name: &str, vector: &str) -> Option<(usize, usize)> {
    let (start, suffix) = name.split_at_checked(name.len().checked_sub(2)?)?;
    let find = |(spelling, suffixes): (usize, &[&str; 3])| {
        Some((spelling, suffixes.iter().position(|own| is(suffix, own))?))
    };
    COMPONENTS.iter().enumerate().find_map(find).filter(|_| is(start, vector))
}

/// The roles of all grids of a file. Surfaces that only help a simulation are left out, and so are
/// distances that would hide a fog.
pub fn parts(all: &[Candidate]) -> Parts {
    let fogs = || fogs(all);
    let called = |name: &str| fogs().find(|i| is(all[*i].name, name));
    // Blender writes empty grids, too.
    let fire = FIRES.iter().find_map(|(name, _)| called(name).filter(|i| !all[*i].is_empty));
    let density = DENSITIES.iter().find_map(|name| called(name));
    let density = density.or_else(|| fogs().find(|i| fire != Some(*i)).or(fogs().next()));
    let is_seen = density.is_some_and(|density| !all[density].is_empty);
    let helps = |name: &str| {
        let has_prefix = || name.get(..HELPERS.len()).is_some_and(|start| is(start, HELPERS));
        density.is_some() && has_prefix() || is_seen && DISTANCES.iter().any(|own| is(name, own))
    };
    let surfaces = (0..all.len()).filter(|i| !all[*i].is_fog && !helps(all[*i].name)).collect();
    Parts { surfaces, density, fire: fire.filter(|fire| density != Some(*fire)) }
}

/// A first guess at the temperatures in kelvin of an emission grid, for values of 0 and 1, by its name
/// and its largest value.
pub fn kelvin(name: &str, most: f32) -> [f32; 2] {
    if most > KELVIN {
        return [0.0, 1.0];
    }
    FIRES.iter().find(|(own, _)| is(name, own)).map_or(HEAT, |(_, kelvin)| *kelvin)
}

/// The main grid of a file: its surface, or its fog. `None` if there are several candidates.
pub fn main_grid(all: &[Candidate]) -> Option<usize> {
    let Parts { surfaces, density, fire } = parts(all);
    match (&surfaces[..], density) {
        ([], density) => {
            let is_named = |i: &usize| DENSITIES.iter().any(|name| is(all[*i].name, name));
            let fogs = fogs(all).filter(|i| fire != Some(*i)).count();
            density.filter(|density| is_named(density) || fogs == 1)
        }
        ([surface], None) => Some(*surface),
        (several, None) => several.iter().copied().find(|i| is(all[*i].name, SURFACE)),
        (_, Some(_)) => None,
    }
}

/// The main vector grid, by name.
pub fn main_vectors(names: &[&str]) -> Option<usize> {
    let called = |name: &&str| names.iter().position(|own| is(own, name));
    COLORS.iter().find_map(called).or((names.len() == 1).then_some(0))
}

/// Whether two names are equal, ignoring case.
pub fn is(name: &str, what: &str) -> bool {
    name.eq_ignore_ascii_case(what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_beside_a_fog_and_components_of_vectors_have_no_role() {
        let roles = |all: &[(&'static str, bool)]| {
            let candidate = |&(name, is_fog)| Candidate { name, is_fog, is_empty: false };
            let Parts { surfaces, density, fire } =
                parts(&all.iter().map(candidate).collect::<Vec<_>>());
            (surfaces, density, fire)
        };
        let (fog, surface) = (true, false);
        let nebula = [("density", fog), ("distance", surface), ("color.x", fog), ("color.y", fog)];
        assert_eq!(roles(&nebula), (vec![], Some(0), None));
        let collider = [("density", fog), ("surface", surface)];
        assert_eq!(roles(&collider), (vec![1], Some(0), None));
        assert_eq!(roles(&[("distance", surface)]), (vec![0], None, None));
        let vectors = [("color_r", fog), ("v.y", fog), ("temperature", fog)];
        assert_eq!(roles(&vectors), (vec![], Some(2), None));
        for name in ["", "x", ".x", "é.x", "rest.x", "colorx", "color.w"] {
            assert!(!is_component(name), "{name}");
        }
    }

    #[test]
    fn the_grid_that_a_file_is_about_is_found_or_asked_for() {
        let main = |all: &[(&'static str, bool)]| {
            let candidate = |&(name, is_fog)| Candidate { name, is_fog, is_empty: false };
            main_grid(&all.iter().map(candidate).collect::<Vec<_>>())
        };
        let (fog, surface) = (true, false);
        for (all, expected) in [
            (&[("ls_dragon", surface)][..], Some(0)),
            (&[("", surface)], Some(0)),
            (&[("ls", fog)], Some(0)),
            // Blender's and Houdini's smoke.
            (&[("temperature", fog), ("density", fog), ("flame", fog), ("shadow", fog)], Some(1)),
            (&[("phi_obstacle", surface), ("Density", fog), ("heat", fog)], Some(1)),
            (&[("heat", fog), ("fuel", fog)], Some(1)),
            (&[("temperature", fog)], Some(0)),
            (&[("collision", surface), ("surface", surface)], Some(1)),
            // Houdini's clouds.
            (&[("distance", surface), ("density", fog), ("color.x", fog)], Some(1)),
            (
                &[("cloud", fog), ("Cd.x", fog), ("Cd.y", fog), ("Cd.z", fog), ("vel.x", fog)],
                Some(0),
            ),
            (&[("SDF", surface)], Some(0)),
            (&[("distance", surface), ("other", surface)], None),
            // Ambiguous.
            (&[("left", surface), ("right", surface)], None),
            (&[("a", fog), ("b", fog)], None),
            (&[("surface", surface), ("density", fog)], None),
            (&[], None),
        ] {
            assert_eq!(main(all), expected, "{all:?}");
        }
        assert_eq!(main_vectors(&["vel", "cd"]), Some(1));
        assert_eq!(main_vectors(&["vel"]), Some(0));
        assert_eq!(main_vectors(&["vel", "rest"]), None);
        assert_eq!(main_vectors(&[]), None);
    }
}
