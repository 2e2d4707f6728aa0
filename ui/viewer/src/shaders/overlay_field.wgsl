// A quantity per vertex, by the colours of a scale.

// sRGB bytes.
@group(2) @binding(0) var colors: texture_2d<f32>;

struct Measured {
    @builtin(position) clip: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
    @location(2) fraction: f32,
}

@vertex
fn measured(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    // Below 0 for a vertex without a value.
    @location(2) fraction: f32,
) -> Measured {
    let world = item.world_from_item * vec4f(position, 1.0);
    let turned = (item.world_from_item * vec4f(normal, 0.0)).xyz;
    return Measured(nearer(view.clip_from_world * world), world.xyz, turned, fraction);
}

@fragment
fn measure(in: Measured) -> @location(0) vec4f {
    if in.fraction < -1e-3 { discard; }
    let color = textureLoad(colors, vec2i(i32(round(clamp(in.fraction, 0.0, 1.0) * 255.0)), 0), 0).rgb;
    // Little shading: the colour is what is to be read.
    let facing = abs(dot(normalize(in.normal), normalize(view.eye - in.world)));
    return vec4f(color * (0.72 + 0.28 * facing), 1.0);
}
