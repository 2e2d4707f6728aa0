// The least that shows a scene: the strongest light with one highlight, one colour for each thing.

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
}

@vertex
fn corner(@location(0) position: vec3f, @location(1) normal: vec3f) -> Corner {
    let world = item.world_from_item * vec4f(position, 1.0);
    // Rigid: normals turn like everything else.
    return Corner(
        frame.clip_from_world * world, world.xyz, (item.world_from_item * vec4f(normal, 0.0)).xyz);
}

@fragment
fn shade(in: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let offset = frame.lights[0].position - in.world;
    let nearness = inverseSqrt(dot(offset, offset));
    let to_light = offset * nearness;
    let to_eye = normalize(frame.eye.xyz - in.world);
    let normal = normalize(select(-in.normal, in.normal, front));
    let arriving = frame.lights[0].candela
        * (cone(frame.lights[0], to_light) * nearness * nearness);
    let diffuse = max(dot(normal, to_light), 0.0) / 3.14159265;
    // Blinn's highlight (1977) to the 32nd power.
    let towards = dot(to_light, to_eye);
    let n_h = max(dot(normal, to_light + to_eye), 0.0) * inverseSqrt(max(2.0 + 2.0 * towards, 1e-4));
    let p2 = n_h * n_h;
    let p4 = p2 * p2;
    let p8 = p4 * p4;
    let p16 = p8 * p8;
    let shine = p16 * p16 * 0.1 * (1.0 - item.surface.x);
    let color = item.mean_color.rgb * (diffuse * arriving + frame.above.rgb) + shine * arriving;
    return vec4f(tone(color), item.mean_color.a);
}
