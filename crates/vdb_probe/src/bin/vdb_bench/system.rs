//! The operating system, as a report names it.

use std::env::consts::{ARCH, OS};
use std::process::Command;

/// The name and version of the operating system, and the architecture of the processor.
pub fn operating_system() -> String {
    let version = match OS {
        "linux" => linux(),
        "macos" => {
            output("sw_vers", &["-productVersion"]).map(|version| format!("macOS {version}"))
        }
        "windows" => output("cmd", &["/C", "ver"]),
        _ => None,
    };
    format!("{}, {ARCH}", version.as_deref().unwrap_or(OS))
}

/// The distribution and the kernel.
fn linux() -> Option<String> {
    let kernel = std::fs::read_to_string("/proc/sys/kernel/osrelease").ok()?;
    let release = std::fs::read_to_string("/etc/os-release").unwrap_or_default();
    let name = release.lines().find_map(|line| line.strip_prefix("PRETTY_NAME="));
    let name = name.unwrap_or("Linux").trim_matches('"');
    Some(format!("{name}, kernel {}", kernel.trim()))
}

/// What a program prints, if it is there and succeeds.
fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    (output.status.success() && !text.is_empty()).then_some(text)
}
