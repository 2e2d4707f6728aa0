// How much light loses on its way through all drops, as far as they are before a surface.

struct Thickness {
    // Optical depth times the root of the colour; optical depth.
    @location(0) optical: vec4f,
    // Length of the way [m].
    @location(1) way: f32,
}

@fragment
fn thickness(in: Drop) -> Thickness {
    let half = half_way(in);
    let pixel = vec2i(in.clip.xy * sight.pixels + sight.pane.xy);
    let back = min(in.middle.x + half, scene_at(pixel));
    let way = max(back - (in.middle.x - half), 0.0);
    if half < 0.0 || way <= 0.0 { discard; }
    let optical = in.middle.z * way;
    return Thickness(vec4f(sqrt(clouds[in.cloud].color), 1.0) * optical, way);
}
