//! Where there is no GPU, nothing of a test runs.

use gpu_test::gpu_test;

fn has_gpu() -> bool {
    false
}

#[gpu_test]
fn the_body_is_left_out() {
    panic!("it ran");
}

mod further_down {
    use super::gpu_test;

    #[gpu_test]
    fn the_root_is_asked() {
        panic!("it ran");
    }
}
