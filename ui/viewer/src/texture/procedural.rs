//! The catalogue of procedural textures.

use super::error::TextureError;
use super::image8::MapKind;
use super::recipe::{MapSet, Recipe};
use super::{technical, textile, tissue, viscera};

/// Smallest size of a procedural texture \[texels\].
pub const SIZE_MIN: u32 = 64;
/// Largest size of a procedural texture \[texels\].
pub const SIZE_MAX: u32 = 2048;

const RECIPES: [&Recipe; 20] = [
    &tissue::LIVER,
    &viscera::GALLBLADDER,
    &viscera::STOMACH,
    &viscera::BOWEL,
    &tissue::FAT,
    &viscera::PERITONEUM,
    &tissue::MUSCLE,
    &tissue::SKIN,
    &tissue::BLOOD,
    &textile::GAUZE,
    &textile::INK_CIRCLE,
    &textile::DRAPE,
    &technical::FOAM,
    &technical::BRUSHED_METAL,
    &technical::STEEL,
    &technical::PLASTIC,
    &technical::RUBBER,
    &technical::BOARD,
    &textile::SUTURE,
    &technical::CHECKER,
];

const NAMES: [&str; RECIPES.len()] = {
    let mut names = [""; RECIPES.len()];
    let mut index = 0;
    while index < RECIPES.len() {
        names[index] = RECIPES[index].name;
        index += 1;
    }
    names
};

/// The names of all procedural textures.
pub fn catalogue() -> &'static [&'static str] {
    &NAMES
}

/// Makes a procedural texture of `size × size` texels.
///
/// # Errors
/// When no texture has that name, or `size` is not a power of two from [`SIZE_MIN`] to [`SIZE_MAX`].
pub fn procedural(name: &str, size: u32) -> Result<MapSet, TextureError> {
    let recipe = RECIPES
        .iter()
        .find(|recipe| recipe.name == name)
        .ok_or_else(|| TextureError::Unknown { name: name.to_owned(), valid: &NAMES })?;
    if !size.is_power_of_two() || !(SIZE_MIN..=SIZE_MAX).contains(&size) {
        return Err(TextureError::Size { name: recipe.name, size, min: SIZE_MIN, max: SIZE_MAX });
    }
    let mut set = recipe.make(size.max(recipe.drawn_min));
    while set.color.width > size {
        set.color = set.color.half(MapKind::Color);
        set.normal = set.normal.half(MapKind::Normal);
        set.surface = set.surface.half(MapKind::Linear);
    }
    Ok(set)
}

#[cfg(test)]
mod tests {
    use super::super::image8::Image8;
    use super::*;

    #[test]
    fn every_texture_is_made_and_fills_its_maps() {
        for name in catalogue() {
            let set = procedural(name, 128).expect("it is in the catalogue");
            for map in [&set.color, &set.normal, &set.surface] {
                assert_eq!((map.width, map.height, map.pixels.len()), (128, 128, 128 * 128), "{name}");
            }
            assert!(set.tile > 0.0 && set.relief >= 0.0, "{name}");
            for pixel in &set.normal.pixels {
                let [x, y, z] = super::super::image8::decode_normal(*pixel);
                assert!(z > 0.0 && ((x * x + y * y + z * z).sqrt() - 1.0).abs() < 0.02, "{name}: {pixel:?}");
            }
        }
    }

    /// Texels across the seam differ no more than neighbours elsewhere.
    #[test]
    fn every_texture_tiles_without_a_seam() {
        for name in catalogue() {
            let set = procedural(name, 256).expect("it is in the catalogue");
            for (map, what) in [(&set.color, "colour"), (&set.normal, "normal"), (&set.surface, "surface")] {
                let step = |x: u32, y: u32, right: bool| -> f64 {
                    let (nx, ny) = if right { ((x + 1) % 256, y) } else { (x, (y + 1) % 256) };
                    let (a, b) = (map.get(x, y).expect("inside"), map.get(nx, ny).expect("inside"));
                    (0..4).map(|c| f64::from(a[c].abs_diff(b[c])).powi(2)).sum()
                };
                for right in [true, false] {
                    let line = |at: u32| -> f64 {
                        (0..256).map(|k| if right { step(at, k, true) } else { step(k, at, false) }).sum()
                    };
                    let elsewhere = (0..255).map(line).fold(0.0, f64::max);
                    assert!(
                        line(255) <= elsewhere * 1.05 + 1.0,
                        "{name}: {what}: {} > {elsewhere}",
                        line(255)
                    );
                }
            }
        }
    }

    #[test]
    fn a_texture_looks_the_same_in_every_size_and_every_time() {
        for name in catalogue() {
            let sets = [64, 512].map(|size| procedural(name, size).expect("it is in the catalogue"));
            let mean = |map: &Image8, value: &dyn Fn(&[u8; 4]) -> f32| {
                map.pixels.iter().map(|p| f64::from(value(p))).sum::<f64>() / map.pixels.len() as f64
            };
            for c in 0..4 {
                let light = |p: &[u8; 4]| match c {
                    3 => f32::from(p[3]) / 255.0,
                    _ => super::super::image8::linear_of_srgb(p[c]) * f32::from(p[3]) / 255.0,
                };
                let [small, large] = [0, 1].map(|k| mean(&sets[k].color, &light));
                assert!((small - large).abs() < 0.03, "{name}: channel {c}: {small} and {large}");
                let [small, large] = [0, 1].map(|k| mean(&sets[k].surface, &|p| f32::from(p[c]) / 255.0));
                assert!((small - large).abs() < 0.05, "{name}: surface {c}: {small} and {large}");
            }
            assert_eq!(procedural(name, 64).ok().as_ref(), Some(&sets[0]), "{name}");
        }
    }

    #[test]
    fn textures_differ_in_what_they_stand_for() {
        let center = |name: &str, channel: usize| {
            let set = procedural(name, 64).expect("it is in the catalogue");
            set.surface.pixels.iter().map(|p| u32::from(p[channel])).sum::<u32>() / 4096
        };
        assert!(center("liver", 1) > 200 && center("gauze", 1) == 0, "tissue is wet, cotton is not");
        assert!(center("steel", 2) == 255 && center("plastic", 2) == 0);
        assert!(center("rubber", 0) > center("steel", 0));
        let gauze = procedural("gauze", 256).expect("it is in the catalogue");
        let holes = gauze.color.pixels.iter().filter(|p| p[3] == 0).count();
        assert!((3000..40_000).contains(&holes), "{holes} of 65536");
    }

    #[test]
    fn wrong_names_and_sizes_are_refused_with_the_valid_ones() {
        let message = |name, size| procedural(name, size).expect_err("it is refused").to_string();
        let unknown = message("livr", 64);
        assert!(
            unknown.contains("\"livr\"; did you mean \"liver\"?") && unknown.contains("peritoneum"),
            "{unknown}"
        );
        assert!(!message("quartz", 64).contains("did you mean"));
        for size in [0, 1, 32, 100, 4096, u32::MAX] {
            assert!(message("liver", size).contains("powers of two from 64 to 2048"), "{size}");
        }
        assert!(procedural("checker", 2048).is_ok());
        assert_eq!(catalogue().len(), 20);
    }

    #[test]
    fn the_checker_is_dark_in_its_upper_left_corner() {
        let set = procedural("checker", 64).expect("it is in the catalogue");
        let red = |x, y| set.color.get(x, y).map(|p| p[0]);
        assert_eq!([red(0, 0), red(7, 7), red(8, 0), red(0, 8), red(8, 8)], [51, 51, 204, 204, 51].map(Some));
    }
}
