// What holds for a whole frame.

struct Light {
    position: vec3f,
    // Edge of the cone: smooth where `cosine * cone_scale + cone_bias` goes from 0 to 1.
    cone_scale: f32,
    direction: vec3f,
    cone_bias: f32,
    // Times the exposure.
    candela: vec3f,
    unused: u32,
    clip_from_world: mat4x4f,
}

struct Frame {
    clip_from_world: mat4x4f,
    // Position of the eye; w: seconds of the session.
    eye: vec4f,
    // Along the line of sight.
    forward: vec4f,
    // Radiance of the surroundings, from above and from below. All light is as exposed already.
    above: vec4f,
    below: vec4f,
    // Number of lights; texel of a shadow map, in shares of its side.
    light_count: u32,
    shadow_texel: f32,
    unused_a: u32,
    unused_b: u32,
    // Those that throw shadows first: light i has layer i.
    lights: array<Light, 8>,
}

@group(0) @binding(0) var<uniform> frame: Frame;
