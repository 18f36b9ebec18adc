//! Data flows one way: the files of a crate import each other in no circle, and each stage imports only from
//! the stages before it.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The stages of the crate, each of which may import from those before it.
const STAGES: [&str; 20] = [
    "asset",
    "scene",
    "quality",
    "pages",
    "render::gpu",
    "render::extract",
    "render::pool",
    "render::view",
    "render::light_cache",
    "render::scattered_light",
    "render::trace",
    "render::denoise",
    "render::upscale",
    "render::accumulate",
    "render::shadow_maps",
    "render::fog_shadows",
    "render::composite",
    "render::report",
    "render::drawn",
    "plugin",
];

/// The modules of a crate: by path (`render::gpu`, the root is empty) what each imports, and what it
/// passes on under which name.
#[derive(Default)]
struct Modules {
    imports: BTreeMap<String, Vec<String>>,
    exports: BTreeMap<String, BTreeMap<String, String>>,
}

impl Modules {
    /// Reads the files under a `src`.
    fn read(src: &Path) -> Self {
        let mut modules = Self::default();
        for file in rust_files(src) {
            let relative = file.strip_prefix(src).expect("a file of the folder");
            let mut parts: Vec<_> = relative
                .with_extension("")
                .iter()
                .map(|part| part.to_string_lossy().into_owned())
                .collect();
            if parts[0] == "bin" || parts == ["main"] {
                continue;
            }
            if matches!(parts.last().map(String::as_str), Some("mod" | "lib")) {
                parts.pop();
            }
            modules.add(&parts.join("::"), &code_of(&fs::read_to_string(&file).expect("a file")));
        }
        modules
    }

    fn add(&mut self, module: &str, code: &str) {
        let (mut imports, mut exports) = (Vec::new(), BTreeMap::new());
        let mut rest = String::new();
        let mut at = 0;
        while let Some(found) = find_word(&code[at..], "use") {
            let start = at + found;
            rest.push_str(&code[at..start]);
            // The word in a message is no import, and a message ends with a quotation mark.
            let end = start + code[start..].find([';', '"']).expect("the end of an import");
            if code[end..].starts_with('"') {
                rest.push_str(&code[start..end]);
                at = end;
                continue;
            }
            for (path, name) in expand(&code[start + 3..end]) {
                exports.entry(name).or_insert(path.clone());
                imports.push(path);
            }
            at = end;
        }
        rest.push_str(&code[at..]);
        imports.extend(inline_paths(&rest));
        self.imports.insert(module.to_owned(), imports);
        self.exports.insert(module.to_owned(), exports);
    }

    /// The module that has what a path in a module names; what is passed on is looked for where it comes
    /// from. `None` for other crates.
    fn owner(&self, module: &str, path: &str, depth: u32) -> Option<String> {
        let path = self.absolute(module, path)?;
        let mut module = String::new();
        for (i, part) in path.iter().enumerate() {
            let child = join(&module, part);
            if self.imports.contains_key(&child) {
                module = child;
                continue;
            }
            let Some(further) = self.exports.get(&module).and_then(|exports| exports.get(part))
            else {
                return Some(module);
            };
            let target =
                [further.as_str()].into_iter().chain(path[i + 1..].iter().map(String::as_str));
            let target = target.collect::<Vec<_>>().join("::");
            return if depth < 8 { self.owner(&module, &target, depth + 1) } else { None };
        }
        Some(module)
    }

    /// A path from the root of the crate; `None` if it begins in another crate.
    fn absolute(&self, module: &str, path: &str) -> Option<Vec<String>> {
        let mut at: Vec<&str> = module.split("::").filter(|part| !part.is_empty()).collect();
        let mut parts: Vec<&str> = path.split("::").filter(|part| !part.is_empty()).collect();
        match parts.first() {
            Some(&"crate") => {
                at.clear();
                parts.remove(0);
            }
            Some(&"self") => {
                parts.remove(0);
            }
            Some(&"super") => {
                while parts.first() == Some(&"super") {
                    parts.remove(0);
                    at.pop();
                }
            }
            Some(first) if self.imports.contains_key(&join(module, first)) => {}
            _ => return None,
        }
        Some(at.into_iter().chain(parts).map(str::to_owned).collect())
    }

    /// What each module imports from.
    fn edges(&self) -> BTreeMap<String, BTreeSet<String>> {
        let edges = self.imports.iter().map(|(module, paths)| {
            let owners = paths.iter().filter_map(|path| self.owner(module, path, 0));
            (module.clone(), owners.filter(|owner| owner != module).collect())
        });
        edges.collect()
    }
}

pub fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    files
}

/// Source text without comments, and without the tests at its end.
pub fn code_of(text: &str) -> String {
    let end = text.find("#[cfg(test)]\nmod ").unwrap_or(text.len());
    let lines = text[..end].lines();
    lines.map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n")
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Where a word stands alone.
fn find_word(text: &str, word: &str) -> Option<usize> {
    text.match_indices(word).map(|(at, _)| at).find(|&at| {
        let before = text[..at].chars().next_back();
        let after = text[at + word.len()..].chars().next();
        !before.is_some_and(|c| is_word(c) || c == '\'') && after.is_some_and(char::is_whitespace)
    })
}

/// The paths of an import with braces, each with the name that it gets.
fn expand(tree: &str) -> Vec<(String, String)> {
    let tree = tree.trim();
    if let Some(open) = tree.find('{') {
        let prefix = tree[..open].trim();
        let inner = tree[open + 1..].trim_end().strip_suffix('}').unwrap_or(&tree[open + 1..]);
        let mut parts = Vec::new();
        let (mut depth, mut start) = (0, 0);
        for (i, c) in inner.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    parts.push(&inner[start..i]);
                    start = i + 1;
                }
                _ => {}
            }
        }
        parts.push(&inner[start..]);
        let whole = parts.into_iter().filter(|part| !part.trim().is_empty());
        return whole.flat_map(|part| expand(&format!("{prefix}{}", part.trim()))).collect();
    }
    let (path, name) = match tree.split_once(" as ") {
        Some((path, name)) => (path.trim(), name.trim()),
        None => (tree, tree.rsplit("::").next().unwrap_or(tree)),
    };
    let path = path.strip_suffix("::self").unwrap_or(path);
    let name = if name == "self" { path.rsplit("::").next().unwrap_or(path) } else { name };
    vec![(path.to_owned(), name.to_owned())]
}

/// Paths in the code that begin in the crate.
fn inline_paths(code: &str) -> Vec<String> {
    let mut paths = Vec::new();
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(start) {
            if code[..at].chars().next_back().is_some_and(|c| is_word(c) || c == ':' || c == '$') {
                continue;
            }
            let path: String = code[at..].chars().take_while(|&c| is_word(c) || c == ':').collect();
            paths.push(path.trim_end_matches(':').to_owned());
        }
    }
    paths
}

fn join(module: &str, part: &str) -> String {
    if module.is_empty() { part.to_owned() } else { format!("{module}::{part}") }
}

/// The groups of modules that import each other in circles.
fn circles(edges: &BTreeMap<String, BTreeSet<String>>) -> Vec<Vec<&str>> {
    let reached = |from: &str| {
        let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(at) = open.pop() {
            for next in edges.get(at).into_iter().flatten() {
                if reached.insert(next.as_str()) {
                    open.push(next);
                }
            }
        }
        reached
    };
    let reached: BTreeMap<&str, _> = edges.keys().map(|at| (at.as_str(), reached(at))).collect();
    let mut circles: Vec<Vec<&str>> = Vec::new();
    for (at, own) in &reached {
        if own.contains(at) && !circles.iter().flatten().any(|known| known == at) {
            let mutual = own.iter().filter(|other| reached[**other].contains(at));
            circles.push(mutual.copied().collect());
        }
    }
    circles
}

/// The crates, by name and folder of sources.
fn sources() -> Vec<(String, PathBuf)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let crates = fs::read_dir(root.join("crates")).expect("the crates");
    let crates = crates.map(|entry| {
        let entry = entry.expect("a crate");
        (entry.file_name().to_string_lossy().into_owned(), entry.path().join("src"))
    });
    [("bevy_vdb".to_owned(), root.join("src"))].into_iter().chain(crates).collect()
}

#[test]
fn files_import_each_other_in_no_circle() {
    let mut files = 0;
    for (name, src) in sources() {
        let modules = Modules::read(&src);
        files += modules.imports.len();
        let edges = modules.edges();
        let circles: Vec<_> = circles(&edges).iter().map(|circle| circle.join(", ")).collect();
        assert_eq!(circles, Vec::<String>::new(), "in {name}");
    }
    assert!(files > 100, "{files} files");
}

#[test]
fn stages_import_from_those_before_them_alone() {
    let edges = Modules::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src")).edges();
    let stage = |module: &str| {
        STAGES.iter().position(|own| module == *own || module.starts_with(&format!("{own}::")))
    };
    for stage in STAGES {
        assert!(edges.keys().any(|module| module.starts_with(stage)), "there is no {stage}");
    }
    let has_stage =
        |module: &str| ["", "prelude", "render"].contains(&module) || stage(module).is_some();
    for module in edges.keys() {
        assert!(has_stage(module), "{module} belongs to no stage");
    }
    let mut upward = Vec::new();
    for (module, imports) in &edges {
        for import in imports {
            if let (Some(own), Some(other)) = (stage(module), stage(import))
                && other > own
            {
                upward.push(format!("{module} imports from {import}"));
            }
        }
    }
    assert!(upward.is_empty(), "{}", upward.join("\n"));
}

#[test]
fn circles_and_paths_are_found() {
    let mut modules = Modules::default();
    modules.add("", "mod a; mod b; pub use a::{Apple, seeds::{self, Seed}};");
    modules.add("a", "use crate::b::Basket; pub struct Apple;");
    modules.add("a::seeds", "pub struct Seed;");
    modules
        .add("b", "use super::{Seed, seeds as s}; fn f() { let _ = crate::Apple; g(\"; use b\") }");
    let edges = modules.edges();
    let of = |module: &str| edges[module].iter().map(String::as_str).collect::<Vec<_>>();
    assert_eq!(of("a"), ["b"]);
    assert_eq!(of("b"), ["a", "a::seeds"]);
    assert_eq!(circles(&edges), [["a", "b"]]);
}
