// Khronos' neutral tone curve (2024): colours stay what they are up to the shoulder.
fn tone(color_in: vec3f) -> vec3f {
    let start = 0.8 - 0.04;
    let desaturation = 0.15;
    let low = min(color_in.r, min(color_in.g, color_in.b));
    let color = color_in - select(0.04, low - 6.25 * low * low, low < 0.08);
    let peak = max(color.r, max(color.g, color.b));
    let d = 1.0 - start;
    let new_peak = 1.0 - d * d / (max(peak, start) + d - start);
    let g = 1.0 / (desaturation * (peak - new_peak) + 1.0);
    let bright = mix(vec3f(new_peak), color * (new_peak / max(peak, start)), g);
    return select(bright, color, peak < start);
}

// Share of a light that its cone lets through.
fn cone(light: Light, to_light: vec3f) -> f32 {
    let t = saturate(light.cone_bias - dot(to_light, light.direction) * light.cone_scale);
    return t * t * (3.0 - 2.0 * t);
}
