// Parts of surfaces that are coloured: what lies within balls.

struct Range {
    first: u32,
    count: u32,
}

@group(2) @binding(0) var<storage, read> spots: array<vec4f>;
// Of each item.
@group(2) @binding(1) var<storage, read> ranges: array<Range>;

struct OnSurface {
    @builtin(position) clip: vec4f,
    @location(0) world: vec3f,
    @location(1) @interpolate(flat) number: u32,
}

@vertex
fn on_surface(@location(0) position: vec3f, @builtin(instance_index) number: u32) -> OnSurface {
    let world = item.world_from_item * vec4f(position, 1.0);
    return OnSurface(nearer(view.clip_from_world * world), world.xyz, number);
}

@fragment
fn spot(in: OnSurface) -> @location(0) vec4f {
    let color = shaded(vec3f(0.871, 0.0070, 0.0052), in.world);
    let range = ranges[in.number];
    // Inside of the nearest spot's edge, in its radii.
    var inside = -1.0;
    for (var i = range.first; i < range.first + range.count; i++) {
        inside = max(inside, 1.0 - distance(in.world, spots[i].xyz) / spots[i].w);
    }
    var alpha = smoothstep(0.0, 0.12, inside);
    if alpha <= 0.0 { discard; }
    if HIDDEN { alpha *= 0.45; }
    return vec4f(color, alpha);
}
