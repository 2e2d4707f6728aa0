// The least that draws lit triangles: one light, Phong's highlight.

struct Frame {
    clip_from_world: mat4x4f,
    eye: vec4f,
    light: vec4f,
    candela: vec4f,
}

struct Item {
    world_from_item: mat4x4f,
    color: vec4f,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(1) @binding(0) var<uniform> item: Item;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
}

@vertex
fn corner(@location(0) position: vec3f, @location(1) normal: vec3f) -> Corner {
    let world = item.world_from_item * vec4f(position, 1.0);
    return Corner(
        frame.clip_from_world * world, world.xyz, (item.world_from_item * vec4f(normal, 0.0)).xyz);
}

@fragment
fn shade(in: Corner) -> @location(0) vec4f {
    let normal = normalize(in.normal);
    let offset = frame.light.xyz - in.world;
    let to_light = normalize(offset);
    let to_eye = normalize(frame.eye.xyz - in.world);
    let diffuse = max(dot(normal, to_light), 0.0);
    let shine = pow(max(dot(reflect(-to_light, normal), to_eye), 0.0), 40.0);
    let arriving = frame.candela.xyz / dot(offset, offset);
    return vec4f(item.color.rgb * (diffuse * arriving + 0.1) + 0.2 * shine * arriving, item.color.a);
}
