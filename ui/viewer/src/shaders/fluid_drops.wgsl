// Fluids, first step: each drop as a ball: how far away the nearest is, and how much there is on the way through all.
// After van der Laan, Green, Sainz, "Screen space fluid rendering with curvature flow" (2009).

struct Drop {
    @builtin(position) clip: vec4f,
    @location(0) @interpolate(linear) across: vec2f,
    // Depth of its middle, radius [m], extinction [1/m].
    @location(1) @interpolate(flat) middle: vec3f,
    @location(2) @interpolate(flat) cloud: u32,
}

@vertex
fn drop(@builtin(vertex_index) vertex: u32) -> Drop {
    let particle = particles[order[vertex / 3u]];
    let at = (sight.eye_from_world * vec4f(world_of(particle), 1.0)).xyz;
    var out: Drop;
    if at.z <= sight.near {
        out.clip = vec4f(2.0, 2.0, 2.0, 1.0);
        return out;
    }
    let corner = triangle_corner(vertex);
    out.clip = clip_from_eye(at + vec3f(corner * particle.radius, 0.0));
    out.across = corner;
    out.middle = vec3f(at.z, particle.radius, particle.extinction);
    out.cloud = particle.cloud;
    return out;
}

// Half of the way through a drop [m]; negative beside it.
fn half_way(in: Drop) -> f32 {
    let r2 = dot(in.across, in.across);
    return select(in.middle.y * sqrt(max(1.0 - r2, 0.0)), -1.0, r2 >= 1.0);
}

struct Ball {
    @location(0) distance: f32,
    @builtin(frag_depth) depth: f32,
}

fn front_of(in: Drop) -> Ball {
    let half = half_way(in);
    let front = in.middle.x - half;
    if half < 0.0 || front <= sight.near { discard; }
    return Ball(front, depth_of(front));
}

@fragment
fn ball(in: Drop) -> Ball {
    return front_of(in);
}

struct Numbered {
    @location(0) distance: f32,
    @location(1) number: u32,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn numbered_ball(in: Drop) -> Numbered {
    let seen = front_of(in);
    return Numbered(seen.distance, sight.first_number + in.cloud, seen.depth);
}
