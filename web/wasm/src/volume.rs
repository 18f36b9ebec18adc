//! A packed grid in the world of the page.

use glam::DVec3;
use vdb_core::pack::PackedGrid;
use vdb_core::query::{GridQuery, IndexRay};
use wasm_bindgen::prelude::*;

use crate::place::Placement;
use crate::view::Camera;

/// A packed grid in the world of the page.
#[wasm_bindgen]
#[derive(Debug)]
pub struct Volume {
    packed: PackedGrid,
    placement: Placement,
    z_is_up: bool,
}

/// What is at a pixel.
#[wasm_bindgen]
#[derive(Clone, Copy, Debug)]
pub struct Pick {
    /// The voxel, in index space.
    pub x: i32,
    /// The voxel, in index space.
    pub y: i32,
    /// The voxel, in index space.
    pub z: i32,
}

impl Volume {
    pub(crate) fn new(packed: PackedGrid, placement: Placement) -> Self {
        Self { packed, placement, z_is_up: false }
    }
}

/// The camera of three numbers for the eye, three for the point it looks at, the vertical field of view in radians,
/// and the aspect.
fn camera(numbers: &[f64]) -> Result<Camera, JsError> {
    let &[x, y, z, at_x, at_y, at_z, fov_y, aspect] = numbers else {
        return Err(JsError::new("a camera is eight numbers"));
    };
    let (eye, target) = (DVec3::new(x, y, z), DVec3::new(at_x, at_y, at_z));
    Ok(Camera { eye, target, fov_y, aspect })
}

#[wasm_bindgen]
impl Volume {
    /// Says which axis of the file points up: z, or else y.
    #[wasm_bindgen(js_name = setUp)]
    pub fn set_up(&mut self, z_is_up: bool) {
        self.z_is_up = z_is_up;
    }

    /// The low and the high corner of the box around the volume, in the page's world.
    pub fn bounds(&self) -> Vec<f64> {
        self.placement.bounds(self.z_is_up).into_iter().flat_map(|v| v.to_array()).collect()
    }

    /// The largest density of fog.
    pub fn majorant(&self) -> f32 {
        self.packed.majorant
    }

    /// The header for shaders, with the first word at 0.
    pub fn header(&self) -> Vec<u8> {
        bytemuck::bytes_of(&self.packed.header(0)).to_vec()
    }

    /// Where the words are in the module's memory, in bytes: read there, they are never copied.
    #[wasm_bindgen(js_name = wordsAt)]
    pub fn words_at(&self) -> usize {
        self.packed.words.as_ptr().addr()
    }

    /// The number of words.
    #[wasm_bindgen(js_name = wordCount)]
    pub fn word_count(&self) -> usize {
        self.packed.words.len()
    }

    /// Whether shaders need the def `VDB_WIDE_GRIDS`.
    #[wasm_bindgen(js_name = isWide)]
    pub fn is_wide(&self) -> bool {
        self.packed.is_wide()
    }

    /// The uniform `view` of `web/shaders/scene.wgsl`.
    ///
    /// # Errors
    /// If the numbers exceed the range of a shader's arithmetic.
    pub fn view(&self, numbers: &[f64]) -> Result<Vec<u8>, JsError> {
        let world_from_index = self.placement.world_from_index(self.z_is_up);
        let bounds = self.placement.bounds(self.z_is_up);
        let view = camera(numbers)?.view(&self.packed, world_from_index, bounds);
        let view = view.map_err(|why| JsError::new(&why))?;
        Ok(bytemuck::bytes_of(&view).to_vec())
    }

    /// What is at a point of the image, given in normalised device coordinates: the first voxel, or the one around
    /// the point of a smooth surface, or where the view into fog ends, at `enough` of density times distance.
    ///
    /// # Errors
    /// If the camera is not eight numbers.
    pub fn pick(
        &self,
        numbers: &[f64],
        ndc_x: f64,
        ndc_y: f64,
        enough: f64,
    ) -> Result<Option<Pick>, JsError> {
        let index_from_world = self.placement.world_from_index(self.z_is_up).inverse();
        let Some([origin, dir]) = camera(numbers)?.ray(ndc_x, ndc_y) else { return Ok(None) };
        let ray = IndexRay {
            origin: index_from_world.transform_point3(origin),
            dir: index_from_world.transform_vector3(dir.normalize()),
            t_max: f64::INFINITY,
        };
        let hit = GridQuery::of_packed(&self.packed).first_hit(&ray, enough);
        Ok(hit.map(|hit| Pick { x: hit.ijk.x, y: hit.ijk.y, z: hit.ijk.z }))
    }
}
