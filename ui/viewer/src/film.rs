//! Films: a folder of frames, an animated PNG or a GIF.

use std::fs::{self, File};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use trocar_scene::output_file::{self, Claim, Part, Replace};

use crate::error::ViewError;
use crate::picture::Picture;

/// Most frames of one film: hours of it, and no more than the frame counter of an animated PNG can hold.
const FRAMES_MAX: u32 = 1_000_000;
/// Latest offset of the frame-count chunk in an animated PNG \[bytes\].
const HEAD: usize = 4096;

/// The format of the film.
enum Kind {
    /// `frame-00001.png` and so on.
    Folder {
        folder: PathBuf,
        /// The film has made it.
        is_new: bool,
    },
    Apng(Part, Box<png::Writer<BufWriter<File>>>),
    Gif(Part, Box<gif::Encoder<BufWriter<File>>>),
}

/// A film in progress. Until [`Film::finish`] its file has a temporary name.
pub struct Film {
    kind: Option<Kind>,
    file: PathBuf,
    size: [u32; 2],
    frames_per_second: f64,
    frames: u32,
    replace: Replace,
}

impl Film {
    /// `file` ends in `.gif` or `.png` (animated), or is a folder for single frames. `replace` says what becomes of a film,
    /// or of frames, that are there already.
    ///
    /// # Errors
    /// [`ViewError::File`].
    pub fn create(
        file: &Path,
        size: [u32; 2],
        frames_per_second: f64,
        replace: Replace,
    ) -> Result<Self, ViewError> {
        let rate = frames_per_second;
        if !(0.1..=240.0).contains(&rate) {
            return Err(failed(file, &format!("{rate} frames per second: 0.1 to 240 are possible")));
        }
        let file = file.to_owned();
        let mut film = Self { kind: None, file, size, frames_per_second, frames: 0, replace };
        let extension =
            film.file.extension().and_then(|extension| extension.to_str()).map(str::to_ascii_lowercase);
        film.kind = Some(match extension.as_deref() {
            Some("png" | "apng") => film.apng()?,
            Some("gif") => film.gif()?,
            Some(other) if !film.file.is_dir() => {
                let reason = format!("'.{other}' is no film: .png, .gif, or a folder for frames");
                return Err(failed(&film.file, &reason));
            }
            _ => film.folder()?,
        });
        Ok(film)
    }

    /// A folder for frames: a new one, an empty one, or any one if frames in it may be replaced.
    fn folder(&self) -> Result<Kind, ViewError> {
        let folder = self.file.clone();
        if folder == Path::new(output_file::STDOUT) {
            return Err(failed(
                &folder,
                &"a film goes into a file or a folder: .png, .gif, or a folder for frames",
            ));
        }
        if let Some(above) = folder.parent() {
            fs::create_dir_all(above).map_err(|error| failed(&folder, &error))?;
        }
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(Kind::Folder { folder, is_new: true }),
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                return Err(failed(&folder, &error));
            }
            Err(_) => {}
        }
        let mut entries = fs::read_dir(&folder).map_err(|error| match error.kind() {
            io::ErrorKind::NotADirectory => {
                failed(&folder, &"is no film: .png, .gif, or a folder for frames are valid")
            }
            _ => failed(&folder, &error),
        })?;
        if self.replace == Replace::Never && entries.next().is_some() {
            return Err(failed(&folder, &"exists already and is not empty; --force writes into it"));
        }
        Ok(Kind::Folder { folder, is_new: false })
    }

    /// The file in the making, and another handle of it for its encoder.
    fn open(&self) -> Result<(Part, BufWriter<File>), ViewError> {
        let part = Claim::take(&self.file, self.replace)?.part()?;
        let handle = part.file().try_clone().map_err(|error| failed(&self.file, &error))?;
        Ok((part, BufWriter::new(handle)))
    }

    fn apng(&self) -> Result<Kind, ViewError> {
        let error = |error: png::EncodingError| failed(&self.file, &error);
        let (part, out) = self.open()?;
        if part.is_stream() {
            let reason = "the head of an animated PNG is completed at its end, which a FIFO or a device cannot take; \
                          a GIF can be written there";
            return Err(failed(&self.file, &reason));
        }
        let mut encoder = png::Encoder::new(out, self.size[0], self.size[1]);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        // The true number is written at the end.
        encoder.set_animated(FRAMES_MAX, 0).map_err(error)?;
        let delay = (1000.0 / self.frames_per_second).round().clamp(1.0, f64::from(u16::MAX)) as u16;
        encoder.set_frame_delay(delay, 1000).map_err(error)?;
        Ok(Kind::Apng(part, Box::new(encoder.write_header().map_err(error)?)))
    }

    fn gif(&self) -> Result<Kind, ViewError> {
        let side =
            |pixels: u32| u16::try_from(pixels).map_err(|_| failed(&self.file, &"too large for a GIF"));
        let error = |error: gif::EncodingError| failed(&self.file, &error);
        let (width, height) = (side(self.size[0])?, side(self.size[1])?);
        let (part, out) = self.open()?;
        let mut encoder = gif::Encoder::new(out, width, height, &[]).map_err(error)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(error)?;
        Ok(Kind::Gif(part, Box::new(encoder)))
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
            Some(Kind::Folder { folder, .. }) => {
                let frame = folder.join(format!("frame-{:05}.png", self.frames));
                Ok(output_file::write(&frame, &picture.png()?, self.replace)?)
            }
            Some(Kind::Apng(_, writer)) => {
                writer.write_image_data(picture.color.as_flattened()).map_err(|error| failed(file, &error))
            }
            Some(Kind::Gif(_, encoder)) => {
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
        let file = self.file.clone();
        let wrong = |error: &dyn std::fmt::Display| failed(&file, error);
        match self.kind.take() {
            Some(Kind::Apng(mut part, writer)) => {
                writer.finish().map_err(|error| wrong(&error))?;
                count_frames(part.file(), self.frames).map_err(|error| wrong(&error))?;
                part.finish()?;
            }
            Some(Kind::Gif(mut part, encoder)) => {
                let mut out = encoder.into_inner().map_err(|error| wrong(&error))?;
                out.flush().map_err(|error| wrong(&error))?;
                part.finish()?;
            }
            Some(Kind::Folder { .. }) | None => {}
        }
        Ok(self.frames)
    }
}

impl Drop for Film {
    fn drop(&mut self) {
        // Not finished: an incomplete file goes with its part, and a folder that is still empty goes here.
        if let Some(Kind::Folder { folder, is_new: true }) = &self.kind {
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Writes the number of frames into an animated PNG.
fn count_frames(mut file: &File, frames: u32) -> io::Result<()> {
    file.seek(SeekFrom::Start(0))?;
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
    let at = at.ok_or_else(|| io::Error::other("the count of frames has no place"))?;
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
        let mut film = Film::create(&file, [8, 6], 25.0, Replace::Never).unwrap();
        for shade in [10, 20, 30] {
            film.frame(&picture(shade)).unwrap();
        }
        assert_eq!(std::fs::read(&file).unwrap(), b"", "its place is taken, and no more");
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
        let mut film = Film::create(&file, [8, 6], 20.0, Replace::Never).unwrap();
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
        let mut film = Film::create(&folder.path().join("film.png"), [8, 6], 25.0, Replace::Never).unwrap();
        film.frame(&picture(1)).unwrap();
        drop(film);
        drop(Film::create(&folder.path().join("frames"), [8, 6], 25.0, Replace::Never).unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn an_earlier_film_stays_and_so_do_its_frames_unless_it_is_forced() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["film.gif", "film.png", "frames"] {
            let file = folder.path().join(name);
            let create = |replace| Film::create(&file, [8, 6], 25.0, replace);
            let mut first = create(Replace::Never).unwrap();
            first.frame(&picture(1)).unwrap();
            first.finish().unwrap();
            let refused = create(Replace::Never).err().unwrap().to_string();
            assert!(refused.contains(name) && refused.contains("exists already"), "{refused}");
            let mut second = create(Replace::Always).unwrap();
            second.frame(&picture(2)).unwrap();
            second.finish().unwrap();
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "nothing else is left");
    }

    #[test]
    fn what_is_no_film_is_refused_with_what_is() {
        let folder = tempfile::tempdir().unwrap();
        let refused = Film::create(&folder.path().join("film.mp4"), [8, 6], 25.0, Replace::Never)
            .err()
            .unwrap()
            .to_string();
        assert!(refused.contains(".gif") && refused.contains("film.mp4"), "{refused}");
        let mut film = Film::create(&folder.path().join("frames"), [4, 6], 25.0, Replace::Never).unwrap();
        assert!(film.frame(&picture(1)).is_err());
    }
}
