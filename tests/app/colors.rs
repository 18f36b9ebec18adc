//! Colours that are saved as three grids of floats.

use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_vdb::{VdbFile, VdbGrid, VdbLoaderSettings, VdbVectorGrid};
use vdb_core::tree::{Tree, Vdb543};
use vdb_core::{AnyTree, Grid, GridClass, Transform, WriteOptions};

use super::assets::{app, load, loaded};

/// A grid with a value at its own voxel and at the voxel that all have.
fn grid(name: &str, own: IVec3, value: f32) -> Grid {
    let mut tree: Vdb543<f32> = Tree::new(0.0);
    tree.set(own, value);
    tree.set(IVec3::ZERO, value);
    let mut grid = Grid::new(name, AnyTree::Float(tree.into()));
    grid.class = GridClass::FogVolume;
    grid
}

/// The file as it is loaded, its labels, and its colour by its roles.
fn load_file(
    test: &str,
    grids: Vec<Grid>,
    change: impl FnOnce(&mut VdbLoaderSettings),
) -> (Vec<String>, Vec<String>, Option<VdbVectorGrid>) {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_{test}_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("grids.vdb");
    vdb_core::VdbFile::new(grids).save(&path, &WriteOptions::default()).unwrap();
    let mut app = app();
    let mut settings = VdbLoaderSettings::default();
    change(&mut settings);
    let server = app.world().resource::<AssetServer>().clone();
    let handle: Handle<VdbFile> =
        server.load_builder().with_settings(move |own| *own = settings.clone()).load(path.clone());
    let file = loaded(&mut app, &handle);
    let roles = file.roles(app.world().resource::<Assets<VdbGrid>>());
    let colors = roles.colors.map(|colors| loaded(&mut app, &colors.0));
    let sorted = |mut labels: Vec<String>| {
        labels.sort();
        labels
    };
    let labels = sorted(file.named_grids.keys().cloned().collect());
    let vectors = sorted(file.vector_grids.keys().cloned().collect());
    if colors.is_some() {
        let main: Handle<VdbVectorGrid> = load(&app, path);
        assert_eq!(loaded(&mut app, &main).name(), vectors[0], "without a label");
    }
    std::fs::remove_dir_all(folder).unwrap();
    (labels, vectors, colors)
}

#[test]
fn three_grids_with_the_components_of_a_colour_are_one() {
    for [x, y, z] in [
        ["Cd.x", "Cd.y", "Cd.z"],
        ["color_r", "color_g", "color_b"],
        ["ALBEDO_X", "albedo_Y", "albedo_z"],
    ] {
        let place = Transform::uniform(0.5, DVec3::new(1.0, 2.0, 3.0)).unwrap();
        let mut grids = vec![
            grid(z, IVec3::new(0, 0, 900), 0.75),
            grid("density", IVec3::ONE, 1.0),
            grid(x, IVec3::new(-9, 0, 0), 0.25),
            grid(y, IVec3::new(0, 9, 0), 0.5),
            grid("vel.x", IVec3::ONE, 1.0),
        ];
        grids.iter_mut().for_each(|grid| grid.transform = place.clone());
        let (labels, vectors, colors) = load_file("joined", grids, |_| ());
        let name = &x[..x.len() - 2];
        assert_eq!((labels, vectors), (vec!["density".into(), "vel.x".into()], vec![name.into()]));
        let colors = colors.expect("a colour");
        let at = |x, y, z| colors.tree().get(IVec3::new(x, y, z));
        assert_eq!(at(0, 0, 0), [0.25, 0.5, 0.75]);
        assert_eq!(at(-9, 0, 0), [0.25, 0.0, 0.0]);
        assert_eq!(at(0, 9, 0), [0.0, 0.5, 0.0]);
        assert_eq!(at(0, 0, 900), [0.0, 0.0, 0.75]);
        assert_eq!(colors.world_from_index(), place.linear().unwrap());
    }
}

#[test]
fn what_is_not_one_colour_stays_as_it_is() {
    let three = || ["Cd.x", "Cd.y", "Cd.z"].map(|name| grid(name, IVec3::ONE, 0.5)).to_vec();
    let names = ["Cd.x", "Cd.y", "Cd.z"];
    let mut moved = three();
    moved[1].transform = Transform::uniform(0.5, DVec3::ZERO).unwrap();
    assert_eq!(load_file("moved", moved, |_| ()).0, names, "transforms differ");
    let two = three()[..2].to_vec();
    assert_eq!(load_file("two", two, |_| ()).0, names[..2], "one is missing");
    let mut mixed = three();
    mixed[2].name = "Cd_z".into();
    mixed[2].unique_name = "Cd_z".into();
    assert_eq!(load_file("mixed", mixed, |_| ()).0.len(), 3, "two spellings");
    let mut both = three();
    let vectors: Vdb543<[f32; 3]> = Tree::new([0.1; 3]);
    both.push(Grid::new("Cd", AnyTree::Vec3s(vectors.into())));
    let (labels, vectors, colors) = load_file("both", both, |_| ());
    assert_eq!((labels, vectors), (names.map(String::from).to_vec(), vec!["Cd".into()]));
    assert_eq!(colors.unwrap().tree().background(), [0.1; 3], "the file has a colour of its own");
    let bytes = 3 * three().iter().map(|grid| tree_bytes(&grid.tree)).sum::<u64>();
    let limited = |tree_bytes| {
        load_file("limited", three(), |settings| {
            settings.limits.tree_bytes = tree_bytes;
        })
    };
    assert_eq!(limited(bytes).1, ["Cd"]);
    assert_eq!(limited(bytes - 1).0, names, "it might take too much memory");
}

fn tree_bytes(tree: &AnyTree) -> u64 {
    let AnyTree::Float(tree) = tree else { panic!("they are floats") };
    tree.stats().bytes
}
