//! Small files of every kind, generated from the choices of a fuzzer.

use std::sync::Arc;

use arbitrary::{Result, Unstructured};
use glam::{DAffine3, DMat3, DVec3};
use vdb_core::tree::{BitLeaf, BoolTree, IVec3, InternalNode, Mask, MaskTree, Node, Tree, Vdb543};
use vdb_core::{
    AnyTree, Codec, Compression, Grid, GridClass, MetaValue, Metadata, Transform, VdbFile,
};

use super::{CORNERS, FLOATS};

/// The most steps in which a tree grows.
const STEPS: usize = 12;

/// A file generated from the choices: up to three grids, some of them instances.
pub(super) fn file(choices: &mut Unstructured) -> Result<VdbFile> {
    let mut grids: Vec<Grid> = Vec::new();
    for _ in 0..choices.int_in_range(1..=3)? {
        let tree = match grids.last() {
            Some(last) if choices.ratio(1, 4)? => last.tree.clone(),
            _ => tree(choices)?,
        };
        grids.push(grid(choices, tree)?);
    }
    let mut file = VdbFile::new(grids);
    file.metadata = metadata(choices)?;
    Ok(file)
}

fn grid(choices: &mut Unstructured, tree: AnyTree) -> Result<Grid> {
    let names =
        ["a", "b", "density", "", "a[1]", "\u{1b}[31mred", "\n", "ä\0ö", "Tree_float_5_4_3"];
    let mut grid = Grid::new(*choices.choose(&names)?, tree);
    let classes =
        [GridClass::LevelSet, GridClass::FogVolume, GridClass::Unknown, GridClass::Staggered];
    grid.class = *choices.choose(&classes)?;
    grid.saved_as_half = choices.ratio(1, 4)?;
    let codec = *choices.choose(&[Codec::None, Codec::Zip, Codec::Blosc])?;
    grid.compression = Compression { codec, active_mask: !choices.ratio(1, 4)? };
    grid.transform = transform(choices)?.unwrap_or_default();
    grid.metadata = metadata(choices)?;
    Ok(grid)
}

fn tree(choices: &mut Unstructured) -> Result<AnyTree> {
    Ok(match choices.int_in_range(0..=15)? {
        0 => AnyTree::Double(grown(choices, |float| float.into())?),
        1 => AnyTree::Int32(grown(choices, |float| float.to_bits() as i32)?),
        2 => AnyTree::Int64(grown(choices, |float| f64::from(float).to_bits() as i64)?),
        3 => AnyTree::Vec3s(grown(choices, |float| [float, -float, 1.0])?),
        4 => AnyTree::Vec3d(grown(choices, |float| [float.into(), 0.0, -f64::from(float)])?),
        5 => AnyTree::Vec3i(grown(choices, |float| [float as i32, -1, float.to_bits() as i32])?),
        6 => AnyTree::Bool(Arc::new(bools(choices)?)),
        7 => AnyTree::Mask(Arc::new(states(choices)?)),
        _ => AnyTree::Float(grown(choices, |float| float)?),
    })
}

fn float(choices: &mut Unstructured) -> Result<f32> {
    Ok(match choices.int_in_range(0..=7)? {
        0 => f32::from_bits(choices.arbitrary()?),
        1 | 2 => f32::from(choices.arbitrary::<i8>()?) / 16.0,
        _ => *choices.choose(&FLOATS)?,
    })
}

/// The neighbourhood in which a tree grows.
fn home(choices: &mut Unstructured) -> Result<IVec3> {
    if choices.ratio(3, 4)? {
        return Ok(IVec3::ZERO);
    }
    Ok(IVec3::new(
        *choices.choose(&CORNERS)?,
        *choices.choose(&CORNERS)?,
        *choices.choose(&CORNERS)?,
    ))
}

/// A position close to home, or occasionally at a distant corner: each of those costs a large node.
fn place(choices: &mut Unstructured, home: IVec3) -> Result<IVec3> {
    let far = choices.ratio(1, 16)?;
    let mut axis = |home: i32| -> Result<i32> {
        let away = i32::from(choices.arbitrary::<i8>()?);
        Ok(if far {
            choices.choose(&CORNERS)?.saturating_add(away.signum() * (away & 1))
        } else {
            // Mostly on the positive side.
            home.saturating_add(if away < -100 { -1 } else { away.max(-1) / 4 })
        })
    };
    Ok(IVec3::new(axis(home.x)?, axis(home.y)?, axis(home.z)?))
}

type Lower<L> = InternalNode<L, 4>;
type Upper<L> = InternalNode<Lower<L>, 5>;

/// A tree grown step by step: voxels, leaves, tiles and nodes full of tiles, at all levels.
fn grown<T: vdb_core::tree::Value>(
    choices: &mut Unstructured,
    value: fn(f32) -> T,
) -> Result<Arc<Vdb543<T>>> {
    let mut tree = Tree::new(value(float(choices)?));
    let home = home(choices)?;
    for _ in 0..choices.int_in_range(0..=STEPS)? {
        let (at, float, active) = (place(choices, home)?, float(choices)?, choices.arbitrary()?);
        let value_at = value(float);
        match choices.int_in_range(0..=11)? {
            0 | 1 => tree.set(at, value_at),
            2 => tree.set_inactive(at, value_at),
            3 => {
                for i in 0..i32::from(choices.int_in_range(1..=40_u8)?) {
                    tree.set(at.saturating_add(IVec3::new(i, i % 5, i / 3)), value_at);
                }
            }
            4 | 5 => ball(&mut tree, at, f64::from(choices.int_in_range(4..=40_u8)?) / 8.0, value),
            6 => leaf(tree.touch_leaf(at), choices, value)?,
            step => grow(&mut tree, step, at, value_at, active),
        }
    }
    if choices.ratio(1, 4)? {
        tree.prune();
    }
    Ok(Arc::new(tree))
}

/// Inserts a tile at one of the levels, or a node full of them.
fn grow<L: Node<Leaf = L>>(
    tree: &mut Tree<Upper<L>>,
    step: i32,
    at: IVec3,
    value: L::Value,
    active: bool,
) {
    match step {
        7 | 8 => tree.fill_leaf(at, value, active),
        // A tile of 128³, in place of the node that was just created there.
        9 => {
            tree.touch_leaf(at);
            let origin = Upper::<L>::origin_of(at);
            if let Some(upper) = tree.children_mut().find(|upper| upper.origin() == origin) {
                upper.set_tile(Upper::<L>::slot(at), value, active);
            }
        }
        10 => tree.insert_tile(at, value, active),
        _ => tree.insert_child(Upper::<L>::filled(at, value, active)),
    }
}

/// Sets a ball of signed distances, with a narrow band of three voxels.
fn ball<T: vdb_core::tree::Value>(
    tree: &mut Vdb543<T>,
    center: IVec3,
    radius: f64,
    value: fn(f32) -> T,
) {
    let reach = radius.ceil() as i32 + 3;
    for x in -reach..=reach {
        for y in -reach..=reach {
            for z in -reach..=reach {
                let offset = IVec3::new(x, y, z);
                let distance = offset.as_dvec3().length() - radius;
                if distance.abs() < 3.0 {
                    tree.set(center.saturating_add(offset), value(distance as f32));
                }
            }
        }
    }
}

/// Fills a leaf with a pattern of two values and a mask of states.
fn leaf<T: vdb_core::tree::Value>(
    leaf: &mut vdb_core::tree::LeafNode<T, 3>,
    choices: &mut Unstructured,
    value: fn(f32) -> T,
) -> Result<()> {
    let two = [value(float(choices)?), value(float(choices)?)];
    let (pattern, states): (u64, u64) = (choices.arbitrary()?, choices.arbitrary()?);
    for (slot, voxel) in leaf.values_slice_mut().iter_mut().enumerate() {
        *voxel = two[(pattern.rotate_left(slot as u32 / 64) >> (slot & 63) & 1) as usize];
    }
    for (i, word) in leaf.value_mask_mut().words_mut().iter_mut().enumerate() {
        *word = states.rotate_left(i as u32 * 7);
    }
    Ok(())
}

fn bools(choices: &mut Unstructured) -> Result<BoolTree> {
    let mut tree = BoolTree::new(choices.arbitrary()?);
    let home = home(choices)?;
    for _ in 0..choices.int_in_range(0..=STEPS)? {
        let (at, value, active) =
            (place(choices, home)?, choices.arbitrary()?, choices.arbitrary()?);
        match choices.int_in_range(4..=11)? {
            4 => tree.set(at, value),
            5 => tree.set_inactive(at, value),
            6 => {
                let words: [u64; 8] = choices.arbitrary()?;
                let mask = Mask::from_words(&words).unwrap_or_else(|| Mask::filled(false));
                *tree.touch_leaf(at) = *BitLeaf::from_parts(at, mask.clone(), mask);
            }
            step => grow(&mut tree, step, at, value, active),
        }
    }
    Ok(tree)
}

/// A mask tree, in which values are states.
fn states(choices: &mut Unstructured) -> Result<MaskTree> {
    let (mut tree, home) = (MaskTree::new(false), home(choices)?);
    for _ in 0..choices.int_in_range(0..=STEPS)? {
        let (at, active) = (place(choices, home)?, choices.arbitrary()?);
        match choices.int_in_range(5..=11)? {
            5 => tree.set(at, true),
            6 => tree.set_inactive(at, false),
            step => grow(&mut tree, step, at, active, active),
        }
    }
    Ok(tree)
}

/// A transform: ordinary, mirrored, huge, tiny, flat, or arbitrary.
fn transform(choices: &mut Unstructured) -> Result<Option<Transform>> {
    let scales = [1.0, 0.1, -1.0, 1e-300, 1e300, 1e-30, 1e30, 0.0, 5e-324, 1e9, 1e-9];
    let size = *choices.choose(&scales)?;
    let moves = [0.0, 1.0, -1e9, 1e18, 1e300, f64::INFINITY];
    let translation = DVec3::new(*choices.choose(&moves)?, *choices.choose(&moves)?, 0.5);
    Ok(match choices.int_in_range(0..=3)? {
        0 => Transform::uniform(size, DVec3::ZERO),
        1 => Transform::uniform(size, translation),
        2 => {
            let scale = DVec3::new(size, *choices.choose(&scales)?, -0.5);
            let matrix3 = DMat3::from_rotation_y(0.3) * DMat3::from_diagonal(scale);
            Transform::affine(DAffine3 { matrix3, translation })
        }
        _ => {
            let numbers: [f64; 9] = choices.arbitrary()?;
            let matrix3 = DMat3::from_cols_array(&numbers);
            Transform::affine(DAffine3 { matrix3, translation })
        }
    })
}

fn metadata(choices: &mut Unstructured) -> Result<Metadata> {
    let mut metadata = Metadata::default();
    for _ in 0..choices.int_in_range(0..=3)? {
        let names =
            ["name", "class", "is_saved_as_half_float", "", "\u{1b}]0;x\u{7}", "file_bbox_min"];
        let name = if choices.arbitrary()? {
            (*choices.choose(&names)?).to_owned()
        } else {
            choices.arbitrary::<&str>()?.chars().take(40).collect()
        };
        let value = match choices.int_in_range(0..=8)? {
            0 => MetaValue::Bool(choices.arbitrary()?),
            1 => MetaValue::Int32(choices.arbitrary()?),
            2 => MetaValue::Int64(choices.arbitrary()?),
            3 => MetaValue::Float(float(choices)?),
            4 => MetaValue::Double(choices.arbitrary()?),
            5 => MetaValue::Vec3i(choices.arbitrary()?),
            6 => MetaValue::Mat4d([choices.arbitrary()?; 16]),
            7 => {
                let type_name = (*choices.choose(&["float", "half", "\0", "string"])?).to_owned();
                // A length that the type cannot have, and bytes that are not UTF-8.
                MetaValue::Unknown { type_name, bytes: vec![0xff; choices.int_in_range(5..=40)?] }
            }
            _ => MetaValue::String(choices.arbitrary::<&str>()?.chars().take(300).collect()),
        };
        metadata.insert(name, value);
    }
    Ok(metadata)
}
