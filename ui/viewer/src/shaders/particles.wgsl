// What smoke and fluids have in common: where particles are, and through which eye they are seen.

struct Sight {
    // The eye looks along +z with y down.
    eye_from_world: mat4x4f,
    // Of the lens.
    scale: vec2f,
    shift: vec2f,
    near: f32,
    far: f32,
    // Texels of the fluid's own pictures that a metre covers at a depth of a metre.
    texels: f32,
    // Pixels that such a texel is wide.
    pixels: f32,
    // Place of the pane in what is drawn into [pixels].
    pane: vec4f,
    // Radius within which the surface of a fluid is smoothed, and depths that count as one surface [m].
    reach: f32,
    range: f32,
    // Steps to either side.
    taps: i32,
    lights: u32,
    // How many of them throw shadows: the first ones.
    shadows: u32,
    // Whether puffs have a texture.
    wisps: u32,
    // Number of the first entity in a segmentation picture.
    first_number: u32,
    // Pixels that a texel of smoke is wide; where it is one, smoke is drawn into the picture itself.
    smoke_pixels: f32,
}

struct Particle {
    position: vec3f,
    radius: f32,
    extinction: f32,
    turn: f32,
    cloud: u32,
    unused: u32,
}

struct Cloud {
    world_from_cloud: mat4x4f,
    color: vec3f,
    unused: u32,
}

@group(1) @binding(0) var<uniform> sight: Sight;
@group(1) @binding(1) var<storage, read> particles: array<Particle>;
@group(1) @binding(2) var<storage, read> clouds: array<Cloud>;
// Numbers of the particles that are drawn, in order.
@group(3) @binding(0) var<storage, read> order: array<u32>;

fn clip_from_eye(at: vec3f) -> vec4f {
    let depth = sight.far / (sight.far - sight.near) * (at.z - sight.near);
    return vec4f(
        sight.scale.x * at.x + sight.shift.x * at.z, sight.shift.y * at.z - sight.scale.y * at.y, depth, at.z);
}

// What a depth buffer holds of a distance, and back.
fn depth_of(z: f32) -> f32 {
    return sight.far / (sight.far - sight.near) * (1.0 - sight.near / z);
}

fn distance_of(depth: f32) -> f32 {
    return sight.near / max(1.0 - depth * (sight.far - sight.near) / sight.far, 1e-7);
}

// Corners of a square of two triangles. (An instance for each particle would cost a rasteriser in software more than what
// it draws.)
fn square_corner(vertex: u32) -> vec2f {
    let corner = vertex % 6u;
    let right = corner == 1u || corner == 2u || corner == 4u;
    let down = corner == 2u || corner >= 4u;
    return select(vec2f(-1.0), vec2f(1.0), vec2<bool>(right, down));
}

// Corners of the triangle around a circle: for small ones, each triangle costs more than what is left out of it.
fn triangle_corner(vertex: u32) -> vec2f {
    let corner = vertex % 3u;
    if corner == 2u { return vec2f(0.0, 2.0); }
    return vec2f(select(1.7320508, -1.7320508, corner == 0u), -1.0);
}

fn world_of(particle: Particle) -> vec3f {
    return (clouds[particle.cloud].world_from_cloud * vec4f(particle.position, 1.0)).xyz;
}
