//! The bundled models, cooked: small, and packed already when they arrive.

use std::fs;
use std::path::Path;

use serde_json::json;
use vdb_core::VdbFile;
use vdb_core::cooked::{CookOptions, CookedFile};
use vdb_core::pack::ValueFormat;

use crate::root;

/// A way to show a bundled model.
struct Way {
    kind: &'static str,
    smooth: bool,
    format: ValueFormat,
}

/// A bundled model, by the name of its file in `assets/models`.
struct Model {
    file: &'static str,
    title: &'static str,
    ways: &'static [Way],
}

const MODELS: [Model; 2] = [
    Model {
        file: "teapot",
        title: "Utah teapot",
        ways: &[
            Way { kind: "voxels", smooth: false, format: ValueFormat::Exact },
            Way { kind: "smooth", smooth: true, format: ValueFormat::Byte },
        ],
    },
    Model {
        file: "cloud",
        title: "Cumulus",
        ways: &[Way { kind: "fog", smooth: false, format: ValueFormat::Byte }],
    },
];

/// Writes the cooked models, and `models.json` with their list.
pub fn write(folder: &Path) -> Result<(), String> {
    let mut list = Vec::new();
    for model in &MODELS {
        let path = root().join(format!("assets/models/{}.vdb", model.file));
        let file = VdbFile::open(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let mut files = serde_json::Map::new();
        for way in model.ways {
            let options =
                CookOptions { format: way.format, smooth: way.smooth, ..CookOptions::default() };
            let name = format!("{}-{}.vdbc", model.file, way.kind);
            CookedFile::cook(&file, &options)
                .and_then(|cooked| cooked.save(folder.join(&name)))
                .map_err(|error| format!("{name}: {error}"))?;
            files.insert(way.kind.into(), json!(format!("models/{name}")));
        }
        list.push(json!({ "name": model.file, "title": model.title, "files": files }));
    }
    let path = folder.join("models.json");
    fs::write(&path, json!(list).to_string())
        .map_err(|error| format!("{}: {error}", path.display()))
}
