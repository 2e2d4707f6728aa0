//! Edit maps on the device: burns painted from the scene, with upload of the changed part only.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_scene::{Burn, Entity, Snapshot, SurfaceMesh, TextureCoordinates};

use crate::edit_map::{DirtyRect, EditMap, SurfaceState};
use crate::gpu::Gpu;
use crate::texture::Image8;

/// Side of a map without a base picture \[texels\].
const SIDE: u32 = 512;

/// One entity's map.
struct Edit {
    number: u64,
    map: EditMap,
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    triangles: Arc<Vec<[u32; 3]>>,
    uvs: Arc<Vec<nalgebra::Vector2<f64>>>,
    omega: Option<Arc<Vec<f64>>>,
}

/// The edit maps of all entities with [`Burn`] and texture coordinates.
#[derive(Default)]
pub struct Edits {
    maps: BTreeMap<Entity, Edit>,
    made: u64,
    /// Texels uploaded since the start.
    pub texels_sent: u64,
}

impl Edits {
    /// Follows the scene; `base` returns the initial picture of an entity, from its material's edit map.
    pub fn update(&mut self, gpu: &Gpu, scene: &Snapshot, mut base: impl FnMut(Entity) -> Option<Image8>) {
        self.maps.retain(|entity, _| scene.get::<Burn>(*entity).is_some());
        for (entity, burn) in scene.iter::<Burn>() {
            let (Some(mesh), Some(uvs)) =
                (scene.get::<SurfaceMesh>(entity), scene.get::<TextureCoordinates>(entity))
            else {
                continue;
            };
            if !self.maps.contains_key(&entity) {
                self.made += 1;
                let Some(edit) = Edit::new(gpu, self.made, base(entity)) else { continue };
                self.maps.insert(entity, edit);
            }
            let Some(edit) = self.maps.get_mut(&entity) else { continue };
            let same_surface =
                Arc::ptr_eq(&edit.triangles, &mesh.triangles) && Arc::ptr_eq(&edit.uvs, &uvs.uv);
            if !same_surface {
                edit.triangles = Arc::clone(&mesh.triangles);
                edit.uvs = Arc::clone(&uvs.uv);
                edit.map.set_surface(&edit.triangles, &edit.uvs);
            } else if edit.omega.as_ref().is_some_and(|omega| Arc::ptr_eq(omega, &burn.omega)) {
                continue;
            }
            edit.omega = Some(Arc::clone(&burn.omega));
            let state = SurfaceState { omega: Some(&burn.omega), blood: None };
            if let Some(dirty) = edit.map.paint(&state) {
                self.texels_sent += u64::from(dirty.width) * u64::from(dirty.height);
                edit.send(gpu, dirty);
            }
        }
    }

    /// The map of an entity, with a unique number.
    pub fn get(&self, entity: Entity) -> Option<(u64, &wgpu::TextureView)> {
        self.maps.get(&entity).map(|edit| (edit.number, &edit.view))
    }
}

impl Edit {
    /// `None` for a picture that exceeds the maximum size.
    fn new(gpu: &Gpu, number: u64, base: Option<Image8>) -> Option<Self> {
        let map = base.map_or_else(|| EditMap::new(SIDE, SIDE), EditMap::with_base).ok()?;
        let image = map.image();
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("edit map"),
            size: wgpu::Extent3d { width: image.width, height: image.height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        let whole = DirtyRect { x: 0, y: 0, width: image.width, height: image.height };
        let edit =
            Self { number, map, texture, view, triangles: Arc::default(), uvs: Arc::default(), omega: None };
        edit.send(gpu, whole);
        Some(edit)
    }

    fn send(&self, gpu: &Gpu, dirty: DirtyRect) {
        let image = self.map.image();
        let copy = wgpu::TexelCopyTextureInfo {
            texture: &self.texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x: dirty.x, y: dirty.y, z: 0 },
            aspect: wgpu::TextureAspect::All,
        };
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 4 * (u64::from(dirty.y) * u64::from(image.width) + u64::from(dirty.x)),
            bytes_per_row: Some(4 * image.width),
            rows_per_image: None,
        };
        let size = wgpu::Extent3d { width: dirty.width, height: dirty.height, depth_or_array_layers: 1 };
        gpu.queue.write_texture(copy, image.bytes(), layout, size);
    }
}
