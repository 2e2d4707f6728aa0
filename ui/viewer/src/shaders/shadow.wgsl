// Depth as a light sees it.
struct Item {
    world_from_item: mat4x4f,
    base_color: vec4f,
    surface: vec4f,
    tiling: vec2f,
    number: u32,
    flags: u32,
}
@group(0) @binding(0) var<uniform> clip_from_world: mat4x4f;
@group(1) @binding(0) var<storage, read> items: array<Item>;

@vertex
fn shadow(@location(0) position: vec3f, @builtin(instance_index) item: u32) -> @builtin(position) vec4f {
    return clip_from_world * items[item].world_from_item * vec4f(position, 1.0);
}
