// Depth along the line of sight [m], and the number of what is seen.

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) depth: f32,
}

struct Probe {
    @location(0) depth: f32,
    @location(1) number: u32,
}

@vertex
fn corner(@location(0) position: vec3f) -> Corner {
    let world = item.world_from_item * vec4f(position, 1.0);
    return Corner(frame.clip_from_world * world, dot(world.xyz - frame.eye.xyz, frame.forward.xyz));
}

@fragment
fn probe(in: Corner) -> Probe {
    return Probe(in.depth, item.number);
}
