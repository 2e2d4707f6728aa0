// Fluids, last step: the surface is lit, and what is behind it shines through as far as the fluid is thin.

@group(0) @binding(1) var shadow_maps: texture_depth_2d_array;
@group(0) @binding(2) var shadow_sampler: sampler_comparison;
@group(2) @binding(0) var surface: texture_2d<f32>;
@group(2) @binding(1) var optical_depths: texture_2d<f32>;
@group(2) @binding(2) var ways: texture_2d<f32>;

const PI = 3.14159265;
// Of the highlights, as roughness squared.
const ALPHA = 0.05;

@vertex
fn everywhere(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

fn texel_at(at: vec4f) -> vec2i {
    return vec2i((at.xy - sight.pane.xy) / sight.pixels);
}

fn distance_at(texel: vec2i) -> f32 {
    return textureLoad(surface, clamp(texel, vec2i(0), vec2i(textureDimensions(surface)) - 1), 0).r;
}

// In the eye's frame.
fn place_at(texel: vec2i, z: f32) -> vec3f {
    let share = (vec2f(texel) + 0.5) * sight.pixels / sight.pane.zw;
    let x = (2.0 * share.x - 1.0 - sight.shift.x) * z / sight.scale.x;
    let y = (2.0 * share.y - 1.0 + sight.shift.y) * z / sight.scale.y;
    return vec3f(x, y, z);
}

// From a place to the next one to the side on which the surface goes on; there is a step at an edge.
fn along(texel: vec2i, place: vec3f, step: vec2i) -> vec3f {
    let z_forth = distance_at(texel + step);
    let z_back = distance_at(texel - step);
    let forth = place_at(texel + step, z_forth) - place;
    let back = place - place_at(texel - step, z_back);
    let has_forth = z_forth > 0.0 && (z_back <= 0.0 || abs(forth.z) < abs(back.z));
    // Where both sides go on alike, the mean of them is smoother.
    let both = z_forth > 0.0 && z_back > 0.0 && abs(forth.z - back.z) < 0.25 * sight.range;
    return select(select(back, forth, has_forth), 0.5 * (forth + back), both);
}

struct Fluid {
    world: vec3f,
    normal: vec3f,
    to_eye: vec3f,
    // What of it there is: less towards an edge where it is thin.
    cover: f32,
    // Share of light that it throws back, more towards grazing (Schlick 1994; blood and water: 0.02).
    mirror: f32,
    optical: vec4f,
}

fn fluid_at(texel: vec2i, z: f32) -> Fluid {
    let place = place_at(texel, z);
    let right = along(texel, place, vec2i(1, 0));
    let down = along(texel, place, vec2i(0, 1));
    var normal = cross(down, right);
    normal *= select(1.0, -1.0, dot(normal, place) > 0.0);
    let world_from_eye = transpose(mat3x3f(
        sight.eye_from_world[0].xyz, sight.eye_from_world[1].xyz, sight.eye_from_world[2].xyz));
    var f: Fluid;
    f.world = frame.eye.xyz + world_from_eye * place;
    f.normal = world_from_eye * (normal * inverseSqrt(max(dot(normal, normal), 1e-30)));
    f.to_eye = normalize(frame.eye.xyz - f.world);
    f.cover = smoothstep(0.0, sight.range, textureLoad(ways, texel, 0).r);
    let x = saturate(1.0 - dot(f.normal, f.to_eye));
    f.mirror = 0.02 + 0.98 * x * x * x * x * x;
    f.optical = textureLoad(optical_depths, texel, 0);
    return f;
}

struct Veil {
    @location(0) color: vec4f,
    @builtin(frag_depth) depth: f32,
}

// What is left of what is behind: it is multiplied with this.
@fragment
fn absorb(@builtin(position) at: vec4f) -> Veil {
    let texel = texel_at(at);
    let z = distance_at(texel);
    if z <= 0.0 { discard; }
    let optical = textureLoad(optical_depths, texel, 0);
    return Veil(vec4f(exp(optical.rgb - optical.a), 1.0), depth_of(z));
}

fn shadow(index: u32, world: vec3f, normal: vec3f) -> f32 {
    let offset = frame.lights[index].position - world;
    let raised = world + normal * (length(offset) * frame.shadow_texel * 5.0);
    let clip = frame.lights[index].clip_from_world * vec4f(raised, 1.0);
    let seen = clip.xyz / max(clip.w, 1e-6);
    let uv = vec2f(0.5 + 0.5 * seen.x, 0.5 - 0.5 * seen.y);
    let lit = textureSampleCompareLevel(shadow_maps, shadow_sampler, uv, i32(index), seen.z);
    return select(lit, 1.0, clip.w <= 0.0 || seen.z > 1.0 || any(uv < vec2f(0.0)) || any(uv > vec2f(1.0)));
}

// The surroundings as they are mirrored: bright above, with two panels overhead.
fn mirrored(direction: vec3f) -> vec3f {
    let up = smoothstep(-0.4, 1.0, direction.z);
    let z = smoothstep(0.45, 0.75, direction.z);
    let x = smoothstep(0.0, 0.3, 0.9 - abs(abs(direction.x) - 0.45) * 2.5);
    return mix(frame.below.rgb, frame.above.rgb, up) + frame.above.rgb * (z * x * 5.0);
}

// What it adds of its own.
@fragment
fn shine(@builtin(position) at: vec4f) -> Veil {
    let texel = texel_at(at);
    let z = distance_at(texel);
    if z <= 0.0 { discard; }
    let f = fluid_at(texel, z);
    let root = f.optical.rgb / max(f.optical.a, 1e-6);
    // Light that goes in comes back where it is thick enough.
    let body = root * root * (1.0 - exp(-f.optical.a));
    var radiance = body * mix(frame.below.rgb, frame.above.rgb, 0.5 + 0.5 * f.normal.z)
        + mirrored(reflect(-f.to_eye, f.normal)) * (f.mirror * f.cover);
    for (var i = 0u; i < sight.lights; i++) {
        let offset = frame.lights[i].position - f.world;
        let d2 = max(dot(offset, offset), 1e-6);
        let to_light = offset * inverseSqrt(d2);
        let n_l = dot(f.normal, to_light);
        var share = max(n_l, 0.0) * cone(frame.lights[i], to_light) / d2;
        if i < sight.shadows && share > 0.0 { share *= shadow(i, f.world, f.normal); }
        let middle = normalize(to_light + f.to_eye);
        let n_h = max(dot(f.normal, middle), 0.0);
        let v_h = saturate(dot(f.to_eye, middle));
        // GGX (Walter et al. 2007) with Kelemen's visibility (2001): the surface is smooth.
        let d = n_h * n_h * (ALPHA * ALPHA - 1.0) + 1.0;
        let bent = pow(1.0 - v_h, 5.0);
        let glint = (0.02 + 0.98 * bent) * ALPHA * ALPHA / (4.0 * PI * d * d * max(v_h * v_h, 1e-3));
        radiance += frame.lights[i].candela * share * (body / PI + glint * f.cover);
    }
    return Veil(vec4f(tone(radiance), 0.0), depth_of(z));
}
