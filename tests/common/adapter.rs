//! Whether pictures can be drawn here.

#![allow(dead_code, reason = "each test program uses a part of it")]

/// Whether there is a GPU; says aloud where a test is left out because there is none and the
/// environment allows that.
pub fn has_gpu() -> bool {
    let instance = wgpu::Instance::default();
    let found = bevy::tasks::block_on(instance.request_adapter(&Default::default())).is_ok();
    if !found {
        skip();
    }
    found
}

/// There is no GPU: a failure, unless the environment says that this is known.
pub fn skip() {
    assert!(
        std::env::var_os("BEVY_VDB_SKIP_GPU").is_some(),
        "no GPU adapter; install Mesa's software driver (Debian: mesa-vulkan-drivers), or set \
         BEVY_VDB_SKIP_GPU=1 to leave out these tests"
    );
    eprintln!("SKIPPED, as BEVY_VDB_SKIP_GPU says: no GPU adapter");
}
