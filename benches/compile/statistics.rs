//! What the driver says about the machine code of a shader: registers, spilled memory, and size, where it has
//! `VK_KHR_pipeline_executable_properties`.

#![expect(unsafe_code, reason = "Vulkan itself: wgpu does not offer these statistics")]

use std::error::Error;
use std::ffi::CStr;

use ash::khr::pipeline_executable_properties as executables;
use ash::vk;
use wgpu::naga::back::spv;
use wgpu::naga::valid::{Capabilities, ValidationFlags, Validator};
use wgpu::naga::{AddressSpace, ImageClass, Module, ShaderStage, TypeInner};

/// A device of Vulkan's, for pipelines that are never run.
pub struct Driver {
    device: ash::Device,
    executables: executables::Device,
    instance: ash::Instance,
    _library: ash::Entry,
    pub name: String,
}

impl Driver {
    /// The first adapter that can give statistics.
    pub fn new() -> Result<Self, Box<dyn Error>> {
        // SAFETY: the loader of Vulkan is a library that may be loaded.
        let library = unsafe { ash::Entry::load()? };
        let app = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_3);
        let descriptor = vk::InstanceCreateInfo::default().application_info(&app);
        // SAFETY: both live during the call.
        let instance = unsafe { library.create_instance(&descriptor, None)? };
        // SAFETY: the instance is valid.
        let adapters = unsafe { instance.enumerate_physical_devices()? };
        let adapter = adapters.into_iter().find(|adapter| {
            // SAFETY: the adapter is the instance's.
            let extensions = unsafe { instance.enumerate_device_extension_properties(*adapter) };
            let mut extensions = extensions.unwrap_or_default().into_iter();
            extensions.any(|own| own.extension_name_as_c_str() == Ok(executables::NAME))
        });
        let Some(adapter) = adapter else {
            // SAFETY: nothing else has been made of the instance.
            unsafe { instance.destroy_instance(None) };
            return Err("no adapter has VK_KHR_pipeline_executable_properties".into());
        };
        // SAFETY: the adapter is the instance's.
        let (properties, features) = unsafe {
            let properties = instance.get_physical_device_properties(adapter);
            (properties, instance.get_physical_device_features(adapter))
        };
        let mut statistics = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default()
            .pipeline_executable_info(true);
        let queues = [vk::DeviceQueueCreateInfo::default().queue_priorities(&[1.0])];
        let extensions = [executables::NAME.as_ptr()];
        let descriptor = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&extensions)
            .enabled_features(&features)
            .push_next(&mut statistics);
        // SAFETY: every adapter has a first family of queues, and this one the extension.
        let device = unsafe { instance.create_device(adapter, &descriptor, None)? };
        let executables = executables::Device::new(&instance, &device);
        let name = properties.device_name_as_c_str().unwrap_or_default().to_string_lossy().into();
        Ok(Self { device, executables, instance, _library: library, name })
    }

    /// Names and values for the pipeline of a shader's entry point `trace`.
    pub fn statistics(&self, module: &Module) -> Result<Vec<(String, u64)>, Box<dyn Error>> {
        let words = spirv(module)?;
        let layouts = bindings(module);
        let device = &self.device;
        // SAFETY: all that is made here comes from this device, is complete when it is used, and is destroyed only at
        // the end. After an error it is left to the process, which ends.
        unsafe {
            let mut sets = Vec::new();
            for set in &layouts {
                let descriptor = vk::DescriptorSetLayoutCreateInfo::default().bindings(set);
                sets.push(device.create_descriptor_set_layout(&descriptor, None)?);
            }
            let descriptor = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets);
            let layout = device.create_pipeline_layout(&descriptor, None)?;
            let descriptor = vk::ShaderModuleCreateInfo::default().code(&words);
            let shader = device.create_shader_module(&descriptor, None)?;
            let stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(shader)
                .name(c"trace");
            let descriptor = vk::ComputePipelineCreateInfo::default()
                .flags(vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR)
                .stage(stage)
                .layout(layout);
            let made =
                device.create_compute_pipelines(vk::PipelineCache::null(), &[descriptor], None);
            let pipeline = made.map_err(|(_, error)| error)?[0];
            let info = vk::PipelineInfoKHR::default().pipeline(pipeline);
            let count = self.executables.get_pipeline_executable_properties(&info)?.len() as u32;
            let mut found = Vec::new();
            for index in 0..count {
                let info = vk::PipelineExecutableInfoKHR::default()
                    .pipeline(pipeline)
                    .executable_index(index);
                for own in self.executables.get_pipeline_executable_statistics(&info)? {
                    let name = CStr::to_string_lossy(own.name_as_c_str().unwrap_or_default());
                    let value = match own.format {
                        vk::PipelineExecutableStatisticFormatKHR::BOOL32 => own.value.b32.into(),
                        vk::PipelineExecutableStatisticFormatKHR::FLOAT64 => own.value.f64 as u64,
                        _ => own.value.u64,
                    };
                    found.push((name.into_owned(), value));
                }
            }
            device.destroy_pipeline(pipeline, None);
            device.destroy_shader_module(shader, None);
            device.destroy_pipeline_layout(layout, None);
            sets.into_iter().for_each(|set| device.destroy_descriptor_set_layout(set, None));
            Ok(found)
        }
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        // SAFETY: nothing is left of what was made of them.
        unsafe {
            self.device.destroy_device(None);
            self.instance.destroy_instance(None);
        }
    }
}

/// A shader as wgpu would give it to the driver, without checks.
fn spirv(module: &Module) -> Result<Vec<u32>, Box<dyn Error>> {
    let info = Validator::new(ValidationFlags::all(), Capabilities::all()).validate(module)?;
    let options =
        spv::Options { lang_version: (1, 3), force_loop_bounding: false, ..Default::default() };
    let entry =
        spv::PipelineOptions { shader_stage: ShaderStage::Compute, entry_point: "trace".into() };
    Ok(spv::write_vec(module, &info, &options, Some(&entry))?)
}

/// The bindings of each group of a shader.
fn bindings(module: &Module) -> Vec<Vec<vk::DescriptorSetLayoutBinding<'static>>> {
    let mut groups = Vec::new();
    for (_, global) in module.global_variables.iter() {
        let Some(place) = &global.binding else { continue };
        let kind = match (global.space, &module.types[global.ty].inner) {
            (AddressSpace::Uniform, _) => vk::DescriptorType::UNIFORM_BUFFER,
            (AddressSpace::Storage { .. }, _) => vk::DescriptorType::STORAGE_BUFFER,
            (_, TypeInner::Sampler { .. }) => vk::DescriptorType::SAMPLER,
            (_, TypeInner::Image { class: ImageClass::Storage { .. }, .. }) => {
                vk::DescriptorType::STORAGE_IMAGE
            }
            _ => vk::DescriptorType::SAMPLED_IMAGE,
        };
        let binding = vk::DescriptorSetLayoutBinding::default()
            .binding(place.binding)
            .descriptor_type(kind)
            .descriptor_count(1)
            .stage_flags(vk::ShaderStageFlags::COMPUTE);
        let group = place.group as usize;
        groups.resize_with(groups.len().max(group + 1), Vec::new);
        groups[group].push(binding);
    }
    groups
}
