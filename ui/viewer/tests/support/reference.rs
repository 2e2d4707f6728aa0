//! Pictures that are kept, and what becomes of one that looks different.

use std::path::{Path, PathBuf};

use trocar_viewer::Picture;

use super::perceptual::{Difference, Limits};

/// Says `accept` to take what is drawn now as what is right.
const ACCEPT: &str = "TROCAR_REFERENCES";

/// Where the references are.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/references")
}

/// Compares a picture with its reference, or makes it the reference when that is asked for; otherwise what is wrong, with
/// what to do about it.
pub fn check(name: &str, seen: &Picture, drawn_by: &str) -> Result<(), String> {
    let accept = std::env::var(ACCEPT).is_ok_and(|value| value == "accept");
    check_in(&folder(), Path::new(env!("CARGO_TARGET_TMPDIR")), name, seen, drawn_by, accept)
}

/// As [`check`], with references in one folder and what differs written into `references` in another.
pub fn check_in(
    folder: &Path,
    scratch: &Path,
    name: &str,
    seen: &Picture,
    drawn_by: &str,
    accept: bool,
) -> Result<(), String> {
    let file = folder.join(format!("{name}.png"));
    let how = format!(
        "if it looks right: {ACCEPT}=accept cargo test --release -p trocar-viewer --test main references"
    );
    let kept = load(&file);
    let (verdict, difference) = match &kept {
        Err(reason) => (Some(format!("there is no reference to compare it with ({reason})")), None),
        Ok(kept) => match Difference::between(kept, seen) {
            None => {
                let size = |picture: &Picture| format!("{} × {}", picture.width, picture.height);
                (Some(format!("it has {} pixels, the reference {}", size(seen), size(kept))), None)
            }
            Some(difference) => {
                let limits = Limits::default();
                let picture = difference.picture(kept, &limits);
                eprintln!("{name}: {}", difference.describe(&limits));
                (difference.beyond(&limits), Some(picture))
            }
        },
    };
    let Some(verdict) = verdict else { return Ok(()) };
    if accept {
        return save(seen, &file);
    }
    let scratch = scratch.join("references");
    let mine = scratch.join(format!("{name}.png"));
    save(seen, &mine)?;
    let mut told = format!("{name}: {verdict}; drawn by {drawn_by}\n  drawn now:  {}", mine.display());
    if let Some(difference) = difference {
        let file_of_difference = scratch.join(format!("{name}.difference.png"));
        save(&difference, &file_of_difference)?;
        told +=
            &format!("\n  reference:  {}\n  difference: {}", file.display(), file_of_difference.display());
    }
    Err(format!("{told}\n  {how}"))
}

/// Names of the references that there are, in order.
pub fn names() -> Vec<String> {
    let entries = std::fs::read_dir(folder()).expect("the folder of references");
    let files = entries.map(|entry| entry.expect("an entry").path());
    let mut names: Vec<String> = files
        .filter(|file| file.extension().is_some_and(|extension| extension == "png"))
        .map(|file| file.file_stem().expect("a name").to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

fn load(file: &Path) -> Result<Picture, String> {
    let read = image::open(file).map_err(|error| format!("{}: {error}", file.display()))?.into_rgba8();
    let (width, height) = read.dimensions();
    Ok(Picture { width, height, color: read.into_raw().as_chunks().0.to_vec() })
}

/// Without opacity, which pictures of scenes do not have, as small as PNG gets.
fn save(picture: &Picture, file: &Path) -> Result<(), String> {
    use image::ImageEncoder;
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let failed = |reason: &dyn std::fmt::Display| format!("{}: {reason}", file.display());
    let bytes: Vec<u8> = picture.color.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive)
        .write_image(&bytes, picture.width, picture.height, image::ExtendedColorType::Rgb8)
        .map_err(|error| failed(&error))?;
    std::fs::create_dir_all(file.parent().unwrap_or(Path::new("."))).map_err(|error| failed(&error))?;
    std::fs::write(file, png).map_err(|error| failed(&error))
}
