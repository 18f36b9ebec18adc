//! How long the driver takes to compile the trace when it has no cache, as at the first start of an app.
//! And what the driver says about the code that comes out of it. Results are in `docs/internals/notebook.md`, "What drivers compile".

#[path = "../../tests/gpu/compose.rs"]
mod compose;
#[path = "../../tests/common/headless.rs"]
mod headless;
mod statistics;

use std::borrow::Cow;
use std::error::Error;
use std::time::Instant;

use bevy::tasks::block_on;
use wgpu::{
    ComputePipelineDescriptor, DeviceDescriptor, Features, Instance, InstanceDescriptor,
    RequestAdapterOptions, ShaderModuleDescriptor, ShaderRuntimeChecks, ShaderSource,
};

const HELP: &str = "\
compile [--statistics] [DEFS…]
Seconds that the driver takes to compile the trace with sets of shader defs. Drivers keep what they compile: set
__GL_SHADER_DISK_CACHE=0 for NVIDIA's, MESA_SHADER_CACHE_DISABLE=true for Mesa's.

  --statistics
          instead of seconds, what the driver says about the machine code, such as registers; not all drivers do
  DEFS    names separated by spaces, as one argument; without any, eight views of growing content

The variable VDB_SHADERS names a folder with other shaders than the repository's, to compare the two.
";

/// Views of growing content.
const VIEWS: [(&str, &str); 8] = [
    ("voxels, no light", "VDB_SURFACES VDB_SHOW_GRAY"),
    ("smooth surface, a sun", "VDB_LIT VDB_SMOOTH VDB_SMOOTH_NORMALS VDB_BEAMS"),
    (
        "the same with shadows",
        "VDB_LIT VDB_SMOOTH VDB_SMOOTH_NORMALS VDB_BEAMS VDB_SHADOWS SHADOW_FILTER_METHOD_GAUSSIAN",
    ),
    (
        "the same with lamps and an environment",
        "VDB_LIT VDB_SMOOTH VDB_SMOOTH_NORMALS VDB_BEAMS VDB_SHADOWS SHADOW_FILTER_METHOD_GAUSSIAN \
         VDB_LOCAL_LIGHTS ENVIRONMENT_MAP",
    ),
    (
        "the same with reflections",
        "VDB_LIT VDB_SMOOTH VDB_SMOOTH_NORMALS VDB_BEAMS VDB_SHADOWS SHADOW_FILTER_METHOD_GAUSSIAN \
         VDB_LOCAL_LIGHTS ENVIRONMENT_MAP VDB_REFLECTIONS",
    ),
    (
        "fog in the sun",
        "VDB_LIT VDB_FOGS VDB_SHADOWS SHADOW_FILTER_METHOD_GAUSSIAN VDB_LIGHT_CACHE VDB_MULTIPLE_SCATTERING \
         VDB_SCATTERED VDB_FOG_SLOTS=1 VDB_EMITTER_SLOTS=1 VDB_CACHED_SUNS=1 VDB_BEAMS",
    ),
    (
        "fire in smoke, a sun",
        "VDB_LIT VDB_FOGS VDB_EMISSION VDB_BLACKBODY VDB_EMITS VDB_SHADOWS SHADOW_FILTER_METHOD_GAUSSIAN \
         VDB_LIGHT_CACHE VDB_MULTIPLE_SCATTERING VDB_SCATTERED VDB_FOG_SLOTS=1 VDB_EMITTER_SLOTS=1 \
         VDB_CACHED_SUNS=1 VDB_BEAMS",
    ),
    ("examples/smoke_and_fire", compose::SMOKE_AND_FIRE),
];

/// The seconds of a pipeline.
#[expect(
    unsafe_code,
    reason = "wgpu has no other way to leave out checks, as Bevy does for the plugin's shaders"
)]
fn seconds(device: &wgpu::Device, module: &naga::Module) -> f64 {
    let start = Instant::now();
    let source = ShaderSource::Naga(Cow::Owned(module.clone()));
    let descriptor = ShaderModuleDescriptor { label: None, source };
    // SAFETY: the shader is never run.
    let module = unsafe {
        device.create_shader_module_trusted(descriptor, ShaderRuntimeChecks::unchecked())
    };
    drop(device.create_compute_pipeline(&ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("trace"),
        compilation_options: Default::default(),
        cache: None,
    }));
    start.elapsed().as_secs_f64()
}

fn main() -> Result<(), Box<dyn Error>> {
    let own = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let (options, own): (Vec<String>, Vec<String>) = own.partition(|own| own.starts_with("--"));
    let views: Vec<(&str, &str)> = match own.is_empty() {
        true => VIEWS.to_vec(),
        false => own.iter().map(|defs| (defs.as_str(), defs.as_str())).collect(),
    };
    match options.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => print_seconds(&views),
        ["--statistics"] => print_statistics(&views),
        ["--help"] => {
            print!("{HELP}");
            Ok(())
        }
        _ => Err(format!("no option {}; --help lists them", options.join(" ")).into()),
    }
}

/// Calls `with` with the name and the shader of each view.
fn for_each_shader(
    views: &[(&str, &str)],
    mut with: impl FnMut(&str, &naga::Module) -> Result<(), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    let mut composer = compose::composer();
    views.iter().try_for_each(|(name, defs)| {
        let defs: Vec<&str> = defs.split_whitespace().collect();
        with(name, &compose::composed(&mut composer, "trace/trace", &defs))
    })
}

fn print_statistics(views: &[(&str, &str)]) -> Result<(), Box<dyn Error>> {
    let driver = statistics::Driver::new()?;
    println!("{}", driver.name);
    for_each_shader(views, |name, shader| {
        let found = driver.statistics(shader)?;
        let found: Vec<_> = found.iter().map(|(what, n)| format!("{what} {n}")).collect();
        println!("{}  {name}", found.join(", "));
        Ok(())
    })
}

fn print_seconds(views: &[(&str, &str)]) -> Result<(), Box<dyn Error>> {
    let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
    let adapter = block_on(instance.request_adapter(&RequestAdapterOptions::default()))?;
    println!("{}", adapter.get_info().name);
    let descriptor = DeviceDescriptor {
        required_features: adapter.features() & !Features::all_experimental_mask(),
        required_limits: adapter.limits(),
        ..Default::default()
    };
    let (device, _queue) = block_on(adapter.request_device(&descriptor))?;
    for_each_shader(views, |name, shader| {
        println!("{:8.2} s  {name}", seconds(&device, shader));
        Ok(())
    })
}
