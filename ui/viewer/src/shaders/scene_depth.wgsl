// Depth of the scene where every pixel has one sample.

@group(2) @binding(0) var scene_depth: texture_depth_2d;

fn scene_at(pixel: vec2i) -> f32 {
    return distance_of(textureLoad(scene_depth, pixel, 0));
}
