// Pictures of one or two eyes become one: through the lens of a scope, woven by rows or by colour.

struct Weave {
    // Radial displacement at the corner; loss of light at the corner; width / height; 0: one eye, 1: rows, 2: colours.
    distortion: f32,
    vignette: f32,
    aspect: f32,
    how: u32,
    // Of the pane in the picture [pixels]: left, top, width, height.
    pane: vec4f,
}

@group(0) @binding(0) var<uniform> weave: Weave;
@group(0) @binding(1) var left: texture_2d<f32>;
@group(0) @binding(2) var right: texture_2d<f32>;
@group(0) @binding(3) var smooth_sampler: sampler;

@vertex
fn everywhere(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

fn seen(eye: texture_2d<f32>, uv: vec2f) -> vec3f {
    return textureSampleLevel(eye, smooth_sampler, uv, 0.0).rgb;
}

@fragment
fn composite(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let uv = (at.xy - weave.pane.xy) / weave.pane.zw;
    // One term of Brown's model ("Decentering distortion of lenses", 1966); the corners stay where they are.
    let half_diagonal = length(vec2f(weave.aspect, 1.0));
    let offset = (2.0 * uv - 1.0) * vec2f(weave.aspect, 1.0);
    let r2 = dot(offset, offset) / (half_diagonal * half_diagonal);
    let bent = offset * (1.0 + weave.distortion * r2) / (1.0 + weave.distortion);
    let through = 0.5 + 0.5 * bent / vec2f(weave.aspect, 1.0);
    var color: vec3f;
    if weave.how == 2u {
        let a = seen(left, through);
        let b = seen(right, through);
        color = vec3f(a.r, b.g, b.b);
    } else if weave.how == 1u && u32(at.y) % 2u == 1u {
        color = seen(right, through);
    } else {
        color = seen(left, through);
    }
    color *= 1.0 - weave.vignette * r2 * r2;
    return vec4f(color, 1.0);
}
