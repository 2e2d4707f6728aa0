// Depth of the scene where every pixel has four samples: the farthest of them. What is before that is hidden sample by
// sample.

@group(2) @binding(0) var scene_depth: texture_depth_multisampled_2d;

fn scene_at(pixel: vec2i) -> f32 {
    let near_pair = max(textureLoad(scene_depth, pixel, 0), textureLoad(scene_depth, pixel, 1));
    let far_pair = max(textureLoad(scene_depth, pixel, 2), textureLoad(scene_depth, pixel, 3));
    return distance_of(max(near_pair, far_pair));
}
