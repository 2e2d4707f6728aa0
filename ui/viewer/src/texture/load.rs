//! Reads image files, with limits on path and size.

use std::fs::File;
use std::io::{Cursor, ErrorKind, Read};
use std::path::{Path, PathBuf};

use png::{BitDepth, ColorType, Transformations};
use trocar_scene::confined_path;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::error::TextureError;
use super::image8::Image8;

/// Longest image file \[bytes\].
pub const FILE_BYTES_MAX: u64 = 64 << 20;
/// First bytes of the two formats.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
const JPEG: &[u8] = b"\xff\xd8\xff";

/// The path of a material's file, below the scenario's folder `base`.
///
/// # Errors
/// When the path leaves the folder, also through a link, or is invalid.
pub fn resolve(base: &Path, file: &str) -> Result<PathBuf, TextureError> {
    confined_path::below(base, file).map_err(|reason| TextureError::Path { path: file.to_owned(), reason })
}

/// Reads a PNG or JPEG image of at most `size_max` texels each way. Its first bytes decide the format, not its name.
/// Images without opacity are opaque.
///
/// # Errors
/// When the file cannot be read, is longer than [`FILE_BYTES_MAX`], is of another format, is damaged, or declares more
/// than `size_max` texels (checked before anything is decoded).
pub fn load(file: &Path, size_max: u32) -> Result<Image8, TextureError> {
    let io = |source| TextureError::Io { file: file.into(), source };
    let opened = File::open(file).map_err(io)?;
    let facts = opened.metadata().map_err(io)?;
    if !facts.is_file() {
        return Err(io(std::io::Error::new(ErrorKind::InvalidInput, "is no file")));
    }
    let too_large = |what, found, limit| TextureError::TooLarge { file: file.into(), what, found, limit };
    if facts.len() > FILE_BYTES_MAX {
        return Err(too_large("a length in bytes of", facts.len(), FILE_BYTES_MAX));
    }
    let mut bytes = Vec::with_capacity(facts.len() as usize);
    opened.take(FILE_BYTES_MAX).read_to_end(&mut bytes).map_err(io)?;
    let image = if bytes.starts_with(PNG) {
        read_png(&bytes, size_max)
    } else if bytes.starts_with(JPEG) {
        read_jpeg(&bytes, size_max)
    } else {
        return Err(TextureError::Kind { file: file.into() });
    };
    image.map_err(|refused| match refused {
        Refused::TooLarge(size) => too_large("a size in texels of", u64::from(size), u64::from(size_max)),
        Refused::Malformed(reason) => TextureError::Malformed { file: file.into(), reason },
    })
}

/// Why an image is not decoded.
enum Refused {
    /// The larger of its sizes exceeds the limit \[texels\].
    TooLarge(u32),
    Malformed(String),
}

fn malformed(error: impl ToString) -> Refused {
    Refused::Malformed(error.to_string())
}

fn check_size([width, height]: [u32; 2], size_max: u32) -> Result<(), Refused> {
    if width == 0 || height == 0 {
        return Err(malformed("it has no texels"));
    }
    let larger = width.max(height);
    if larger > size_max { Err(Refused::TooLarge(larger)) } else { Ok(()) }
}

fn read_png(bytes: &[u8], size_max: u32) -> Result<Image8, Refused> {
    // The decoder's own tables: the texels' buffer is ours.
    let limits = png::Limits { bytes: 1 << 20 };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    // Palettes become colours, fewer bits than eight become eight.
    decoder.set_transformations(Transformations::EXPAND);
    let header = decoder.read_header_info().map_err(malformed)?;
    let (width, height) = (header.width, header.height);
    check_size([width, height], size_max)?;
    let mut reader = decoder.read_info().map_err(malformed)?;
    let mut samples =
        vec![0; reader.output_buffer_size().ok_or_else(|| malformed("it is too large for this machine"))?];
    let frame = reader.next_frame(&mut samples).map_err(malformed)?;
    if frame.bit_depth == BitDepth::Sixteen {
        samples = samples.chunks_exact(2).map(|pair| eight_bits([pair[0], pair[1]])).collect();
    }
    let pixels: Vec<[u8; 4]> = match frame.color_type {
        ColorType::Grayscale => samples.iter().map(|&grey| [grey, grey, grey, 255]).collect(),
        ColorType::GrayscaleAlpha => samples.chunks_exact(2).map(|s| [s[0], s[0], s[0], s[1]]).collect(),
        ColorType::Rgb => samples.chunks_exact(3).map(|s| [s[0], s[1], s[2], 255]).collect(),
        ColorType::Rgba => samples.chunks_exact(4).map(|s| [s[0], s[1], s[2], s[3]]).collect(),
        ColorType::Indexed => return Err(malformed("its palette is missing")),
    };
    if pixels.len() != width as usize * height as usize {
        return Err(malformed("it has another size than it declares"));
    }
    Ok(Image8 { width, height, pixels })
}

/// A sample of sixteen bits, big-endian, as the nearest one of eight.
fn eight_bits(sample: [u8; 2]) -> u8 {
    ((u32::from(u16::from_be_bytes(sample)) * 255 + 32_767) / 65_535) as u8
}

fn read_jpeg(bytes: &[u8], size_max: u32) -> Result<Image8, Refused> {
    // Sizes are checked here, with an error of our own. As other programs do, go on over small faults.
    let options = DecoderOptions::default()
        .set_strict_mode(false)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX)
        .jpeg_set_out_colorspace(ColorSpace::RGBA);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(malformed)?;
    let info = decoder.info().ok_or_else(|| malformed("it has no header"))?;
    let (width, height) = (u32::from(info.width), u32::from(info.height));
    check_size([width, height], size_max)?;
    let pixels: Vec<[u8; 4]> =
        decoder.decode().map_err(malformed)?.chunks_exact(4).map(|s| [s[0], s[1], s[2], s[3]]).collect();
    if pixels.len() != width as usize * height as usize {
        return Err(malformed("it has another size than it declares"));
    }
    Ok(Image8 { width, height, pixels })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().expect("a temporary folder")
    }

    fn written(folder: &Path, name: &str, width: u32, height: u32) -> PathBuf {
        let file = folder.join(name);
        let picture =
            image::RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8 * 20, y as u8 * 20, 7]));
        picture.save(&file).expect("the picture is written");
        file
    }

    #[test]
    fn pictures_of_any_size_are_read_by_what_they_are() {
        let folder = folder();
        let png = written(folder.path(), "odd.png", 5, 3);
        let image = load(&png, 64).expect("a sound file");
        assert_eq!((image.width, image.height), (5, 3));
        assert_eq!(image.get(4, 2), Some([80, 40, 7, 255]));
        assert_eq!(image.get(5, 0), None);
        let jpeg = written(folder.path(), "photo.jpg", 8, 8);
        let misnamed = folder.path().join("photo.png");
        std::fs::rename(jpeg, &misnamed).expect("the file moves");
        assert_eq!(load(&misnamed, 64).expect("a sound file").pixels.len(), 64);
    }

    /// Every kind of PNG that the format allows, and grey JPEG, as the library `image` reads them.
    #[test]
    fn every_kind_of_image_gives_the_texels_that_another_reader_gives() {
        use png::BitDepth::{Eight, Four, One, Sixteen, Two};
        let folder = folder();
        let file = folder.path().join("kind.png");
        let [width, height] = [13, 7];
        let mut random = trocar_scene::random::SplitMix64::new(5);
        let kinds = [
            (ColorType::Grayscale, 1, &[One, Two, Four, Eight, Sixteen][..]),
            (ColorType::GrayscaleAlpha, 2, &[Eight, Sixteen]),
            (ColorType::Rgb, 3, &[Eight, Sixteen]),
            (ColorType::Rgba, 4, &[Eight, Sixteen]),
            (ColorType::Indexed, 1, &[One, Two, Four, Eight]),
        ];
        for (color, channels, depths) in kinds {
            for &depth in depths {
                for transparent in [false, true] {
                    let mut encoder = png::Encoder::new(File::create(&file).expect("a file"), width, height);
                    encoder.set_color(color);
                    encoder.set_depth(depth);
                    if color == ColorType::Indexed {
                        let colors = 3 << depth as usize;
                        encoder.set_palette((0..colors).map(|_| random.next_u64() as u8).collect::<Vec<_>>());
                        if transparent {
                            encoder.set_trns(vec![0, 100]);
                        }
                    } else if transparent && channels % 2 == 1 {
                        encoder.set_trns([0, 1].repeat(channels));
                    }
                    let line = (width as usize * channels * depth as usize).div_ceil(8);
                    let samples: Vec<u8> =
                        (0..line * height as usize).map(|_| random.next_u64() as u8).collect();
                    let mut writer = encoder.write_header().expect("a header");
                    writer.write_image_data(&samples).expect("texels");
                    writer.finish().expect("an image");
                    let wanted = image::open(&file).expect("a sound file").into_rgba8();
                    let found = load(&file, 64).expect("a sound file");
                    assert!(
                        wanted.pixels().map(|pixel| pixel.0).eq(found.pixels.iter().copied()),
                        "{color:?} {depth:?} {transparent}"
                    );
                }
            }
        }
        let file = folder.path().join("grey.jpg");
        let grey = image::GrayImage::from_fn(20, 9, |x, y| image::Luma([(x * 11 + y * 3) as u8]));
        grey.save(&file).expect("the picture is written");
        let wanted = image::open(&file).expect("a sound file").into_rgba8();
        let found = load(&file, 64).expect("a sound file");
        assert!(wanted.pixels().map(|pixel| pixel.0).eq(found.pixels.iter().copied()));
    }

    #[test]
    fn what_cannot_be_used_is_refused_by_name_and_reason() {
        let folder = folder();
        let file = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).expect("the file is written");
            path
        };
        let message = |path: &Path, size_max| load(path, size_max).expect_err("it is refused").to_string();
        let large = written(folder.path(), "large.png", 9, 3);
        assert!(message(&large, 8).contains("large.png: a size in texels of 9 is more than the limit of 8"));
        assert!(message(&file("text.png", b"no picture"), 8).contains("valid are PNG and JPEG"));
        assert!(message(&file("empty.jpg", b""), 8).contains("valid are PNG and JPEG"));
        assert!(
            message(&file("moving.gif", b"GIF89a\x01\0\x01\0\0\0\0"), 8).contains("valid are PNG and JPEG")
        );
        assert!(message(&folder.path().join("missing.png"), 8).contains("missing.png: cannot be read"));
        assert!(message(folder.path(), 8).contains("is no file"));
    }

    #[test]
    fn damaged_files_never_harm() {
        let folder = folder();
        let png = std::fs::read(written(folder.path(), "a.png", 16, 16)).expect("it was written");
        let jpeg = std::fs::read(written(folder.path(), "a.jpg", 16, 16)).expect("it was written");
        let target = folder.path().join("damaged");
        let mut random = trocar_scene::random::SplitMix64::new(3);
        let mut refused = 0;
        for bytes in [&png, &jpeg] {
            for _ in 0..400 {
                let mut damaged = bytes.clone();
                for _ in 0..1 + random.next_u64() % 4 {
                    let at = random.next_u64() as usize % damaged.len();
                    damaged[at] = random.next_u64() as u8;
                }
                damaged.truncate(
                    bytes.len()
                        - (random.next_u64() as usize % bytes.len()) * (random.next_u64() % 2) as usize,
                );
                std::fs::write(&target, &damaged).expect("the file is written");
                match load(&target, 64) {
                    Ok(image) => assert!(image.width <= 64 && image.height <= 64),
                    Err(error) => {
                        assert!(error.to_string().contains("damaged"), "{error}");
                        refused += 1;
                    }
                }
            }
        }
        assert!(refused > 300, "{refused}");
        // A header that declares 4 gigatexels in a file of a few bytes.
        let mut huge = png.clone();
        huge[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
        std::fs::write(&target, &huge).expect("the file is written");
        assert!(load(&target, 4096).is_err());
    }

    #[test]
    fn paths_stay_below_their_folder() {
        let folder = folder();
        assert_eq!(resolve(folder.path(), "maps/a.png").ok(), Some(folder.path().join("maps/a.png")));
        for bad in ["../a.png", "/etc/passwd", "", "a\\b"] {
            let error = resolve(folder.path(), bad).expect_err("it is refused").to_string();
            assert!(error.starts_with(&format!("{bad:?}: ")), "{error}");
        }
    }
}
