// Physically based shading of surfaces with up to four maps and a wet coat. What a material does not have is left out of
// its pipeline rather than skipped for each pixel: a rasteriser in software shades in groups, and masks instead of jumping.

override COLOR_MAP: bool = true;
override NORMAL_MAP: bool = true;
override EDIT_MAP: bool = true;
override FREE_MAP: bool = true;
override RELIEF: bool = true;
override COAT: bool = true;
// Smooth from one mip level to the next, and soft edges of shadows.
override FINE: bool = true;
// How many lights shine, at most 8, and how many of them throw shadows, at most 2: the first ones.
override LIGHTS: u32 = 8u;
override SHADOWS: u32 = 2u;

@group(0) @binding(1) var shadow_maps: texture_depth_2d_array;
@group(0) @binding(2) var shadow_sampler: sampler_comparison;
@group(2) @binding(0) var color_map: texture_2d<f32>;
@group(2) @binding(1) var normal_map: texture_2d<f32>;
@group(2) @binding(2) var edit_map: texture_2d<f32>;
@group(2) @binding(3) var free_map: texture_2d<f32>;
@group(2) @binding(4) var tiled: sampler;
@group(2) @binding(5) var single: sampler;
@group(2) @binding(6) var coarse: sampler;

const PI = 3.14159265;

struct Corner {
    @builtin(position) clip: vec4f,
    // Place in world, and one texture coordinate each: interpolated by fours.
    @location(0) world_u: vec4f,
    @location(1) normal_v: vec4f,
    // Place as the lights see it that throw shadows.
    @location(2) seen_0: vec4f,
    @location(3) seen_1: vec4f,
}

// A place in the picture of a light, a little above the surface (by what a texel covers there) on the side of the light: no
// surface shades itself.
fn seen_by(index: u32, world: vec3f, normal: vec3f) -> vec4f {
    let offset = frame.lights[index].position - world;
    let above = normal * (sign(dot(normal, offset)) * length(offset) * frame.shadow_texel * 5.0);
    return frame.lights[index].clip_from_world * vec4f(world + above, 1.0);
}

@vertex
fn corner(@location(0) position: vec3f, @location(1) normal: vec3f, @location(2) uv: vec2f) -> Corner {
    let world = item.world_from_item * vec4f(position, 1.0);
    // Rigid: normals turn like everything else.
    let turned = (item.world_from_item * vec4f(normal, 0.0)).xyz;
    var out: Corner;
    out.clip = frame.clip_from_world * world;
    out.world_u = vec4f(world.xyz, uv.x);
    out.normal_v = vec4f(turned, uv.y);
    if SHADOWS > 0u { out.seen_0 = seen_by(0u, world.xyz, turned); }
    if SHADOWS > 1u { out.seen_1 = seen_by(1u, world.xyz, turned); }
    return out;
}

// What is shaded; a material's own `surface` function may change it.
struct Surface {
    color: vec3f,
    opacity: f32,
    normal: vec3f,
    roughness: f32,
    metalness: f32,
    wetness: f32,
    occlusion: f32,
    glow: vec3f,
}

struct At {
    world: vec3f,
    uv: vec2f,
    // Unit direction to the eye.
    to_eye: vec3f,
    seconds: f32,
    // The material's free map, and the edit map: char, blood, cut, gloss.
    free: vec4f,
    edit: vec4f,
}

fn mapped(map: texture_2d<f32>, uv: vec2f) -> vec4f {
    if FINE { return textureSample(map, tiled, uv); }
    return textureSample(map, coarse, uv);
}

// Cotangent frame without stored tangents (Schueler, "Normal mapping without precomputed tangents", 2006).
fn cotangent_frame(normal: vec3f, position: vec3f, uv: vec2f) -> mat3x3f {
    let dp1 = dpdx(position);
    let dp2 = dpdy(position);
    let du1 = dpdx(uv);
    let du2 = dpdy(uv);
    let dp2_perp = cross(dp2, normal);
    let dp1_perp = cross(normal, dp1);
    let tangent = dp2_perp * du1.x + dp1_perp * du2.x;
    let bitangent = dp2_perp * du1.y + dp1_perp * du2.y;
    let longest = max(dot(tangent, tangent), dot(bitangent, bitangent));
    let scale = inverseSqrt(max(longest, 1e-30));
    return mat3x3f(tangent * scale, bitangent * scale, normal);
}

// Relief mapping: the ray to the eye meets the height field (Policarpo, Oliveira, Comba 2005): steps, then halving.
fn relief(uv: vec2f, to_eye: vec3f, depth_in_uv: f32, level: f32) -> vec2f {
    let steps = 12;
    let slope = to_eye.xy / max(to_eye.z, 0.2) * depth_in_uv;
    let step = 1.0 / f32(steps);
    var depth = 0.0;
    for (var i = 0; i < steps; i++) {
        let height = textureSampleLevel(normal_map, tiled, uv - slope * depth, level).a;
        if 1.0 - height <= depth { break; }
        depth += step;
    }
    var half_step = 0.5 * step;
    for (var i = 0; i < 4; i++) {
        let height = textureSampleLevel(normal_map, tiled, uv - slope * depth, level).a;
        depth += select(half_step, -half_step, 1.0 - height <= depth);
        half_step *= 0.5;
    }
    return uv - slope * depth;
}

// Share of a light that arrives: comparisons with four texels, weighted by how near they are; for fine pictures 3 x 3 of
// these. The sum of those is one of 4 x 4 texels, which are gathered by fours.
fn lit(layer: u32, clip: vec4f) -> f32 {
    let at = clip.xyz / clip.w;
    let place = vec2f(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y);
    let depth = at.z - 2e-5;
    var share: f32;
    if FINE {
        let texel = place / frame.shadow_texel - 0.5;
        let corner = floor(texel);
        let f = texel - corner;
        let low = corner * frame.shadow_texel;
        let high = low + 2.0 * frame.shadow_texel;
        // Each has (low x, high y), (high x, high y), (high x, low y), (low x, low y).
        let a = textureGatherCompare(shadow_maps, shadow_sampler, low, layer, depth);
        let b = textureGatherCompare(shadow_maps, shadow_sampler, vec2f(high.x, low.y), layer, depth);
        let c = textureGatherCompare(shadow_maps, shadow_sampler, vec2f(low.x, high.y), layer, depth);
        let d = textureGatherCompare(shadow_maps, shadow_sampler, high, layer, depth);
        let left = 1.0 - f.x;
        let rows = vec4f(
            a.w * left + a.z + b.w + b.z * f.x,
            a.x * left + a.y + b.x + b.y * f.x,
            c.w * left + c.z + d.w + d.z * f.x,
            c.x * left + c.y + d.x + d.y * f.x);
        share = dot(rows, vec4f(1.0 - f.y, 1.0, 1.0, f.y)) * (1.0 / 9.0);
    } else {
        share = textureSampleCompareLevel(shadow_maps, shadow_sampler, place, layer, depth);
    }
    let seen = clip.w > 0.0 && at.z < 1.0 && all(place >= vec2f(0.0)) && all(place <= vec2f(1.0));
    return select(1.0, share, seen);
}

// Schlick's approximation ("An inexpensive BRDF model", 1994): the part that grows towards grazing.
fn grazing(cosine: f32) -> f32 {
    let x = saturate(1.0 - cosine);
    let x2 = x * x;
    return x2 * x2 * x;
}

// The surroundings seen in a direction: bright above, dim below, blurred with roughness.
fn surroundings(direction_z: f32, sharp: f32) -> vec3f {
    let up = saturate(0.5 + 0.5 * direction_z * sharp);
    return mix(frame.below.rgb, frame.above.rgb, up * up * (3.0 - 2.0 * up));
}

// What is smooth also mirrors two bright panels overhead, so that steel looks like steel.
fn mirrored(direction: vec3f, roughness: f32) -> vec3f {
    let gloss = 1.0 - roughness;
    let z = saturate((direction.z - 0.45) * (1.0 / 0.3));
    let x = saturate((0.9 - abs(abs(direction.x) - 0.45) * 2.5) * (1.0 / 0.3));
    let panel = z * z * (3.0 - 2.0 * z) * (x * x * (3.0 - 2.0 * x));
    return surroundings(direction.z, 3.0 - 2.2 * roughness) + frame.above.rgb * (panel * gloss * gloss * 6.0);
}

// Karis' fit of the split-sum integral ("Physically based shading on mobile", 2014).
fn environment_brdf(f0: vec3f, roughness: f32, n_v: f32) -> vec3f {
    let c0 = vec4f(-1.0, -0.0275, -0.572, 0.022);
    let c1 = vec4f(1.0, 0.0425, 1.04, -0.04);
    let r = roughness * c0 + c1;
    let a004 = min(r.x * r.x, exp2(-9.28 * n_v)) * r.x + r.y;
    let ab = vec2f(-1.04, 1.04) * a004 + r.zw;
    return f0 * ab.x + ab.y;
}

// Everything about a point that does not depend on the light.
struct Point {
    world: vec3f,
    to_eye: vec3f,
    geometric: vec3f,
    normal: vec3f,
    n_v: f32,
    f0: vec3f,
    diffuse: vec3f,
    alpha: f32,
    // A film of water: its normal and how much of it there is.
    coat_normal: vec3f,
    coat_n_v: f32,
    wetness: f32,
    // Share of light that passes the film.
    below_coat: f32,
}

const COAT_ALPHA = 0.012;

// Light of one lamp that a point sends to the eye. The half vector itself is not needed: with unit vectors l and v its
// length is sqrt(2 + 2 l.v), so that all cosines with it follow from those of l and v.
fn reflected(index: u32, p: Point, seen: vec4f) -> vec3f {
    let offset = frame.lights[index].position - p.world;
    let d2 = max(dot(offset, offset), 1e-6);
    let nearness = inverseSqrt(d2);
    let to_light = offset * nearness;
    let n_l = dot(p.normal, to_light);
    let reaches = n_l > 0.0 && dot(p.geometric, to_light) > 0.0;
    var share = select(0.0, cone(frame.lights[index], to_light) * nearness * nearness, reaches);
    if index < SHADOWS { share *= lit(index, seen); }
    let towards = dot(to_light, p.to_eye);
    let half_length = inverseSqrt(max(2.0 + 2.0 * towards, 1e-6));
    let v_h = saturate((1.0 + towards) * half_length);
    let n_h = saturate((n_l + p.n_v) * half_length);
    let bent = grazing(v_h);
    let f = p.f0 + (1.0 - p.f0) * bent;
    // GGX (Walter et al. 2007) with Hammon's height-correlated visibility ("PBR diffuse lighting for GGX", 2017).
    let a2 = p.alpha * p.alpha;
    let d = n_h * n_h * (a2 - 1.0) + 1.0;
    let specular = a2 * 0.5 / (PI * d * d * mix(2.0 * n_l * p.n_v, n_l + p.n_v, p.alpha) + 1e-7);
    var sent = (p.diffuse * (1.0 - f) * (1.0 / PI) + f * specular) * (n_l * p.below_coat);
    if COAT {
        // Kelemen's visibility (2001): the film is smooth.
        let coat_n_l = max(dot(p.coat_normal, to_light), 1e-3);
        let coat_n_h = saturate((coat_n_l + p.coat_n_v) * half_length);
        let coat_a2 = COAT_ALPHA * COAT_ALPHA;
        let coat_d = coat_n_h * coat_n_h * (coat_a2 - 1.0) + 1.0;
        let film = p.wetness * (0.02 + 0.98 * bent);
        sent += film * coat_n_l * coat_a2 * 0.25 / (PI * coat_d * coat_d * max(v_h * v_h, 1e-3));
    }
    return frame.lights[index].candela * sent * share;
}

@fragment
fn shade(in: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let world = in.world_u.xyz;
    let to_eye = normalize(frame.eye.xyz - world);
    let geometric = normalize(select(-in.normal_v.xyz, in.normal_v.xyz, front));
    var at: At;
    at.world = world;
    at.uv = vec2f(in.world_u.w, in.normal_v.w);
    at.to_eye = to_eye;
    at.seconds = frame.eye.w;
    at.free = vec4f(1.0);
    at.edit = vec4f(0.0, 0.0, 0.0, 1.0);
    var s: Surface;
    s.color = item.base_color.rgb;
    s.opacity = item.base_color.a;
    s.normal = geometric;
    s.roughness = item.surface.x;
    s.metalness = item.surface.y;
    s.wetness = item.surface.z;
    s.occlusion = 1.0;
    s.glow = vec3f(0.0);

    var uv = at.uv * item.tiling;
    if NORMAL_MAP {
        let from_tangent = cotangent_frame(geometric, world, uv);
        if RELIEF {
            let gradient_x = dpdx(uv);
            let gradient_y = dpdy(uv);
            // How far a metre of surface is in texture coordinates.
            let metres = max(length(dpdx(world)) + length(dpdy(world)), 1e-9);
            let per_metre = (length(gradient_x) + length(gradient_y)) / metres;
            let texels = vec2f(textureDimensions(normal_map));
            let level = log2(max(length(gradient_x * texels), length(gradient_y * texels)));
            uv = relief(uv, transpose(from_tangent) * to_eye, item.surface.w * per_metre, level);
        }
        let bump = mapped(normal_map, uv).xyz * 2.0 - 1.0;
        s.normal = normalize(from_tangent * bump);
    }
    if COLOR_MAP {
        // Stored as square roots, which can be filtered as bytes and cost one product to undo.
        let color = mapped(color_map, uv);
        s.color *= color.rgb * color.rgb;
        s.opacity *= color.a;
    }
    if FREE_MAP {
        at.free = mapped(free_map, uv);
        // By default the free map holds roughness, wetness, metalness, occlusion, each scaling the material's own.
        s.roughness *= at.free.r;
        s.wetness *= at.free.g;
        s.metalness *= at.free.b;
        s.occlusion *= at.free.a;
    }
    if EDIT_MAP {
        at.edit = textureSample(edit_map, single, at.uv);
        s = edited(s, at);
    }
    s = surface(s, at);
    s.roughness = clamp(s.roughness, 0.045, 1.0);

    var p: Point;
    p.world = world;
    p.to_eye = to_eye;
    p.geometric = geometric;
    p.normal = s.normal;
    p.n_v = max(dot(s.normal, to_eye), 1e-3);
    p.f0 = mix(vec3f(0.04), s.color, s.metalness);
    p.diffuse = s.color * (1.0 - s.metalness);
    p.alpha = s.roughness * s.roughness;
    p.below_coat = 1.0;
    if COAT {
        // The film follows the coarse shape rather than the bumps.
        p.coat_normal = normalize(mix(s.normal, geometric, 0.45));
        p.coat_n_v = max(dot(p.coat_normal, to_eye), 1e-3);
        p.wetness = s.wetness;
        p.below_coat = 1.0 - s.wetness * (0.02 + 0.98 * grazing(p.coat_n_v));
    }
    // Written out: a loop would read the lights by a number that is not known when the pipeline is made.
    var radiance = reflected(0u, p, in.seen_0);
    if LIGHTS > 1u { radiance += reflected(1u, p, in.seen_1); }
    if LIGHTS > 2u { radiance += reflected(2u, p, vec4f(0.0)); }
    if LIGHTS > 3u { radiance += reflected(3u, p, vec4f(0.0)); }
    if LIGHTS > 4u { radiance += reflected(4u, p, vec4f(0.0)); }
    if LIGHTS > 5u { radiance += reflected(5u, p, vec4f(0.0)); }
    if LIGHTS > 6u { radiance += reflected(6u, p, vec4f(0.0)); }
    if LIGHTS > 7u { radiance += reflected(7u, p, vec4f(0.0)); }
    var around = surroundings(s.normal.z, 0.8) * p.diffuse
        + mirrored(reflect(-to_eye, s.normal), s.roughness) * environment_brdf(p.f0, s.roughness, p.n_v);
    if COAT {
        around = around * p.below_coat + mirrored(reflect(-to_eye, p.coat_normal), 0.1) * (1.0 - p.below_coat);
    }
    radiance += around * s.occlusion;
    return vec4f(tone(radiance + s.glow), s.opacity);
}

// Burns, blood and cuts, as the edit map tells of them.
fn edited(before: Surface, at: At) -> Surface {
    var s = before;
    // Coagulated tissue is pale and dry before it is black.
    let pale = min(2.0 * at.edit.r, 1.0);
    let black = max(2.0 * at.edit.r - 1.0, 0.0);
    s.color = mix(s.color, mix(vec3f(0.62, 0.52, 0.40), vec3f(0.012, 0.010, 0.009), black), pale);
    s.roughness = mix(s.roughness, 0.95, pale);
    let blood = at.edit.g;
    s.color = mix(s.color, vec3f(0.20, 0.004, 0.006), blood);
    s.wetness = mix(s.wetness, 1.0, blood);
    s.roughness = mix(s.roughness, 0.2, blood);
    s.color = mix(s.color, vec3f(0.32, 0.03, 0.03), at.edit.b);
    s.wetness *= at.edit.a;
    return s;
}
