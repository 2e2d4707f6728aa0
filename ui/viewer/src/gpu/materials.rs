//! Textures of materials on the device.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use trocar_scene::{Texture, VisualMaterial};
use wgpu::util::DeviceExt;

use crate::edit_map::SIZE_MAX;
use crate::gpu::Gpu;
use crate::gpu::passes::{self, Features};
use crate::texture::image8::linear_of_srgb;
use crate::texture::{self, Image8, MapKind, MapSet};

/// Side of procedural textures \[texels\].
const PROCEDURAL_SIDE: u32 = 512;
/// Largest file of a shader \[bytes\].
const SHADER_BYTES_MAX: u64 = 256 * 1024;

/// The role of a map, which decides its byte format and its default.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Colours, stored as square roots of linear light.
    Color,
    /// Normals.
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
    /// Its map in a procedural texture.
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
    /// The single texel of a map without effect.
    fn neutral(self) -> [u8; 4] {
        match self {
            Self::Color | Self::Free => [255; 4],
            Self::Normal => [128, 128, 255, 255],
            Self::Edit => [0, 0, 0, 255],
        }
    }
}

/// A map on the device.
#[derive(Clone)]
struct Map {
    view: wgpu::TextureView,
    /// Mean in linear light.
    mean: [f32; 4],
}

/// The device resources of a material.
#[derive(Clone)]
pub struct Look {
    /// The bind group of its maps.
    pub group: wgpu::BindGroup,
    /// Its pipeline features, except relief.
    pub features: Features,
    /// Base colour times the mean of the colour map.
    pub mean_color: [f32; 4],
    /// Number of its own shader; 0 is the default.
    pub shader: u32,
}

/// The bind groups of the materials' maps.
pub struct Materials {
    /// Layout of the bind group.
    pub layout: wgpu::BindGroupLayout,
    tiled: wgpu::Sampler,
    single: wgpu::Sampler,
    coarse: wgpu::Sampler,
    neutral: BTreeMap<Role, Map>,
    textures: BTreeMap<(Role, String), Map>,
    /// Each with whether it was used recently.
    groups: BTreeMap<String, (wgpu::BindGroup, bool)>,
    /// Folder below which files of textures are.
    folder: Option<PathBuf>,
    /// Procedural textures; each has several maps.
    sets: BTreeMap<String, MapSet>,
    /// Numbers of material shaders by file; 0 for an invalid one, which was reported.
    shaders: BTreeMap<String, u32>,
    /// Shader sources by number; the first is the default.
    sources: Vec<String>,
}

impl Materials {
    /// Empty; `folder` is the scenario's.
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
        let entries = [texture(0), texture(1), texture(2), texture(3), sampler(4), sampler(5), sampler(6)];
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("material"), entries: &entries };
        let layout = gpu.device.create_bind_group_layout(&descriptor);
        let sampler = |mode, mipmap_filter| {
            gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                address_mode_u: mode,
                address_mode_v: mode,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                mipmap_filter,
                ..Default::default()
            })
        };
        let neutral =
            Role::ALL.map(|role| (role, upload(gpu, role, vec![Image8::filled(1, 1, role.neutral())])));
        Self {
            layout,
            tiled: sampler(wgpu::AddressMode::Repeat, wgpu::MipmapFilterMode::Linear),
            single: sampler(wgpu::AddressMode::ClampToEdge, wgpu::MipmapFilterMode::Linear),
            // The transition of roughness between levels is invisible.
            coarse: sampler(wgpu::AddressMode::Repeat, wgpu::MipmapFilterMode::Nearest),
            neutral: neutral.into(),
            textures: BTreeMap::new(),
            groups: BTreeMap::new(),
            folder,
            sets: BTreeMap::new(),
            shaders: BTreeMap::new(),
            sources: vec![passes::MATERIAL.to_owned()],
        }
    }

    /// Loads the maps and shader of a material, with the entity's own edit map if it has one.
    pub fn send(
        &mut self,
        gpu: &Gpu,
        material: &VisualMaterial,
        edit: Option<(u64, &wgpu::TextureView)>,
    ) -> Look {
        for role in Role::ALL {
            if let Some(map) = role.of(material) {
                self.load(gpu, role, map);
            }
        }
        let has = |role: Role| role.of(material).is_some();
        let shader = self.shader(gpu, material);
        let features = Features {
            color_map: has(Role::Color),
            normal_map: has(Role::Normal),
            edit_map: has(Role::Edit) || edit.is_some(),
            free_map: has(Role::Free),
            relief: false,
            // Blood is wet, and a custom shader may be.
            coat: material.wetness > 0.0 || has(Role::Edit) || edit.is_some() || shader != 0,
        };
        let mean = self.map(Role::Color, material).mean;
        let mean_color = std::array::from_fn(|channel| material.base_color[channel] as f32 * mean[channel]);
        Look { group: self.group(gpu, material, edit), features, mean_color, shader }
    }

    /// The loaded map, or the default without effect.
    fn map(&self, role: Role, material: &VisualMaterial) -> &Map {
        let loaded = role.of(material).and_then(|map| self.textures.get(&(role, format!("{map:?}"))));
        loaded.unwrap_or(&self.neutral[&role])
    }

    fn group(
        &mut self,
        gpu: &Gpu,
        material: &VisualMaterial,
        edit: Option<(u64, &wgpu::TextureView)>,
    ) -> wgpu::BindGroup {
        let mut key =
            Role::ALL.map(|role| role.of(material).map_or(String::new(), |map| format!("{map:?}"))).join("|");
        if let Some((number, _)) = edit {
            key = format!("{key}|{number}");
        }
        if let Some((group, used)) = self.groups.get_mut(&key) {
            *used = true;
            return group.clone();
        }
        let own = |role: Role| edit.filter(|_| role == Role::Edit).map(|(_, view)| view);
        let views = Role::ALL.map(|role| own(role).unwrap_or(&self.map(role, material).view));
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
                binding(6, wgpu::BindingResource::Sampler(&self.coarse)),
            ],
        });
        self.groups.insert(key, (group.clone(), true));
        group
    }

    /// Drops bind groups that were not used since the last call; their textures are kept.
    pub fn sweep(&mut self) {
        self.groups.retain(|_, (_, used)| std::mem::take(used));
    }

    /// The picture of a material's edit map.
    pub fn edit_picture(&self, material: &VisualMaterial) -> Option<Image8> {
        match material.edit_map.as_ref()? {
            Texture::Procedural(name) => texture::procedural(name, PROCEDURAL_SIDE).ok().map(|set| set.color),
            Texture::File(file) => texture::resolve(self.folder.as_deref().unwrap_or(Path::new("")), file)
                .and_then(|file| texture::load(&file, SIZE_MAX))
                .ok(),
        }
    }

    /// The number of a material's own shader; 0 for the default, also for an invalid one.
    fn shader(&mut self, gpu: &Gpu, material: &VisualMaterial) -> u32 {
        let Some(file) = material.shader.as_ref() else { return 0 };
        if let Some(number) = self.shaders.get(file) {
            return *number;
        }
        let source = read_shader(self.folder.as_deref(), file)
            .and_then(|source| passes::check_material(gpu, &source).map(|()| source));
        let number = match source {
            Ok(source) => {
                self.sources.push(source);
                self.sources.len() as u32 - 1
            }
            Err(reason) => {
                tracing::error!("shader {file}: {reason}; the material is drawn without it");
                0
            }
        };
        self.shaders.insert(file.clone(), number);
        number
    }

    /// The source of a shader.
    pub fn source(&self, number: u32) -> &str {
        self.sources.get(number as usize).map_or(passes::MATERIAL, String::as_str)
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
        let loaded = match levels {
            Ok(levels) => upload(gpu, role, levels),
            Err(error) => {
                tracing::error!("{error}; the material is drawn without it");
                self.neutral[&role].clone()
            }
        };
        self.textures.insert(key, loaded);
    }
}

/// Reads a material's own shader below the scenario's folder.
fn read_shader(folder: Option<&Path>, file: &str) -> Result<String, String> {
    let path = texture::resolve(folder.unwrap_or(Path::new("")), file).map_err(|error| error.to_string())?;
    let size = std::fs::metadata(&path).map_err(|error| error.to_string())?.len();
    if size > SHADER_BYTES_MAX {
        return Err(format!("it has {size} bytes; at most {SHADER_BYTES_MAX} are read"));
    }
    std::fs::read_to_string(&path).map_err(|error| error.to_string())
}

/// A map with its mip levels, the largest first.
fn upload(gpu: &Gpu, role: Role, mut levels: Vec<Image8>) -> Map {
    if role == Role::Color {
        // Square roots are about as perceptually uniform as sRGB, but the shader decodes them with one multiplication.
        let root = |byte| (255.0 * linear_of_srgb(byte).sqrt()).round() as u8;
        let roots: [u8; 256] = std::array::from_fn(|byte| root(byte as u8));
        for pixel in levels.iter_mut().flat_map(|level| &mut level.pixels) {
            pixel[..3].iter_mut().for_each(|byte| *byte = roots[usize::from(*byte)]);
        }
    }
    let last = levels.last().and_then(|level| level.get(0, 0)).unwrap_or(role.neutral());
    let mut mean = last.map(|byte| f32::from(byte) / 255.0);
    if role == Role::Color {
        mean[..3].iter_mut().for_each(|part| *part *= *part);
    }
    let [width, height] = levels.first().map_or([1, 1], |level| [level.width, level.height]);
    let descriptor = wgpu::TextureDescriptor {
        label: Some("map"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: levels.len().max(1) as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8Unorm,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    };
    let bytes: Vec<u8> = levels.iter().flat_map(|level| level.bytes()).copied().collect();
    let order = wgpu::util::TextureDataOrder::LayerMajor;
    let texture = gpu.device.create_texture_with_data(&gpu.queue, &descriptor, order, &bytes);
    Map { view: texture.create_view(&Default::default()), mean }
}
