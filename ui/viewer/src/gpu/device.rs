//! Opens a graphics adapter, and detects its loss.

use std::sync::{Arc, Mutex, PoisonError};

use crate::error::ViewError;
use crate::priority;

/// A device with its queue. Clones share it.
#[derive(Clone)]
pub struct Gpu {
    /// Enumerates adapters and creates window surfaces.
    pub instance: wgpu::Instance,
    /// The adapter.
    pub adapter: wgpu::Adapter,
    /// Creates buffers, textures, pipelines.
    pub device: wgpu::Device,
    /// Accepts work.
    pub queue: wgpu::Queue,
    lost: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Any adapter, the fastest first; software rasterisers will do.
    ///
    /// # Errors
    /// [`ViewError::NoAdapter`], [`ViewError::Refused`].
    pub fn headless() -> Result<Self, ViewError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        Self::on(instance, None)
    }

    /// An adapter that can draw on this surface, or any. Its driver's threads get a lower priority than those of the
    /// process: see [`priority`].
    ///
    /// # Errors
    /// [`ViewError::NoAdapter`], [`ViewError::Refused`].
    pub fn on(instance: wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<Self, ViewError> {
        priority::stepped_back(|| Self::request(instance, surface))
    }

    fn request(instance: wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<Self, ViewError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            force_fallback_adapter: false,
            compatible_surface: surface,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|error| ViewError::NoAdapter(error.to_string()))?;
        let refused =
            |reason: String| ViewError::Refused { adapter: adapter.get_info().name.clone(), reason };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("trocar"),
            // WebGPU's guaranteed limits, with the adapter's maximum texture size.
            required_limits: wgpu::Limits::default().using_resolution(adapter.limits()),
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| refused(error.to_string()))?;
        let lost = Arc::new(Mutex::new(None));
        let (noted, failed) = (Arc::clone(&lost), Arc::clone(&lost));
        device.set_device_lost_callback(move |reason, message| {
            note(&noted, format!("{reason:?}: {message}"));
        });
        // Without a handler an error (out of memory, an invalid shader) would panic on the drawing thread.
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            tracing::error!("graphics: {error}");
            note(&failed, error.to_string());
        }));
        Ok(Self { instance, adapter, device, queue, lost })
    }

    /// Returns an error once the device is lost.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub fn check(&self) -> Result<(), ViewError> {
        let lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner);
        lost.as_ref().map_or(Ok(()), |reason| Err(ViewError::DeviceLost(reason.clone())))
    }

    /// Whether the adapter is a software rasteriser.
    pub fn is_software(&self) -> bool {
        self.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// Name and kind of the adapter, for people.
    pub fn describe(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({:?}, {:?})", info.name, info.device_type, info.backend)
    }
}

fn note(lost: &Mutex<Option<String>>, reason: String) {
    lost.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(reason);
}
