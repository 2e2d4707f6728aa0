// How far away the surface of a fluid is [m], and whose it is.

@group(2) @binding(0) var surface: texture_2d<f32>;
@group(2) @binding(1) var numbers: texture_2d<u32>;

struct Measured {
    @location(0) depth: f32,
    @location(1) number: u32,
    @builtin(frag_depth) clip: f32,
}

@vertex
fn everywhere(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

@fragment
fn measure(@builtin(position) at: vec4f) -> Measured {
    let z = textureLoad(surface, vec2i(at.xy), 0).r;
    if z <= 0.0 { discard; }
    return Measured(z, textureLoad(numbers, vec2i(at.xy), 0).r, depth_of(z));
}
