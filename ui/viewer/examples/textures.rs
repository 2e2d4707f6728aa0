//! A contact sheet of the procedural textures: each one flat (two by two tiles at half size, so that a seam would
//! show) and lit by one raking light.
//!
//! `cargo run --release -p trocar-viewer --example textures -- SHEET.png [NAME …]`

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::time::Instant;

use trocar_viewer::texture::{Image8, MapKind, MapSet, catalogue, image8, procedural};

/// Texels of a tile.
const SIZE: u32 = 512;
/// Side of one picture on the sheet, and the gap between two \[pixels\].
const SIDE: u32 = 300;
const GAP: u32 = 6;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().ok_or("usage: textures SHEET.png [NAME …]")?;
    let chosen: Vec<String> = arguments.collect();
    let names: Vec<&str> =
        if chosen.is_empty() { catalogue().to_vec() } else { chosen.iter().map(String::as_str).collect() };
    let columns = names.len().clamp(1, 3) as u32;
    let rows = (names.len() as u32).div_ceil(columns);
    let (width, height) = (columns * (2 * SIDE + 3 * GAP), rows * (SIDE + GAP) + GAP);
    let mut sheet = Image8::filled(width, height, [24, 24, 27, 255]);
    for (index, name) in names.iter().enumerate() {
        let start = Instant::now();
        let set = procedural(name, SIZE)?;
        let elapsed = start.elapsed();
        eprintln!("{name:>14}  {:5.1} ms  {:.0} mm", elapsed.as_secs_f64() * 1e3, f64::from(set.tile) * 1e3);
        let (column, row) = (index as u32 % columns, index as u32 / columns);
        let (left, top) = (column * (2 * SIDE + 3 * GAP) + GAP, row * (SIDE + GAP) + GAP);
        let half = set.color.half(MapKind::Color);
        draw(&mut sheet, [left, top], |x, y| {
            let [r, g, b, alpha] = half.get(x % half.width, y % half.height).unwrap_or_default();
            over([r, g, b].map(image8::linear_of_srgb), f32::from(alpha) / 255.0)
        });
        draw(&mut sheet, [left + SIDE + GAP, top], |x, y| lit(&set, x, y));
    }
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(&file)?), width, height);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header()?.write_image_data(sheet.bytes())?;
    Ok(())
}

fn draw(sheet: &mut Image8, [left, top]: [u32; 2], pixel: impl Fn(u32, u32) -> [f32; 3]) {
    for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
        let [r, g, b] = pixel(x, y).map(image8::srgb_of_linear);
        sheet.pixels[((top + y) * sheet.width + left + x) as usize] = [r, g, b, 255];
    }
}

/// A light over the sheet's ground.
fn over(light: [f32; 3], alpha: f32) -> [f32; 3] {
    light.map(|c| c * alpha + 0.02 * (1.0 - alpha))
}

/// One texel seen from straight above under a raking light from the upper left and a dim sky: Lambert, GGX, and a
/// film of fluid where it is wet.
fn lit(set: &MapSet, x: u32, y: u32) -> [f32; 3] {
    let at = |map: &Image8| map.get(x % map.width, y % map.height).unwrap_or_default();
    let [r, g, b, alpha] = at(&set.color);
    let base = [r, g, b].map(image8::linear_of_srgb);
    let normal = image8::decode_normal(at(&set.normal));
    let [roughness, wetness, metalness, open] = at(&set.surface).map(|value| f32::from(value) / 255.0);
    // The eye and the lamp are near, so that highlights gather rather than cover everything.
    let place = [x, y].map(|p| p as f32 / SIDE as f32 - 0.5);
    let to_light = unit([-0.75 - 0.5 * place[0], 0.75 + 0.5 * place[1], 0.85]);
    let to_eye = unit([-0.6 * place[0], 0.6 * place[1], 1.2]);
    let half = unit([0, 1, 2].map(|k| to_light[k] + to_eye[k]));
    let cosine = |a: [f32; 3], b: [f32; 3]| (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).max(0.0);
    let lambert = cosine(normal, to_light);
    let lobe = |roughness: f32| {
        let a = (roughness * roughness).max(0.002);
        let n = cosine(normal, half);
        let d = n * n * (a * a - 1.0) + 1.0;
        a * a / (std::f32::consts::PI * d * d) * 0.25 * lambert
    };
    let (dry, film) = (lobe(roughness), lobe(0.17) * wetness * 0.05);
    let color = [0, 1, 2].map(|k| {
        let reflectance = 0.04 + (base[k] - 0.04) * metalness;
        let diffuse = base[k] * (1.0 - metalness);
        let sky = (diffuse + reflectance * metalness) * 0.22 * open;
        sky + 1.15 * (diffuse * lambert * (0.4 + 0.6 * open) / 1.3 + reflectance * dry + film)
    });
    over(color, f32::from(alpha) / 255.0)
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|x| x / length)
}
