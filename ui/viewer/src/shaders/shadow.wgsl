// Depth as a light sees it.

@group(0) @binding(0) var<uniform> clip_from_world: mat4x4f;

@vertex
fn shadow(@location(0) position: vec3f) -> @builtin(position) vec4f {
    return clip_from_world * item.world_from_item * vec4f(position, 1.0);
}
