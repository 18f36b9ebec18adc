//! Old versions of the format, of which no file could be had: files made here by what OpenVDB's
//! source says of them, read by us and, where it is installed, by OpenVDB 10.

mod openvdb;

use std::io::Write;

use glam::{DVec3, IVec3};
use vdb_core::{AnyTree, GridClass, ReadOptions, VdbFile, WriteOptions};

/// What is put into a file.
#[derive(Clone, Copy, Debug)]
struct Kind {
    version: u32,
    /// Said by the header in versions 220 and 221, a matter of course before.
    zip: bool,
    half: bool,
    offsets: bool,
    /// Copies of the values of each leaf.
    buffers: u8,
    map: &'static str,
}

const ORIGIN: IVec3 = IVec3::new(-4096, 0, 4096);
const BACKGROUND: f32 = 2.5;
/// Slots of an upper and of a middle node that hold a child; the next one is an active tile.
const CHILD: usize = 7;

struct Maker {
    kind: Kind,
    out: Vec<u8>,
}

impl Maker {
    fn text(&mut self, text: &str) {
        self.out.extend((text.len() as u32).to_le_bytes());
        self.out.extend(text.as_bytes());
    }

    fn mask(&mut self, slots: usize, on: &[usize]) {
        let mut bytes = vec![0_u8; slots / 8];
        for slot in on {
            bytes[slot / 8] |= 1 << (slot % 8);
        }
        self.out.extend(bytes);
    }

    fn values(&mut self, values: &[f32]) {
        let bytes: Vec<u8> = if self.kind.half {
            values.iter().flat_map(|v| half::f16::from_f32(*v).to_le_bytes()).collect()
        } else {
            values.iter().flat_map(|v| v.to_le_bytes()).collect()
        };
        if !self.kind.zip {
            return self.out.extend(bytes);
        }
        let mut encoder =
            flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(&bytes).unwrap();
        let packed = encoder.finish().unwrap();
        self.out.extend((packed.len() as i64).to_le_bytes());
        self.out.extend(packed);
    }

    fn origin(&mut self, origin: IVec3) {
        self.out.extend(origin.to_array().into_iter().flat_map(i32::to_le_bytes));
    }

    fn metadata(&mut self) {
        let half = if self.kind.half { 1 } else { 0 };
        self.out.extend(3_u32.to_le_bytes());
        for (name, type_name, value) in [
            ("class", "string", &b"level set"[..]),
            ("is_saved_as_half_float", "bool", &[half]),
            ("name", "string", b"old"),
        ] {
            self.text(name);
            self.text(type_name);
            self.out.extend((value.len() as u32).to_le_bytes());
            self.out.extend(value);
        }
    }

    fn transform(&mut self) {
        let mut numbers;
        if self.kind.version < 219 {
            self.text("LinearTransform");
            self.origin(IVec3::ZERO);
            self.origin(IVec3::ONE);
            let diagonal = |a: f64, last: [f64; 3]| {
                let mut m = [0.0; 16];
                (m[0], m[5], m[10], m[15]) = (a, a, a, 1.0);
                m[12..15].copy_from_slice(&last);
                m
            };
            // Local to world, world to local, voxel to local, local to voxel.
            let matrices = [
                diagonal(2.0, [1.0, 0.0, 0.0]),
                diagonal(0.5, [-0.5, 0.0, 0.0]),
                diagonal(0.25, [0.0; 3]),
                diagonal(4.0, [0.0; 3]),
            ];
            numbers = matrices.concat();
        } else {
            self.text(self.kind.map);
            let scale = |s: [f64; 3]| {
                let inverse = s.map(f64::recip);
                [s, s.map(f64::abs), inverse, inverse.map(|i| i * i), inverse.map(|i| i / 2.0)]
                    .concat()
            };
            let rows = |x: [f64; 3], y: [f64; 3], z: [f64; 3], t: [f64; 3]| {
                let row = |[a, b, c]: [f64; 3], d| [a, b, c, d];
                [row(x, 0.0), row(y, 0.0), row(z, 0.0), row(t, 1.0)].concat()
            };
            numbers = match self.kind.map {
                "UniformScaleMap" => scale([0.1; 3]),
                "ScaleMap" => scale([0.1, -0.2, 0.3]),
                "TranslationMap" => vec![0.1, 1e9, -3.0],
                "UniformScaleTranslateMap" => [vec![1.0, 0.0, 0.0], scale([0.5; 3])].concat(),
                "ScaleTranslateMap" => [vec![1.1, 2.2, 3.3], scale([0.1, 0.2, -0.3])].concat(),
                "UnitaryMap" => rows([0.6, 0.8, 0.], [-0.8, 0.6, 0.], [0., 0., 1.], [0.; 3]),
                "AffineMap" => rows([0.1, 0.2, 0.3], [0.5, -1., 0.], [0., 0.7, 9.], [1., 2., 3.]),
                "NonlinearFrustumMap" if self.kind.version < 221 => Vec::new(),
                "NonlinearFrustumMap" => vec![0.0, 0.0, 0.0, 100.0, 80.0, 60.0, 0.5, 2.0],
                other => panic!("{other}"),
            };
            if self.kind.map == "NonlinearFrustumMap" {
                if self.kind.version < 221 {
                    // The box has corners in whole numbers.
                    self.origin(IVec3::ZERO);
                    self.origin(IVec3::new(100, 80, 60));
                    numbers = vec![0.5, 2.0];
                }
                self.out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
                self.text("UniformScaleTranslateMap");
                numbers = [vec![1.0, 2.0, 3.0], scale([0.25; 3])].concat();
            }
        }
        self.out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    }

    /// Masks and tiles: all but the slot of the child, which old files leave out.
    fn internal(&mut self, slots: usize, tile: f32) {
        self.mask(slots, &[CHILD]);
        self.mask(slots, &[CHILD + 1]);
        let mut tiles = vec![BACKGROUND; slots - 1];
        // The tile after the child: one place earlier than its slot.
        tiles[CHILD] = tile;
        self.values(&tiles);
    }

    fn tree(&mut self) {
        self.out.extend(1_u32.to_le_bytes());
        self.out.extend(BACKGROUND.to_le_bytes());
        self.out.extend([0, 0, 0, 0, 1, 0, 0, 0]);
        self.origin(ORIGIN);
        self.internal(32 * 32 * 32, 11.0);
        self.internal(16 * 16 * 16, 12.0);
        self.mask(512, &[3, 500]);
    }

    fn leaf(&mut self) {
        self.mask(512, &[3, 500]);
        // Slot 7 of 32 or 16 a side: seven slots along z.
        self.origin(ORIGIN + IVec3::new(0, 0, 7 * 128 + 7 * 8));
        self.out.push(self.kind.buffers);
        for buffer in 0..self.kind.buffers {
            let values: Vec<f32> =
                (0..512).map(|i| i as f32 + 1000.0 * f32::from(buffer)).collect();
            self.values(&values);
        }
    }
}

fn make(kind: Kind) -> Vec<u8> {
    let mut maker = Maker { kind, out: b" BDV\0\0\0\0".to_vec() };
    for number in [kind.version, 1, 0] {
        maker.out.extend(number.to_le_bytes());
    }
    maker.out.push(kind.offsets.into());
    if kind.version >= 220 {
        maker.out.push(kind.zip.into());
    }
    maker.out.extend(b"01234567-89ab-cdef-0123-456789abcdef");
    maker.out.extend(0_u32.to_le_bytes());
    maker.out.extend(1_u32.to_le_bytes());
    maker.text("old");
    maker.text(if kind.half { "Tree_float_5_4_3_HalfFloat" } else { "Tree_float_5_4_3" });
    maker.text("");
    let places = maker.out.len();
    maker.out.extend([0; 24]);
    let start = maker.out.len();
    maker.metadata();
    maker.transform();
    maker.tree();
    let values = maker.out.len();
    maker.leaf();
    let end = maker.out.len();
    if kind.offsets {
        for (index, place) in [start, values, end].into_iter().enumerate() {
            maker.out[places + 8 * index..][..8].copy_from_slice(&(place as i64).to_le_bytes());
        }
    }
    maker.out
}

#[test]
fn versions_218_to_221() {
    let folder = openvdb::folder("versions");
    let mut grids = Vec::new();
    for version in 218..=221 {
        for bits in 0..16 {
            let [zip, half, offsets, copies] = [0, 1, 2, 3].map(|bit| bits >> bit & 1 == 1);
            // Before 220 nothing said that a file might not be zipped.
            if version < 220 && !zip {
                continue;
            }
            let buffers = if copies { 3 } else { 1 };
            let map = "UniformScaleTranslateMap";
            let kind = Kind { version, zip, half, offsets, buffers, map };
            let bytes = make(kind);
            let file = VdbFile::read(&bytes, &ReadOptions::default())
                .unwrap_or_else(|error| panic!("{kind:?}: {error}"));
            let [grid] = &file.grids[..] else { panic!("{kind:?}") };
            assert_eq!((file.version, grid.saved_as_half), (version, half));
            assert_eq!((&*grid.name, grid.class), ("old", GridClass::LevelSet));
            assert_eq!(grid.transform.map_type(), "UniformScaleTranslateMap");
            let world = grid.transform.world_from_index(DVec3::new(2.0, 4.0, 6.0));
            assert_eq!(world, DVec3::new(2.0, 2.0, 3.0), "{kind:?}");
            let AnyTree::Float(tree) = &grid.tree else { panic!("{kind:?}") };
            let leaf = ORIGIN + IVec3::new(0, 0, 7 * 128 + 7 * 8);
            // Slot 3 is three along z; slot 500 is 7, 6, 4.
            assert_eq!(tree.probe(leaf + IVec3::new(0, 0, 3)), (3.0, true), "{kind:?}");
            assert_eq!(tree.probe(leaf + IVec3::new(7, 6, 4)), (500.0, true));
            assert_eq!(tree.probe(leaf + IVec3::new(0, 0, 4)), (4.0, false));
            assert_eq!(tree.probe(leaf + IVec3::new(0, 0, 8)), (12.0, true));
            assert_eq!(tree.probe(leaf + IVec3::new(0, 0, 16)), (BACKGROUND, false));
            assert_eq!(tree.probe(ORIGIN + IVec3::new(0, 0, 8 * 128)), (11.0, true));
            assert_eq!(tree.probe(IVec3::ZERO), (BACKGROUND, false));
            assert_eq!(tree.active_voxel_count(), 2 + 512 + (1 << 21));
            let old = folder.join(format!("{version}-{bits}.vdb"));
            let new = folder.join(format!("{version}-{bits}-as-224.vdb"));
            std::fs::write(&old, &bytes).unwrap();
            file.save(&new, &WriteOptions::default()).unwrap();
            grids.push((old, new, "old".to_owned()));
        }
    }
    assert_eq!(grids.len(), 48);
    // What OpenVDB reads from the old file and from ours of version 224 must be the same.
    openvdb::compare(&grids);
}

#[test]
fn every_map() {
    let folder = openvdb::folder("maps");
    let maps = [
        "UniformScaleMap",
        "ScaleMap",
        "TranslationMap",
        "UniformScaleTranslateMap",
        "ScaleTranslateMap",
        "UnitaryMap",
        "AffineMap",
        "NonlinearFrustumMap",
    ];
    let mut grids = Vec::new();
    for (version, map) in [219, 221].into_iter().flat_map(|v| maps.map(|map| (v, map))) {
        let kind = Kind { version, zip: true, half: false, offsets: true, buffers: 1, map };
        let bytes = make(kind);
        let file = VdbFile::read(&bytes, &ReadOptions::default()).unwrap();
        let [grid] = &file.grids[..] else { panic!("{kind:?}") };
        let transform = &grid.transform;
        assert_eq!(transform.map_type(), map);
        assert_eq!(transform.is_linear(), map != "NonlinearFrustumMap");
        for index in [DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0), DVec3::new(-70.0, 50.0, 41.0)] {
            let world = transform.world_from_index(index);
            let back = transform.index_from_world(world);
            assert!(back.abs_diff_eq(index, 1e-6), "{kind:?}: {index} went to {back}");
            if let Some(linear) = transform.linear() {
                assert!(linear.transform_point3(index).abs_diff_eq(world, 1e-6), "{kind:?}");
            }
        }
        let old = folder.join(format!("{map}-{version}.vdb"));
        let new = folder.join(format!("{map}-{version}-as-224.vdb"));
        std::fs::write(&old, &bytes).unwrap();
        file.save(&new, &WriteOptions::default()).unwrap();
        let again = VdbFile::open(&new).unwrap();
        assert_eq!(&again.grids[0].transform, transform);
        grids.push((old, new, "old".to_owned()));
    }
    openvdb::compare(&grids);
}
