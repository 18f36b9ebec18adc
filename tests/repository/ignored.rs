//! What `#[ignore]` means: a test that takes long, which `./scripts/test --all` and `.ci/run` run all the same.

use std::fs;
use std::path::Path;

use crate::imports::rust_files;

#[test]
fn only_slow_tests_are_ignored() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut count, mut wrong) = (0, Vec::new());
    for file in ["crates", "src", "tests"].iter().flat_map(|folder| rust_files(&root.join(folder)))
    {
        let text = fs::read_to_string(&file).expect("a file");
        let lines = text.lines().map(str::trim_start).enumerate();
        for (line, text) in lines.filter(|(_, text)| text.starts_with("#[ignore")) {
            count += 1;
            if !text.starts_with("#[ignore = \"slow: ") {
                wrong.push(format!("{}:{}: {text}", file.display(), line + 1));
            }
        }
    }
    assert!(count > 5, "{count} tests are ignored");
    assert!(wrong.is_empty(), "these would be run with the slow ones:\n{}", wrong.join("\n"));
}
