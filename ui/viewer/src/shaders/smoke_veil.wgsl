// Smoke that was drawn with fewer pixels than the scene, over it.

@group(2) @binding(0) var veil: texture_2d<f32>;
@group(2) @binding(1) var veil_sampler: sampler;

@vertex
fn everywhere(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

@fragment
fn cover(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let texel = (at.xy - sight.pane.xy) / sight.smoke_pixels;
    return textureSampleLevel(veil, veil_sampler, texel / vec2f(textureDimensions(veil)), 0.0);
}
