// Physically based shading of surfaces with up to four maps and a wet coat.

override MAPS: bool = true;
override WET: bool = true;
override SHADOWS: bool = true;

@group(0) @binding(1) var shadow_maps: texture_depth_2d_array;
@group(0) @binding(2) var shadow_sampler: sampler_comparison;
@group(2) @binding(0) var color_map: texture_2d<f32>;
@group(2) @binding(1) var normal_map: texture_2d<f32>;
@group(2) @binding(2) var edit_map: texture_2d<f32>;
@group(2) @binding(3) var free_map: texture_2d<f32>;
@group(2) @binding(4) var tiled: sampler;
@group(2) @binding(5) var single: sampler;

const PI = 3.14159265;

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
fn relief(uv: vec2f, to_eye: vec3f, depth_in_uv: f32, gradient_x: vec2f, gradient_y: vec2f) -> vec2f {
    let steps = 12;
    let slope = to_eye.xy / max(to_eye.z, 0.2) * depth_in_uv;
    let step = 1.0 / f32(steps);
    var depth = 0.0;
    for (var i = 0; i < steps; i++) {
        let height = textureSampleGrad(normal_map, tiled, uv - slope * depth, gradient_x, gradient_y).a;
        if 1.0 - height <= depth { break; }
        depth += step;
    }
    var half_step = 0.5 * step;
    for (var i = 0; i < 4; i++) {
        let height = textureSampleGrad(normal_map, tiled, uv - slope * depth, gradient_x, gradient_y).a;
        depth += select(half_step, -half_step, 1.0 - height <= depth);
        half_step *= 0.5;
    }
    return uv - slope * depth;
}

// Share of a light that arrives: 3 x 3 comparisons, each between four texels.
fn lit(light: Light, world: vec3f, normal: vec3f) -> f32 {
    if light.shadow < 0 { return 1.0; }
    let distance = length(light.position - world);
    // Offset along the normal by what a texel covers there: no surface shades itself.
    let offset = world + normal * distance * frame.shadow_texel * 2.5;
    let clip = light.clip_from_world * vec4f(offset, 1.0);
    if clip.w <= 0.0 { return 1.0; }
    let at = clip.xyz / clip.w;
    let uv = vec2f(0.5 + 0.5 * at.x, 0.5 - 0.5 * at.y);
    if any(uv < vec2f(0.0)) || any(uv > vec2f(1.0)) || at.z >= 1.0 { return 1.0; }
    let texel = 1.0 / vec2f(textureDimensions(shadow_maps));
    var sum = 0.0;
    for (var y = -1; y <= 1; y++) {
        for (var x = -1; x <= 1; x++) {
            let place = uv + vec2f(f32(x), f32(y)) * texel;
            sum += textureSampleCompareLevel(shadow_maps, shadow_sampler, place, light.shadow, at.z - 2e-5);
        }
    }
    return sum / 9.0;
}

// GGX distribution with the height-correlated Smith visibility (Walter et al. 2007; Heitz 2014).
fn ggx(n_l: f32, n_v: f32, n_h: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = n_h * n_h * (a2 - 1.0) + 1.0;
    let distribution = a2 / (PI * d * d);
    let visibility = 0.5 / max(
        n_l * sqrt(n_v * n_v * (1.0 - a2) + a2) + n_v * sqrt(n_l * n_l * (1.0 - a2) + a2), 1e-5);
    return distribution * visibility;
}

fn fresnel(f0: vec3f, cosine: f32) -> vec3f {
    return f0 + (1.0 - f0) * pow(clamp(1.0 - cosine, 0.0, 1.0), 5.0);
}

// The surroundings seen in a direction: bright above, dim below, blurred with roughness. What is smooth also mirrors
// two bright panels overhead, so that steel looks like steel.
fn surroundings(direction: vec3f, roughness: f32) -> vec3f {
    let sharp = mix(3.0, 0.8, roughness);
    let up = clamp(0.5 + 0.5 * direction.z * sharp, 0.0, 1.0);
    let gloss = 1.0 - roughness;
    let panel = smoothstep(0.45, 0.75, direction.z) * smoothstep(0.9, 0.6, abs(abs(direction.x) - 0.45) * 2.5);
    let light = mix(frame.below.rgb, frame.above.rgb, smoothstep(0.0, 1.0, up));
    return light + frame.above.rgb * (panel * gloss * gloss * 6.0);
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

// Khronos' neutral tone curve (2024): colours stay what they are up to the shoulder.
fn tone(color_in: vec3f) -> vec3f {
    let start = 0.8 - 0.04;
    let desaturation = 0.15;
    var color = color_in;
    let low = min(color.r, min(color.g, color.b));
    let offset = select(0.04, low - 6.25 * low * low, low < 0.08);
    color -= offset;
    let peak = max(color.r, max(color.g, color.b));
    if peak < start { return color; }
    let d = 1.0 - start;
    let new_peak = 1.0 - d * d / (peak + d - start);
    color *= new_peak / peak;
    let g = 1.0 - 1.0 / (desaturation * (peak - new_peak) + 1.0);
    return mix(color, vec3f(new_peak), g);
}

fn falloff(light: Light, to_light: vec3f, distance: f32) -> f32 {
    let cosine = dot(-to_light, light.direction);
    return smoothstep(light.cos_outer, light.cos_inner, cosine) / max(distance * distance, 1e-6);
}

@fragment
fn shade(in: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let item = items[in.item];
    let to_eye = normalize(frame.eye.xyz - in.world);
    var geometric = normalize(in.normal);
    if !front { geometric = -geometric; }

    if !WET {
        // Plain: the first light with one Blinn-Phong highlight (Blinn 1977).
        let light = frame.lights[0];
        let offset = light.position - in.world;
        let distance = length(offset);
        let to_light = offset / distance;
        let arriving = light.candela * falloff(light, to_light, distance) * frame.above.w;
        let diffuse = max(dot(geometric, to_light), 0.0);
        let half = normalize(to_light + to_eye);
        let shine = pow(max(dot(geometric, half), 0.0), 40.0) * (1.0 - item.surface.x);
        let plain = item.base_color.rgb * (diffuse * arriving / PI + frame.above.rgb * frame.above.w)
            + shine * arriving * 0.1;
        return vec4f(tone(plain), item.base_color.a);
    }

    var s: Surface;
    s.color = item.base_color.rgb;
    s.opacity = item.base_color.a;
    s.normal = geometric;
    s.roughness = item.surface.x;
    s.metalness = item.surface.y;
    s.wetness = item.surface.z;
    s.occlusion = 1.0;
    s.glow = vec3f(0.0);
    var at: At;
    at.world = in.world;
    at.uv = in.uv;
    at.to_eye = to_eye;
    at.seconds = frame.eye.w;
    if MAPS {
        var uv = in.uv * item.tiling;
        let from_tangent = cotangent_frame(geometric, in.world, uv);
        let gradient_x = dpdx(uv);
        let gradient_y = dpdy(uv);
        // How far a metre of surface is in texture coordinates.
        let metres = max(length(dpdx(in.world)) + length(dpdy(in.world)), 1e-9);
        let per_metre = (length(gradient_x) + length(gradient_y)) / metres;
        if item.surface.w > 0.0 {
            let depth = item.surface.w * per_metre;
            uv = relief(uv, transpose(from_tangent) * to_eye, depth, gradient_x, gradient_y);
        }
        let color = textureSample(color_map, tiled, uv);
        s.color *= color.rgb;
        s.opacity *= color.a;
        let bump = textureSample(normal_map, tiled, uv).xyz * 2.0 - 1.0;
        s.normal = normalize(from_tangent * bump);
        at.free = textureSample(free_map, tiled, uv);
        // By default the free map holds roughness, wetness, metalness, occlusion, each scaling the material's own.
        s.roughness *= at.free.r;
        s.wetness *= at.free.g;
        s.metalness *= at.free.b;
        s.occlusion *= at.free.a;
        at.edit = textureSample(edit_map, single, in.uv);
        s = edited(s, at);
    }
    s = surface(s, at);
    s.roughness = clamp(s.roughness, 0.045, 1.0);

    let n_v = max(dot(s.normal, to_eye), 1e-3);
    let f0 = mix(vec3f(0.04), s.color, s.metalness);
    let diffuse_color = s.color * (1.0 - s.metalness);
    let alpha = s.roughness * s.roughness;
    // A film of water: it follows the coarse shape rather than the bumps.
    let coat_normal = normalize(mix(s.normal, geometric, 0.45));
    let coat_n_v = max(dot(coat_normal, to_eye), 1e-3);
    let coat_alpha = 0.012;
    let coat_share = s.wetness * fresnel(vec3f(0.02), coat_n_v).x;

    var radiance = vec3f(0.0);
    for (var i = 0u; i < frame.light_count; i++) {
        let light = frame.lights[i];
        let offset = light.position - in.world;
        let distance = length(offset);
        let to_light = offset / distance;
        let n_l = dot(s.normal, to_light);
        let facing = dot(geometric, to_light);
        if n_l <= 0.0 || facing <= 0.0 { continue; }
        var arriving = light.candela * falloff(light, to_light, distance);
        if SHADOWS { arriving *= lit(light, in.world, geometric); }
        let half = normalize(to_light + to_eye);
        let v_h = max(dot(to_eye, half), 0.0);
        let f = fresnel(f0, v_h);
        let specular = f * ggx(n_l, n_v, max(dot(s.normal, half), 0.0), alpha);
        let base = (diffuse_color * (1.0 - f) / PI + specular) * n_l;
        let coat_n_l = max(dot(coat_normal, to_light), 1e-3);
        let coat = s.wetness * fresnel(vec3f(0.02), v_h).x
            * ggx(coat_n_l, coat_n_v, max(dot(coat_normal, half), 0.0), coat_alpha) * coat_n_l;
        radiance += arriving * (base * (1.0 - coat_share) + coat);
    }
    let around = surroundings(s.normal, 1.0) * diffuse_color
        + surroundings(reflect(-to_eye, s.normal), s.roughness) * environment_brdf(f0, s.roughness, n_v);
    let around_coat = surroundings(reflect(-to_eye, coat_normal), 0.1) * coat_share;
    radiance += (around * (1.0 - coat_share) + around_coat) * s.occlusion;
    return vec4f(tone(radiance * frame.above.w + s.glow), s.opacity);
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
