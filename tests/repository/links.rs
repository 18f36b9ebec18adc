//! The documentation leads somewhere: links, pictures and anchors in Markdown files resolve, and paths that
//! prose, comments and scripts name exist.

use std::collections::HashMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

/// Folders of the repository. Code spans in Markdown that begin with one of them are paths.
const FOLDERS: [&str; 11] = [
    ".ci/",
    "assets/",
    "benches/",
    "crates/",
    "docs/",
    "examples/",
    "integrations/",
    "scripts/",
    "src/",
    "tests/",
    "web/",
];

/// Files whose text may name a page of the documentation.
const SOURCES: [&str; 5] = ["rs", "wgsl", "toml", "md", ""];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The files below a folder with one of these extensions, without build output and hidden folders
/// other than those that are committed.
fn files(folder: &Path, extensions: &[&str], found: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(folder).expect("a readable folder");
    let mut paths: Vec<_> = entries.map(|entry| entry.expect("an entry").path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_hidden = name.starts_with('.') && ![".ci", ".github"].contains(&&*name);
        if is_hidden || name.starts_with("target") || path.is_symlink() {
            continue;
        }
        if path.is_dir() {
            // Of what may lie at the root besides, only folders of the project count.
            let is_own = folder != root()
                || ["fuzz/", ".github/"]
                    .iter()
                    .chain(&FOLDERS)
                    .any(|own| **own == format!("{name}/"));
            if is_own {
                files(&path, extensions, found);
            }
        } else {
            let extension = path.extension().unwrap_or_default().to_string_lossy();
            if extensions.contains(&&*extension) {
                found.push(path);
            }
        }
    }
}

fn name(file: &Path) -> String {
    file.strip_prefix(root()).unwrap_or(file).display().to_string()
}

/// Markdown without fenced blocks of code.
fn prose(text: &str) -> String {
    let mut is_code = false;
    let lines = text.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        !is_fence && !is_code
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// The code spans of prose.
fn spans(prose: &str) -> impl Iterator<Item = &str> {
    prose.lines().flat_map(|line| line.split('`').skip(1).step_by(2))
}

/// Prose without code spans.
fn plain(prose: &str) -> String {
    let lines = prose.lines().map(|line| line.split('`').step_by(2).collect::<Vec<_>>().join("`"));
    lines.collect::<Vec<_>>().join("\n")
}

/// The targets of links and pictures: `](…)`, `src="…"` and `href="…"`.
fn targets(plain: &str) -> Vec<String> {
    let mut targets = Vec::new();
    for (open, close) in [("](", ')'), ("src=\"", '"'), ("href=\"", '"')] {
        for (at, _) in plain.match_indices(open) {
            let rest = &plain[at + open.len()..];
            targets.extend(rest.split(close).next().map(str::to_owned));
        }
    }
    targets
}

/// The anchors that GitHub gives to the headings of a page.
fn anchors(text: &str) -> Vec<String> {
    let mut counts = HashMap::new();
    let prose = prose(text);
    let headings = prose.lines().filter(|line| line.starts_with('#'));
    headings
        .map(|line| {
            let heading = line.trim_start_matches('#').trim().to_lowercase();
            let kept = heading.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
            let anchor: String = kept.map(|c| if c == ' ' { '-' } else { c }).collect();
            let count = counts.entry(anchor.clone()).or_insert(0);
            *count += 1;
            if *count == 1 { anchor } else { format!("{anchor}-{}", *count - 1) }
        })
        .collect()
}

/// Whether a path exists, without leaving the repository.
fn exists(path: &Path) -> bool {
    let mut resolved = PathBuf::new();
    for component in path.components() {
        match component {
            Component::ParentDir => {
                resolved.pop();
            }
            other => resolved.push(other),
        }
    }
    resolved.starts_with(root()) && resolved.exists()
}

/// `a/{b,c}.rs` as `a/b.rs` and `a/c.rs`.
fn expand(path: &str) -> Vec<String> {
    let Some((before, rest)) = path.split_once('{') else { return vec![path.to_owned()] };
    let Some((choices, after)) = rest.split_once('}') else { return vec![path.to_owned()] };
    choices.split(',').flat_map(|choice| expand(&format!("{before}{choice}{after}"))).collect()
}

/// The paths that a code span names: those of the repository, up to a space.
fn paths(span: &str) -> Vec<String> {
    let path = span.trim_start_matches("./").split_whitespace().next().unwrap_or_default();
    let is_exact = !path.contains(['*', '…', '<', '$']);
    let is_own = FOLDERS.iter().any(|folder| path.starts_with(folder));
    if is_own && is_exact { expand(path) } else { Vec::new() }
}

/// The pages that a source names: `docs/….md`.
fn pages(text: &str) -> Vec<String> {
    let pages = text.match_indices("docs/").filter_map(|(at, _)| {
        let before = text[..at].chars().next_back();
        let is_own = before.is_none_or(|c| !c.is_alphanumeric() && !"/.:".contains(c));
        let is_part = |c: char| c.is_ascii_alphanumeric() || "/_-.".contains(c);
        let page: String = text[at..].chars().take_while(|&c| is_part(c)).collect();
        (is_own && page.ends_with(".md")).then_some(page)
    });
    pages.collect()
}

#[test]
fn links_and_anchors_resolve() {
    let mut markdown = Vec::new();
    files(root(), &["md"], &mut markdown);
    assert!(markdown.len() > 20, "{markdown:?}");
    let (mut count, mut broken) = (0, Vec::new());
    for file in &markdown {
        let text = fs::read_to_string(file).expect("readable text");
        for target in targets(&plain(&prose(&text))) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            count += 1;
            let (path, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let to =
                if path.is_empty() { file.clone() } else { file.with_file_name("").join(path) };
            let leads = exists(&to)
                && (anchor.is_empty()
                    || fs::read_to_string(&to)
                        .is_ok_and(|page| anchors(&page).iter().any(|own| own == anchor)));
            if !leads {
                broken.push(format!("{}: {target}", name(file)));
            }
        }
    }
    assert!(count > 100, "{count} links");
    assert!(broken.is_empty(), "these lead nowhere:\n{}", broken.join("\n"));
}

#[test]
fn paths_in_code_spans_exist() {
    let mut markdown = Vec::new();
    files(root(), &["md"], &mut markdown);
    // The changelog names what there was.
    markdown.retain(|file| !file.ends_with("CHANGELOG.md"));
    let (mut count, mut missing) = (0, Vec::new());
    for file in &markdown {
        let text = prose(&fs::read_to_string(file).expect("readable text"));
        for path in spans(&text).flat_map(paths) {
            count += 1;
            // Relative to the repository, or to the crate that the page belongs to.
            let mut folders =
                file.ancestors().skip(1).take_while(|folder| folder.starts_with(root()));
            if !folders.any(|folder| exists(&folder.join(&path))) {
                missing.push(format!("{}: {path}", name(file)));
            }
        }
    }
    assert!(count > 100, "{count} paths");
    assert!(missing.is_empty(), "these do not exist:\n{}", missing.join("\n"));
}

#[test]
fn pages_that_sources_name_exist() {
    let mut sources = Vec::new();
    files(root(), &SOURCES, &mut sources);
    let own = root().join(file!());
    let (mut count, mut missing) = (0, Vec::new());
    for file in sources.iter().filter(|file| **file != own) {
        // Files without an extension may be anything.
        let Ok(text) = fs::read_to_string(file) else { continue };
        for page in pages(&text) {
            count += 1;
            if !exists(&root().join(&page)) {
                missing.push(format!("{}: {page}", name(file)));
            }
        }
    }
    assert!(count > 20, "{count} pages");
    assert!(missing.is_empty(), "these do not exist:\n{}", missing.join("\n"));
}

#[test]
fn markdown_is_understood() {
    let text = "# One `two`\n[a](b.md#c-d) `x](y)` <img src=\"p.png\">\n```sh\n# [no](no)\n```\n## A, b: c\n# One two";
    assert_eq!(anchors(text), ["one-two", "a-b-c", "one-two-1"]);
    assert_eq!(targets(&plain(&prose(text))), ["b.md#c-d", "p.png"]);
    assert_eq!(spans(&prose(text)).collect::<Vec<_>>(), ["two", "x](y)"]);
    assert_eq!(paths("./scripts/view FILE.vdb"), ["scripts/view"]);
    assert_eq!(paths("src/{a,b}/c.rs"), ["src/a/c.rs", "src/b/c.rs"]);
    assert!(paths("src/*.rs").is_empty() && paths("tree/").is_empty());
    assert_eq!(pages("`docs/guide/a.md`, https://x/docs/b.md"), ["docs/guide/a.md"]);
}
