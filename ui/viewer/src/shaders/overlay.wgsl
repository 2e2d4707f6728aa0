// What is drawn over a scene: lines of constant width, triangles, spots on surfaces, edges, quantities per vertex.

// Whether what is drawn now lies behind something.
override HIDDEN: bool = false;

struct View {
    clip_from_world: mat4x4f,
    eye: vec3f,
    // Nearest depth [m].
    near: f32,
    // Size of the pane [pixels].
    pane: vec2f,
    // What depths in clip space are drawn nearer by: a thousandth of the distance, wherever it is.
    bias: f32,
    // Width of edges [pixels].
    edge_width: f32,
}

@group(0) @binding(0) var<uniform> view: View;

fn linear(color: vec4f) -> vec4f {
    let low = color.rgb / 12.92;
    let high = pow((color.rgb + 0.055) / 1.055, vec3f(2.4));
    return vec4f(select(high, low, color.rgb <= vec3f(0.04045)), color.a);
}

fn nearer(clip: vec4f) -> vec4f {
    return vec4f(clip.xy, clip.z - view.bias, clip.w);
}

// Lit from the eye, so that shapes are seen as such.
fn shaded(color: vec3f, world: vec3f) -> vec3f {
    let normal = normalize(cross(dpdx(world), dpdy(world)) + vec3f(1e-20));
    return color * (0.45 + 0.55 * abs(dot(normal, normalize(view.eye - world))));
}

struct Stroke {
    @builtin(position) clip: vec4f,
    @location(0) color: vec4f,
    // From the line's middle [pixels].
    @location(1) @interpolate(linear) across: f32,
    @location(2) @interpolate(flat) half_width: f32,
    @location(3) @interpolate(flat) hidden: f32,
}

// A corner of the rectangle that a line covers on the screen; what lies behind the eye is cut off.
fn ribbon(from_world: vec3f, to_world: vec3f, corner: u32, width: f32) -> Stroke {
    var out: Stroke;
    var a = view.clip_from_world * vec4f(from_world, 1.0);
    var b = view.clip_from_world * vec4f(to_world, 1.0);
    let near = view.near * 1.0001;
    if a.w < near && b.w < near {
        out.clip = vec4f(2.0, 2.0, 2.0, 1.0);
        return out;
    }
    if a.w < near { a = mix(a, b, (near - a.w) / (b.w - a.w)); }
    if b.w < near { b = mix(b, a, (near - b.w) / (a.w - b.w)); }
    let half_pane = 0.5 * view.pane;
    let at_a = a.xy / a.w * half_pane;
    let at_b = b.xy / b.w * half_pane;
    let offset = at_b - at_a;
    let along = select(vec2f(1.0, 0.0), offset / max(length(offset), 1e-6), length(offset) > 1e-6);
    // Six corners of two triangles: the ends alternate, the sides change after three.
    let at_end = corner == 1u || corner == 2u || corner == 4u;
    let side = select(-1.0, 1.0, corner == 2u || corner >= 4u);
    let reach = 0.5 * width + 0.5;
    let end = select(a, b, at_end);
    let place = select(at_a, at_b, at_end) + along * select(-0.5, 0.5, at_end) * width
        + vec2f(-along.y, along.x) * side * reach;
    out.clip = nearer(vec4f(place / half_pane * end.w, end.z, end.w));
    out.across = side * reach;
    out.half_width = 0.5 * width;
    return out;
}

@vertex
fn line(
    @builtin(vertex_index) corner: u32,
    @location(0) from_world: vec3f,
    @location(1) width: f32,
    @location(2) to_world: vec3f,
    @location(3) hidden: f32,
    @location(4) from_color: vec4f,
    @location(5) to_color: vec4f,
) -> Stroke {
    var out = ribbon(from_world, to_world, corner, width);
    let at_end = corner == 1u || corner == 2u || corner == 4u;
    out.color = linear(select(from_color, to_color, at_end));
    out.hidden = hidden;
    return out;
}

@fragment
fn stroke(in: Stroke) -> @location(0) vec4f {
    var alpha = in.color.a * clamp(in.half_width + 0.5 - abs(in.across), 0.0, 1.0);
    if HIDDEN { alpha *= in.hidden; }
    return vec4f(in.color.rgb, alpha);
}

struct Filled {
    @builtin(position) clip: vec4f,
    @location(0) world: vec3f,
    @location(1) color: vec4f,
    @location(2) @interpolate(flat) hidden: f32,
}

@vertex
fn triangle(@location(0) world: vec3f, @location(1) hidden: f32, @location(2) color: vec4f) -> Filled {
    return Filled(nearer(view.clip_from_world * vec4f(world, 1.0)), world, linear(color), hidden);
}

@fragment
fn fill(in: Filled) -> @location(0) vec4f {
    var alpha = in.color.a;
    if HIDDEN { alpha *= in.hidden; }
    return vec4f(shaded(in.color.rgb, in.world), alpha);
}
