//! Reads image files, with limits on path and size.

use std::fs::File;
use std::io::{BufReader, ErrorKind};
use std::path::{Path, PathBuf};

use image::{ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use trocar_scene::confined_path;

use super::error::TextureError;
use super::image8::Image8;

/// Longest image file \[bytes\].
pub const FILE_BYTES_MAX: u64 = 64 << 20;

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
    let mut reader = ImageReader::new(BufReader::new(opened)).with_guessed_format().map_err(io)?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err(TextureError::Kind { file: file.into() });
    }
    let mut limits = Limits::default();
    // Four channels of sixteen bits, decoded and converted, and the decoder's own tables.
    limits.max_alloc = Some(u64::from(size_max).pow(2).saturating_mul(16).saturating_add(1 << 20));
    reader.limits(limits);
    let malformed = |error: ImageError| match error {
        ImageError::IoError(source) if source.kind() != ErrorKind::UnexpectedEof => io(source),
        other => TextureError::Malformed { file: file.into(), reason: other.to_string() },
    };
    let decoder = reader.into_decoder().map_err(malformed)?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err(TextureError::Malformed { file: file.into(), reason: "it has no texels".to_owned() });
    }
    if width.max(height) > size_max {
        return Err(too_large("a size in texels of", u64::from(width.max(height)), u64::from(size_max)));
    }
    let rgba = image::DynamicImage::from_decoder(decoder).map_err(malformed)?.into_rgba8();
    let pixels = rgba.pixels().map(|pixel| pixel.0).collect();
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
