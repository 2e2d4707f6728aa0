// One thing to draw: where it is and what it is like. Every pass has the list of all of them.

struct Item {
    world_from_item: mat4x4f,
    base_color: vec4f,
    // Roughness, metalness, wetness, depth of the relief [m].
    surface: vec4f,
    tiling: vec2f,
    // Number in a segmentation picture.
    number: u32,
    flags: u32,
}

@group(1) @binding(0) var<storage, read> items: array<Item>;
