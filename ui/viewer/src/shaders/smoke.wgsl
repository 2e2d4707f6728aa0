// Smoke: balls of Gaussian density that face the eye. What light loses on its way through one is known in closed form,
// also where a surface ends the way: there is no edge where smoke meets it.

@group(2) @binding(1) var wisps: texture_2d<f32>;
@group(2) @binding(2) var wisps_sampler: sampler;

// Standard deviations after which there is nothing more.
const REACH = 2.3;
// Density there, of that in the middle.
const LEAST = 0.071005;
const PI = 3.14159265;

struct Puff {
    @builtin(position) clip: vec4f,
    // From its middle, in standard deviations.
    @location(0) @interpolate(linear) across: vec2f,
    @location(1) @interpolate(linear) wisp: vec2f,
    // Light that it sends to the eye.
    @location(2) @interpolate(flat) light: vec3f,
    // Depth of its middle [m], one by its standard deviation [1/m], optical depth of its middle.
    @location(3) @interpolate(flat) middle: vec3f,
}

// Schlick's phase function (Blasi, Le Saec, Schlick, "A rendering algorithm for discrete volume density objects", 1993);
// fine smoke sends light forward, and a little of what was scattered several times everywhere.
fn phase(cosine: f32) -> f32 {
    let k = 0.35;
    let d = 1.0 - k * cosine;
    return (1.0 - k * k) / (4.0 * PI * d * d) + 0.06;
}

fn scattered(world: vec3f) -> vec3f {
    let from_eye = normalize(world - frame.eye.xyz);
    var sum = frame.above.rgb * 0.6 + frame.below.rgb * 0.4;
    for (var i = 0u; i < sight.lights; i++) {
        let offset = frame.lights[i].position - world;
        let d2 = max(dot(offset, offset), 1e-4);
        let to_light = offset * inverseSqrt(d2);
        // What goes straight on comes from behind the smoke.
        let share = cone(frame.lights[i], to_light) / d2 * phase(dot(to_light, from_eye));
        sum += frame.lights[i].candela * share;
    }
    return sum;
}

@vertex
fn puff(@builtin(vertex_index) vertex: u32) -> Puff {
    let particle = particles[order[vertex / 6u]];
    let world = world_of(particle);
    let at = (sight.eye_from_world * vec4f(world, 1.0)).xyz;
    var out: Puff;
    if at.z <= sight.near {
        out.clip = vec4f(2.0, 2.0, 2.0, 1.0);
        return out;
    }
    let sigma = 0.5 * particle.radius;
    let corner = square_corner(vertex);
    out.clip = clip_from_eye(at + vec3f(corner * (REACH * sigma), 0.0));
    // Hidden is only what lies behind with all of it.
    let front = max(at.z - REACH * sigma, sight.near * 1.0001);
    out.clip.z = depth_of(front) * out.clip.w;
    out.across = corner * REACH;
    let angle = particle.turn * 6.2831853;
    let turned = vec2f(
        corner.x * cos(angle) - corner.y * sin(angle), corner.x * sin(angle) + corner.y * cos(angle));
    out.wisp = turned * 0.22 + vec2f(particle.turn * 7.13, particle.turn * 13.7);
    out.light = tone(scattered(world) * clouds[particle.cloud].color);
    // Around the eye itself there is less and less of it, rather than suddenly none.
    let whole = smoothstep(0.0, 2.0 * sigma, at.z - sight.near);
    out.middle = vec3f(at.z, 1.0 / sigma, particle.extinction * sigma * 2.5066283 * whole);
    return out;
}

@fragment
fn smoke(in: Puff) -> @location(0) vec4f {
    var share = max(exp(-0.5 * dot(in.across, in.across)) - LEAST, 0.0) / (1.0 - LEAST);
    if sight.wisps > 0u {
        let noise = textureSampleLevel(wisps, wisps_sampler, in.wisp, 0.0).r;
        // Thicker here, thinner there: as much in the mean.
        share *= 2.0 * smoothstep(0.2, 0.8, noise);
    }
    // The part of the way that is not behind a surface: a logistic for the integral of the Gaussian (within 0.01).
    let corner = select(vec2f(0.0), sight.pane.xy, sight.smoke_pixels > 1.0);
    let pixel = vec2i(in.clip.xy * sight.smoke_pixels + corner);
    let beyond = (scene_at(pixel) - in.middle.x) * in.middle.y;
    let optical = in.middle.z * share / (1.0 + exp(-1.702 * beyond));
    let opacity = 1.0 - exp(-optical);
    return vec4f(in.light * opacity, opacity);
}
