//! Examples that write pictures, as people call them.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Runs an example into a picture: RGB pixels and the width. `None`, said aloud, where there is no GPU
/// and the environment allows that.
fn picture(example: &str) -> Option<(Vec<[u8; 3]>, usize)> {
    let instance = wgpu::Instance::default();
    if bevy::tasks::block_on(instance.request_adapter(&Default::default())).is_err() {
        assert!(
            std::env::var_os("BEVY_VDB_SKIP_GPU").is_some(),
            "no GPU adapter; install Mesa's software driver (Debian: mesa-vulkan-drivers), or set \
             BEVY_VDB_SKIP_GPU=1 to leave out these tests"
        );
        eprintln!("SKIPPED, as BEVY_VDB_SKIP_GPU says: no GPU adapter");
        return None;
    }
    let test = std::env::current_exe().expect("the path of this test");
    let folder = test.parent().and_then(Path::parent).expect("tests are in target/…/deps");
    let program = folder.join(format!("examples/{example}{}", std::env::consts::EXE_SUFFIX));
    assert!(program.exists(), "{}: run `cargo build --examples` first", program.display());
    let out: PathBuf = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{example}.png"));
    // That of an earlier run proves nothing.
    let _ = std::fs::remove_file(&out);
    let mut command = Command::new(program);
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("RUST_LOG");
    command.env("BEVY_ASSET_ROOT", env!("CARGO_MANIFEST_DIR"));
    let output = command.arg(&out).output().expect("the example starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !said.contains("panicked"), "{said}");
    let file = std::io::BufReader::new(std::fs::File::open(&out).expect("the picture is there"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("pixels");
    let samples = info.color_type.samples();
    let pixels = bytes[..info.buffer_size()].chunks_exact(samples);
    let pixels = pixels.map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
    Some((pixels, info.width as usize))
}

#[test]
fn smoke_and_fire_glow_and_are_mirrored() {
    let Some((pixels, width)) = picture("smoke_and_fire") else { return };
    let is_fire = |pixel: &&[u8; 3]| pixel[0] > 150 && pixel[0] / 2 > pixel[2];
    // The fire is to the left, and the floor that mirrors it below.
    let left = |rows: &[[u8; 3]]| {
        let rows = rows.chunks_exact(width).flat_map(|row| &row[..width / 2]);
        rows.filter(is_fire).count()
    };
    let height = pixels.len() / width;
    let (above, below) = pixels.split_at(height * 3 / 4 * width);
    println!("{} pixels of fire, {} of its mirror image", left(above), left(below));
    assert!(left(above) > 500, "{} pixels of fire", left(above));
    assert!(below.iter().any(|pixel| pixel[0] > 30), "the floor is dark");
    let blue = pixels.iter().filter(|pixel| pixel[2] > 100 && pixel[2] / 2 > pixel[0]).count();
    assert!(blue > 50, "{blue} pixels of the ball are blue");
}
