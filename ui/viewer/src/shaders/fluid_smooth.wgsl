// Fluids, second step: the balls become one surface. Narrow-range filter of Truong, Yuksel, "A narrow-range filter for
// screen-space fluid rendering" (2018), along rows and columns in turn: what lies far behind counts for nothing, what lies
// far in front as a little in front, and the range follows a surface that leans.

@group(2) @binding(0) var distances: texture_2d<f32>;

@vertex
fn everywhere(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

fn filtered(here: vec2i, along: vec2i) -> f32 {
    let middle = textureLoad(distances, here, 0).r;
    if middle <= 0.0 { return 0.0; }
    let size = vec2i(textureDimensions(distances));
    let texels = sight.reach * sight.texels / middle;
    let taps = min(sight.taps, i32(ceil(texels)));
    // As wide at any distance; where that is wider than there are steps, the steps are wider.
    let step = max(texels / f32(max(taps, 1)), 1.0);
    var sum = middle;
    var weights = 1.0;
    // The range of each side grows with what is met there.
    var low = vec2f(middle - sight.range);
    var high = vec2f(middle + sight.range);
    for (var i = 1; i <= taps; i++) {
        let offset = along * i32(round(f32(i) * step));
        let share = f32(i) / (f32(taps) + 0.5);
        let weight = exp(-2.5 * share * share);
        var met = vec2f(0.0);
        let back = here - offset;
        let forth = here + offset;
        if all(back >= vec2i(0)) { met.x = textureLoad(distances, back, 0).r; }
        if all(forth < size) { met.y = textureLoad(distances, forth, 0).r; }
        // Both sides or none: one alone would pull a surface that leans.
        let counts = (met > vec2f(0.0)) & (met <= high);
        if !all(counts) { continue; }
        let within = met >= low;
        let taken = select(vec2f(middle - sight.range), met, within);
        low = select(low, min(low, met - sight.range), within);
        high = select(high, max(high, met + sight.range), within);
        sum += weight * (taken.x + taken.y);
        weights += 2.0 * weight;
    }
    return sum / weights;
}

@fragment
fn rows(@builtin(position) at: vec4f) -> @location(0) f32 {
    return filtered(vec2i(at.xy), vec2i(1, 0));
}

@fragment
fn columns(@builtin(position) at: vec4f) -> @location(0) f32 {
    return filtered(vec2i(at.xy), vec2i(0, 1));
}
