//! Textures of materials on the device.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use trocar_scene::{Texture, VisualMaterial};
use wgpu::util::DeviceExt;

use crate::edit_map::SIZE_MAX;
use crate::gpu::{Gpu, passes};
use crate::texture::{self, Image8, MapKind, MapSet};

/// Side of procedural textures \[texels\].
const PROCEDURAL_SIDE: u32 = 512;
/// Largest file of a shader \[bytes\].
const SHADER_BYTES_MAX: u64 = 256 * 1024;

/// What a map is for: that decides how its bytes are read, and what stands in for one that is not there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Colours, sRGB.
    Color,
    /// Directions.
    Normal,
    /// Burns, blood, cuts.
    Edit,
    /// Roughness, wetness, metalness, occlusion by default.
    Free,
}

impl Role {
    const ALL: [Self; 4] = [Self::Color, Self::Normal, Self::Edit, Self::Free];

    fn of(self, material: &VisualMaterial) -> Option<&Texture> {
        match self {
            Self::Color => material.color_map.as_ref(),
            Self::Normal => material.normal_map.as_ref(),
            Self::Edit => material.edit_map.as_ref(),
            Self::Free => material.free_map.as_ref(),
        }
    }
    fn format(self) -> wgpu::TextureFormat {
        match self {
            Self::Color => wgpu::TextureFormat::Rgba8UnormSrgb,
            _ => wgpu::TextureFormat::Rgba8Unorm,
        }
    }
    /// Which map of a procedural texture it is.
    fn of_set(self, set: &MapSet) -> &Image8 {
        match self {
            Self::Color | Self::Edit => &set.color,
            Self::Normal => &set.normal,
            Self::Free => &set.surface,
        }
    }
    fn kind(self) -> MapKind {
        match self {
            Self::Color => MapKind::Color,
            Self::Normal => MapKind::Normal,
            Self::Edit | Self::Free => MapKind::Linear,
        }
    }
    /// The one pixel of a map that changes nothing.
    fn neutral(self) -> [u8; 4] {
        match self {
            Self::Color | Self::Free => [255; 4],
            Self::Normal => [128, 128, 255, 255],
            Self::Edit => [0, 0, 0, 255],
        }
    }
}

/// The maps of a material, bound together.
pub struct Materials {
    /// Layout of the group.
    pub layout: wgpu::BindGroupLayout,
    tiled: wgpu::Sampler,
    single: wgpu::Sampler,
    neutral: BTreeMap<Role, wgpu::TextureView>,
    textures: BTreeMap<(Role, String), wgpu::TextureView>,
    /// With whether they were asked for lately.
    groups: BTreeMap<String, (wgpu::BindGroup, bool)>,
    /// Folder below which files of textures are.
    folder: Option<PathBuf>,
    /// Procedural textures: each gives several maps.
    sets: BTreeMap<String, MapSet>,
    /// Shaders of materials by file; `None` for one that cannot be used, which was told.
    shaders: BTreeMap<String, Option<String>>,
}

impl Materials {
    /// Without any; `folder` is the scenario's.
    pub fn new(gpu: &Gpu, folder: Option<PathBuf>) -> Self {
        let texture = |binding| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: true },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        };
        let sampler = |binding| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
            count: None,
        };
        let entries = [texture(0), texture(1), texture(2), texture(3), sampler(4), sampler(5)];
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("material"), entries: &entries };
        let layout = gpu.device.create_bind_group_layout(&descriptor);
        let sampler = |mode| {
            gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                address_mode_u: mode,
                address_mode_v: mode,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                mipmap_filter: wgpu::MipmapFilterMode::Linear,
                ..Default::default()
            })
        };
        let neutral =
            Role::ALL.map(|role| (role, upload(gpu, role.format(), &[Image8::filled(1, 1, role.neutral())])));
        Self {
            layout,
            tiled: sampler(wgpu::AddressMode::Repeat),
            single: sampler(wgpu::AddressMode::ClampToEdge),
            neutral: neutral.into(),
            textures: BTreeMap::new(),
            groups: BTreeMap::new(),
            folder,
            sets: BTreeMap::new(),
            shaders: BTreeMap::new(),
        }
    }

    /// Loads what a material needs, with the entity's own edit map if it has one; the key of its group.
    pub fn send(
        &mut self,
        gpu: &Gpu,
        material: &VisualMaterial,
        edit: Option<(u64, &wgpu::TextureView)>,
    ) -> String {
        let mut key =
            Role::ALL.map(|role| role.of(material).map_or(String::new(), |map| format!("{map:?}"))).join("|");
        if let Some((number, _)) = edit {
            key = format!("{key}|{number}");
        }
        if let Some((_, used)) = self.groups.get_mut(&key) {
            *used = true;
            return key;
        }
        for role in Role::ALL {
            if let Some(map) = role.of(material) {
                self.load(gpu, role, map);
            }
        }
        let view = |role: Role| {
            let loaded = role.of(material).and_then(|map| self.textures.get(&(role, format!("{map:?}"))));
            let own = edit.filter(|_| role == Role::Edit).map(|(_, view)| view);
            own.or(loaded).unwrap_or(&self.neutral[&role])
        };
        let views = Role::ALL.map(view);
        let binding = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("material"),
            layout: &self.layout,
            entries: &[
                binding(0, wgpu::BindingResource::TextureView(views[0])),
                binding(1, wgpu::BindingResource::TextureView(views[1])),
                binding(2, wgpu::BindingResource::TextureView(views[2])),
                binding(3, wgpu::BindingResource::TextureView(views[3])),
                binding(4, wgpu::BindingResource::Sampler(&self.tiled)),
                binding(5, wgpu::BindingResource::Sampler(&self.single)),
            ],
        });
        self.groups.insert(key.clone(), (group, true));
        key
    }

    /// Forgets the groups that have not been sent since the last call; their textures are kept.
    pub fn sweep(&mut self) {
        self.groups.retain(|_, (_, used)| std::mem::take(used));
    }

    /// What a material's own edit map shows.
    pub fn edit_picture(&self, material: &VisualMaterial) -> Option<Image8> {
        match material.edit_map.as_ref()? {
            Texture::Procedural(name) => texture::procedural(name, PROCEDURAL_SIDE).ok().map(|set| set.color),
            Texture::File(file) => texture::resolve(self.folder.as_deref().unwrap_or(Path::new("")), file)
                .and_then(|file| texture::load(&file, SIZE_MAX))
                .ok(),
        }
    }

    /// The group of a material that was sent.
    pub fn group(&self, key: &str) -> Option<&wgpu::BindGroup> {
        self.groups.get(key).map(|(group, _)| group)
    }

    /// The source of a material's own shader; `None` for the default, also when it cannot be used.
    pub fn shader(&mut self, gpu: &Gpu, material: &VisualMaterial) -> Option<String> {
        let file = material.shader.as_ref()?;
        if !self.shaders.contains_key(file) {
            let source = read_shader(self.folder.as_deref(), file)
                .and_then(|source| passes::check_material(gpu, &source).map(|()| source));
            if let Err(reason) = &source {
                tracing::error!("shader {file}: {reason}; the material is drawn without it");
            }
            self.shaders.insert(file.clone(), source.ok());
        }
        self.shaders.get(file).cloned().flatten()
    }

    fn load(&mut self, gpu: &Gpu, role: Role, map: &Texture) {
        let key = (role, format!("{map:?}"));
        if self.textures.contains_key(&key) {
            return;
        }
        let levels = match map {
            Texture::Procedural(name) => {
                let set = match self.sets.get(name) {
                    Some(set) => Ok(set),
                    None => texture::procedural(name, PROCEDURAL_SIDE)
                        .map(|set| &*self.sets.entry(name.clone()).or_insert(set)),
                };
                set.map(|set| role.of_set(set).clone().mips(role.kind()))
            }
            Texture::File(file) => texture::resolve(self.folder.as_deref().unwrap_or(Path::new("")), file)
                .and_then(|file| texture::load(&file, gpu.device.limits().max_texture_dimension_2d))
                .map(|image| image.mips(role.kind())),
        };
        let view = match levels {
            Ok(levels) => upload(gpu, role.format(), &levels),
            Err(error) => {
                tracing::error!("{error}; the material is drawn without it");
                self.neutral[&role].clone()
            }
        };
        self.textures.insert(key, view);
    }
}

/// A material's own shader below the scenario's folder.
fn read_shader(folder: Option<&Path>, file: &str) -> Result<String, String> {
    let path = texture::resolve(folder.unwrap_or(Path::new("")), file).map_err(|error| error.to_string())?;
    let size = std::fs::metadata(&path).map_err(|error| error.to_string())?.len();
    if size > SHADER_BYTES_MAX {
        return Err(format!("it has {size} bytes; at most {SHADER_BYTES_MAX} are read"));
    }
    std::fs::read_to_string(&path).map_err(|error| error.to_string())
}

/// A texture with its mip levels, the largest first.
pub fn upload(gpu: &Gpu, format: wgpu::TextureFormat, levels: &[Image8]) -> wgpu::TextureView {
    let [width, height] = levels.first().map_or([1, 1], |level| [level.width, level.height]);
    let descriptor = wgpu::TextureDescriptor {
        label: Some("map"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: levels.len().max(1) as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    };
    let bytes: Vec<u8> = levels.iter().flat_map(|level| level.bytes()).copied().collect();
    let order = wgpu::util::TextureDataOrder::LayerMajor;
    let texture = gpu.device.create_texture_with_data(&gpu.queue, &descriptor, order, &bytes);
    texture.create_view(&Default::default())
}
