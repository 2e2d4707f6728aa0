// Edges of a surface that is on the device.

@group(2) @binding(0) var<storage, read> positions: array<f32>;
@group(2) @binding(1) var<storage, read> edges: array<vec2u>;

fn vertex_of(index: u32) -> vec3f {
    let local = vec3f(positions[3u * index], positions[3u * index + 1u], positions[3u * index + 2u]);
    return (item.world_from_item * vec4f(local, 1.0)).xyz;
}

@vertex
fn edge(@builtin(vertex_index) vertex: u32) -> Stroke {
    let ends = edges[vertex / 6u];
    var out = ribbon(vertex_of(ends.x), vertex_of(ends.y), vertex % 6u, view.edge_width);
    out.color = vec4f(0.85, 0.95, 1.0, 0.55);
    out.hidden = 0.0;
    return out;
}
