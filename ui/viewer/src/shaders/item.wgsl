// One thing to draw: where it is and what it is like. It is bound anew for each of them.

struct Item {
    world_from_item: mat4x4f,
    base_color: vec4f,
    // Roughness, metalness, wetness, depth of the relief [m].
    surface: vec4f,
    tiling: vec2f,
    // Number in a segmentation picture.
    number: u32,
    flags: u32,
    // Base colour times the mean of the colour map.
    mean_color: vec4f,
}

@group(1) @binding(0) var<uniform> item: Item;
