//! Films: a folder of frames, an animated PNG or a GIF.

use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::error::ViewError;
use crate::picture::Picture;

/// Most frames of one film: hours of it, and no more than the frame counter of an animated PNG can hold.
const FRAMES_MAX: u32 = 1_000_000;
/// Latest offset of the frame-count chunk in an animated PNG \[bytes\].
const HEAD: usize = 4096;

/// The format of the film.
enum Kind {
    /// `frame-00001.png` and so on, in a folder.
    Folder(PathBuf),
    Apng(Box<png::Writer<BufWriter<File>>>),
    Gif(Box<gif::Encoder<BufWriter<File>>>),
}

/// A film in progress. Until [`Film::finish`] its file has a temporary name.
pub struct Film {
    kind: Option<Kind>,
    file: PathBuf,
    size: [u32; 2],
    frames_per_second: f64,
    frames: u32,
}

impl Film {
    /// `file` ends in `.gif` or `.png` (animated), or is a folder for single frames.
    ///
    /// # Errors
    /// [`ViewError::File`].
    pub fn create(file: &Path, size: [u32; 2], frames_per_second: f64) -> Result<Self, ViewError> {
        let rate = frames_per_second;
        if !(0.1..=240.0).contains(&rate) {
            return Err(failed(file, &format!("{rate} frames per second: 0.1 to 240 are possible")));
        }
        let mut film = Self { kind: None, file: file.to_owned(), size, frames_per_second, frames: 0 };
        let extension =
            file.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
        film.kind = Some(match extension.as_deref() {
            Some("png" | "apng") => Kind::Apng(Box::new(film.apng()?)),
            Some("gif") => Kind::Gif(Box::new(film.gif()?)),
            Some(other) if !file.is_dir() => {
                return Err(failed(
                    file,
                    &format!("'.{other}' is no film: .png, .gif, or a folder for frames"),
                ));
            }
            _ => {
                std::fs::create_dir_all(file).map_err(|error| failed(file, &error))?;
                Kind::Folder(file.to_owned())
            }
        });
        Ok(film)
    }

    /// Temporary name of an incomplete film.
    fn partial(&self) -> PathBuf {
        let mut name = self.file.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        self.file.with_file_name(name)
    }

    fn open(&self) -> Result<BufWriter<File>, ViewError> {
        File::create(self.partial()).map(BufWriter::new).map_err(|error| failed(&self.file, &error))
    }

    fn apng(&self) -> Result<png::Writer<BufWriter<File>>, ViewError> {
        let error = |error: png::EncodingError| failed(&self.file, &error);
        let mut encoder = png::Encoder::new(self.open()?, self.size[0], self.size[1]);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        // The true number is written at the end.
        encoder.set_animated(FRAMES_MAX, 0).map_err(error)?;
        let delay = (1000.0 / self.frames_per_second).round().clamp(1.0, f64::from(u16::MAX)) as u16;
        encoder.set_frame_delay(delay, 1000).map_err(error)?;
        encoder.write_header().map_err(error)
    }

    fn gif(&self) -> Result<gif::Encoder<BufWriter<File>>, ViewError> {
        let side =
            |pixels: u32| u16::try_from(pixels).map_err(|_| failed(&self.file, &"too large for a GIF"));
        let error = |error: gif::EncodingError| failed(&self.file, &error);
        let mut encoder =
            gif::Encoder::new(self.open()?, side(self.size[0])?, side(self.size[1])?, &[]).map_err(error)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(error)?;
        Ok(encoder)
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// [`ViewError::File`]: also when the picture has another size than the film.
    pub fn frame(&mut self, picture: &Picture) -> Result<(), ViewError> {
        if [picture.width, picture.height] != self.size {
            return Err(failed(&self.file, &"a frame has another size than the film"));
        }
        if self.frames >= FRAMES_MAX {
            return Err(failed(&self.file, &"the film is too long"));
        }
        self.frames += 1;
        let file = &self.file;
        match self.kind.as_mut() {
            Some(Kind::Folder(folder)) => picture.save(&folder.join(format!("frame-{:05}.png", self.frames))),
            Some(Kind::Apng(writer)) => {
                writer.write_image_data(picture.color.as_flattened()).map_err(|error| failed(file, &error))
            }
            Some(Kind::Gif(encoder)) => {
                let mut pixels = picture.color.as_flattened().to_vec();
                let (width, height) = (self.size[0] as u16, self.size[1] as u16);
                let mut frame = gif::Frame::from_rgba_speed(width, height, &mut pixels, 10);
                frame.delay = (100.0 / self.frames_per_second).round().max(1.0) as u16;
                encoder.write_frame(&frame).map_err(|error| failed(file, &error))
            }
            None => Ok(()),
        }
    }

    /// Completes the film; returns the number of its frames.
    ///
    /// # Errors
    /// [`ViewError::File`].
    pub fn finish(mut self) -> Result<u32, ViewError> {
        let kind = self.kind.take();
        let (file, partial) = (self.file.clone(), self.partial());
        let wrong = |error: &dyn std::fmt::Display| failed(&file, error);
        match kind {
            Some(Kind::Apng(writer)) => {
                writer.finish().map_err(|error| wrong(&error))?;
                count_frames(&partial, self.frames).map_err(|error| wrong(&error))?;
            }
            Some(Kind::Gif(encoder)) => {
                let mut out = encoder.into_inner().map_err(|error| wrong(&error))?;
                out.flush().map_err(|error| wrong(&error))?;
            }
            Some(Kind::Folder(_)) | None => return Ok(self.frames),
        }
        std::fs::rename(&partial, &file).map_err(|error| wrong(&error))?;
        Ok(self.frames)
    }
}

impl Drop for Film {
    fn drop(&mut self) {
        // Not finished: an incomplete film is removed.
        if let Some(Kind::Apng(_) | Kind::Gif(_)) = self.kind.take() {
            let _ = std::fs::remove_file(self.partial());
        }
    }
}

/// Writes the number of frames into an animated PNG.
fn count_frames(file: &Path, frames: u32) -> std::io::Result<()> {
    let mut file = File::options().read(true).write(true).open(file)?;
    let mut head = vec![0; HEAD];
    let mut read = 0;
    while read < HEAD {
        match file.read(&mut head[read..])? {
            0 => break,
            more => read += more,
        }
    }
    // Type, number of frames, number of plays; the checksum covers all three.
    let at = head[..read].windows(4).position(|window| window == b"acTL");
    let at = at.ok_or_else(|| std::io::Error::other("the count of frames has no place"))?;
    let mut chunk = [0; 12];
    chunk.copy_from_slice(&head[at..at + 12]);
    chunk[4..8].copy_from_slice(&frames.to_be_bytes());
    file.seek(SeekFrom::Start(at as u64))?;
    file.write_all(&chunk)?;
    file.write_all(&crc32fast::hash(&chunk).to_be_bytes())
}

fn failed(file: &Path, reason: &dyn std::fmt::Display) -> ViewError {
    ViewError::File { file: file.display().to_string(), reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(shade: u8) -> Picture {
        Picture { width: 8, height: 6, color: vec![[shade, 10, 20, 255]; 48] }
    }

    #[test]
    fn an_animated_png_says_how_many_frames_it_has_and_gives_them_back() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("film.png");
        let mut film = Film::create(&file, [8, 6], 25.0).unwrap();
        for shade in [10, 20, 30] {
            film.frame(&picture(shade)).unwrap();
        }
        assert!(!file.exists());
        assert_eq!(film.finish().unwrap(), 3);
        let mut reader =
            png::Decoder::new(std::io::BufReader::new(File::open(&file).unwrap())).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        for shade in [10, 20, 30] {
            reader.next_frame(&mut pixels).unwrap();
            assert_eq!(pixels[0], shade);
        }
    }

    #[test]
    fn a_gif_has_all_frames_and_their_pace() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("film.gif");
        let mut film = Film::create(&file, [8, 6], 20.0).unwrap();
        film.frame(&picture(10)).unwrap();
        film.frame(&picture(200)).unwrap();
        film.finish().unwrap();
        let mut decoder = gif::DecodeOptions::new().read_info(File::open(&file).unwrap()).unwrap();
        let mut delays = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            delays.push(frame.delay);
        }
        assert_eq!(delays, [5, 5]);
    }

    #[test]
    fn a_film_that_is_not_finished_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let mut film = Film::create(&folder.path().join("film.png"), [8, 6], 25.0).unwrap();
        film.frame(&picture(1)).unwrap();
        drop(film);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn what_is_no_film_is_refused_with_what_is() {
        let folder = tempfile::tempdir().unwrap();
        let refused = Film::create(&folder.path().join("film.mp4"), [8, 6], 25.0).err().unwrap().to_string();
        assert!(refused.contains(".gif") && refused.contains("film.mp4"), "{refused}");
        let mut film = Film::create(&folder.path().join("frames"), [4, 6], 25.0).unwrap();
        assert!(film.frame(&picture(1)).is_err());
    }
}
