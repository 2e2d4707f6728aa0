// Depth along the line of sight [m], and the number of what is seen.
struct Probe {
    @location(0) depth: f32,
    @location(1) number: u32,
}

@fragment
fn probe(in: Corner) -> Probe {
    return Probe(dot(in.world - frame.eye.xyz, frame.forward.xyz), items[in.item].number);
}
