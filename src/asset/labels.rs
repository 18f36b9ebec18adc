//! The labels of a file's grids: the part after `#` in an asset path.

use std::collections::HashSet;

use vdb_core::display::{SHOWN_CHARS, escaped};

/// A label for each name, in order: the name itself, if Bevy can find an asset by it, a log can
/// print it, and no earlier grid has it.
///
/// Bevy takes everything after the last `#` in a path as the label, rejects empty labels and those
/// with `://`, and lists all labels when an unknown one is requested. So unprintable characters are
/// [escaped](vdb_core::display::escaped), and so are `#` and the second of two slashes. Grids with
/// equal or empty labels get the next free number, counted as in OpenVDB: `density[1]`.
pub(crate) fn labels<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut taken: HashSet<String> = HashSet::new();
    // The next number for each name, so that many grids with the same name take linear time.
    let mut next = bevy::platform::collections::HashMap::<String, usize>::default();
    let mut all = Vec::new();
    for name in names {
        let shown = escaped(name).at_most(SHOWN_CHARS).to_string();
        let plain = shown.replace('#', r"\u{23}").replace("//", r"/\u{2f}");
        let mut label = plain.clone();
        let number = next.entry(plain.clone()).or_insert(usize::from(!plain.is_empty()));
        while label.is_empty() || taken.contains(&label) {
            label = format!("{plain}[{number}]");
            *number += 1;
        }
        taken.insert(label.clone());
        all.push(label);
    }
    all
}

#[cfg(test)]
mod tests {
    use bevy::asset::AssetPath;

    use super::*;

    #[test]
    fn plain_names_are_their_labels() {
        let names =
            ["density", "density[1]", "[0]", "Dichte für Rauch", "fire/core", "a b", "v1.2"];
        assert_eq!(labels(names.into_iter()), names);
    }

    #[test]
    fn every_grid_is_found_by_its_label() {
        let long = "x".repeat(10_000);
        let names = [
            "",
            "a#b",
            "http://x",
            "a",
            "a",
            "a[1]",
            "",
            "\u{1b}[2J\n",
            "\u{1b}[2J\n",
            &long,
            &long,
        ];
        let labels = labels(names.into_iter());
        assert_eq!(labels.iter().collect::<HashSet<_>>().len(), names.len(), "{labels:?}");
        for label in &labels {
            assert!(
                !label.contains(char::is_control) && label.len() < 2 * SHOWN_CHARS,
                "{label:?}"
            );
            let path = format!("smoke.vdb#{label}");
            let parsed = AssetPath::try_parse(&path).unwrap();
            assert_eq!(parsed.label(), Some(label.as_str()));
            assert_eq!(parsed.path().to_str(), Some("smoke.vdb"));
        }
        assert_eq!(labels[3..6], ["a", "a[1]", "a[1][1]"]);
    }
}
