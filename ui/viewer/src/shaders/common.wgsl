// What every pass over surfaces shares.

struct Light {
    position: vec3f,
    cos_outer: f32,
    direction: vec3f,
    cos_inner: f32,
    candela: vec3f,
    // Layer of its shadow, or -1.
    shadow: i32,
    clip_from_world: mat4x4f,
}

struct Frame {
    clip_from_world: mat4x4f,
    // Position of the eye; w: seconds of the session.
    eye: vec4f,
    // Along the line of sight.
    forward: vec4f,
    // Radiance of the surroundings, from above and from below, before exposure; w of the first: exposure.
    above: vec4f,
    below: vec4f,
    // Number of lights; texel of a shadow map.
    light_count: u32,
    shadow_texel: f32,
    unused_a: u32,
    unused_b: u32,
    lights: array<Light, 8>,
}

@group(0) @binding(0) var<uniform> frame: Frame;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) @interpolate(flat) item: u32,
}

@vertex
fn corner(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @builtin(instance_index) item: u32,
) -> Corner {
    let world_from_item = items[item].world_from_item;
    let world = world_from_item * vec4f(position, 1.0);
    var out: Corner;
    out.clip = frame.clip_from_world * world;
    out.world = world.xyz;
    // Rigid: normals turn like everything else.
    out.normal = (world_from_item * vec4f(normal, 0.0)).xyz;
    out.uv = uv;
    out.item = item;
    return out;
}
