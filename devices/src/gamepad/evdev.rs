//! Gamepads of this machine: the kernel's event devices (evdev) and their capabilities (Linux).

use std::collections::BTreeMap;
use std::fs::{DirEntry, File, OpenOptions};
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::PathBuf;

use super::decoder::{AXES, AbsRange, BTN_GAMEPAD, BUTTONS, GamepadDecoder};
use super::reader::{GamepadSource, PluggedGamepad};

/// Most files of the folder that are examined.
const FILES_MAX: usize = 256;
/// Bytes of a bit field with one bit per key code (`KEY_MAX` is 0x2ff).
const KEY_BYTES: usize = 0x300 / 8;
/// Bytes of a bit field with one bit per axis (`ABS_MAX` is 0x3f).
const ABS_BYTES: usize = 0x40 / 8;
/// Bytes of a `struct input_absinfo`: value, minimum, maximum, fuzz, flat, resolution.
const ABSINFO_BYTES: usize = 24;
/// Longest name of a device.
const NAME_BYTES: usize = 128;

/// Numbers of the kernel's requests (`EVIOCGNAME`, `EVIOCGKEY`, `EVIOCGBIT`, `EVIOCGABS`).
const GET_NAME: u8 = 0x06;
const GET_KEY: u8 = 0x18;
const GET_KEY_BITS: u8 = 0x21;
const GET_ABS_BITS: u8 = 0x23;
const GET_ABS: u8 = 0x40;

/// The folder with the kernel's event devices.
#[derive(Debug)]
pub struct InputFolder {
    path: PathBuf,
    /// Examined files that are no gamepads: device number and change time by name. They are not opened again.
    others: BTreeMap<String, (u64, i64, i64)>,
}

impl Default for InputFolder {
    fn default() -> Self {
        Self::at("/dev/input")
    }
}

impl InputFolder {
    /// A folder other than the system's.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), others: BTreeMap::new() }
    }

    fn plugged(&mut self, entry: &DirEntry, name: &str) -> io::Result<Option<PluggedGamepad>> {
        let metadata = entry.metadata()?;
        let identity = (metadata.rdev(), metadata.ctime(), metadata.ctime_nsec());
        if self.others.get(name) == Some(&identity) {
            return Ok(None);
        }
        // Failures are not remembered: permissions of a new device are often set a moment later.
        let file = OpenOptions::new()
            .read(true)
            .custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC)
            .open(entry.path())?;
        let found = gamepad(&file, name)?;
        if found.is_none() {
            self.others.insert(name.to_owned(), identity);
        }
        Ok(found.map(|(title, decoder)| PluggedGamepad { id: name.to_owned(), name: title, file, decoder }))
    }
}

impl GamepadSource for InputFolder {
    fn scan(&mut self, open: &[&str]) -> Vec<PluggedGamepad> {
        // A machine without the folder has no gamepad yet.
        let Ok(entries) = std::fs::read_dir(&self.path) else { return Vec::new() };
        let mut names: Vec<(String, DirEntry)> = entries
            .take(FILES_MAX)
            .flatten()
            .map(|entry| (entry.file_name().to_string_lossy().into_owned(), entry))
            .filter(|(name, _)| name.starts_with("event") && !open.contains(&name.as_str()))
            .collect();
        names.sort_by(|(a, _), (b, _)| a.cmp(b));
        self.others.retain(|name, _| names.iter().any(|(there, _)| there == name));
        // Skips devices that cannot be opened or queried: no permission, or being unplugged.
        names.iter().filter_map(|(name, entry)| self.plugged(entry, name).ok().flatten()).collect()
    }
}

/// The device's name and a decoder in its current state, if it is a gamepad.
fn gamepad(file: &File, name: &str) -> io::Result<Option<(String, GamepadDecoder)>> {
    let has: [u8; KEY_BYTES] = ask(file, GET_KEY_BITS)?;
    if !bit(&has, BTN_GAMEPAD) {
        return Ok(None);
    }
    let axes: [u8; ABS_BYTES] = ask(file, GET_ABS_BITS)?;
    let ranges: Vec<AbsRange> = AXES
        .into_iter()
        .filter(|code| bit(&axes, *code))
        .filter_map(|code| {
            let number = GET_ABS + u8::try_from(code).ok()?;
            Some(range(code, &ask::<ABSINFO_BYTES>(file, number).ok()?))
        })
        .collect();
    let down: [u8; KEY_BYTES] = ask(file, GET_KEY)?;
    let pressed: Vec<u16> = BUTTONS.iter().map(|(code, _)| *code).filter(|code| bit(&down, *code)).collect();
    let title = ask::<NAME_BYTES>(file, GET_NAME)
        .ok()
        .and_then(|bytes| Some(String::from_utf8_lossy(bytes.split(|byte| *byte == 0).next()?).into_owned()))
        .filter(|title| !title.is_empty());
    Ok(Some((title.unwrap_or_else(|| name.to_owned()), GamepadDecoder::new(&ranges, &pressed))))
}

fn bit(bits: &[u8], code: u16) -> bool {
    bits.get(usize::from(code / 8)).is_some_and(|byte| byte & (1 << (code % 8)) != 0)
}

/// Reads a `struct input_absinfo`.
fn range(code: u16, info: &[u8; ABSINFO_BYTES]) -> AbsRange {
    let number = |index: usize| {
        let at = 4 * index;
        i32::from_ne_bytes([info[at], info[at + 1], info[at + 2], info[at + 3]])
    };
    AbsRange { code, value: number(0), min: number(1), max: number(2), flat: number(4) }
}

/// Sends an event device one of the requests above, whose answer fits into `N` bytes.
fn ask<const N: usize>(file: &File, number: u8) -> io::Result<[u8; N]> {
    let mut answer = [0_u8; N];
    let request = rustix::ioctl::opcode::read::<[u8; N]>(b'E', number);
    // SAFETY: the request carries the length of the answer, and the kernel writes no more than that to `answer`, which
    // outlives the call; every bit pattern is a valid array of bytes. A file that is no event device refuses it.
    let status = unsafe { libc::ioctl(file.as_raw_fd(), request as _, answer.as_mut_ptr()) };
    if status < 0 { Err(io::Error::last_os_error()) } else { Ok(answer) }
}

/// Waits until one of the files can be read, or was closed at its other end.
pub(super) fn wait(files: &[BorrowedFd<'_>], timeout_ns: u64) -> io::Result<Vec<bool>> {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let mut watched: Vec<PollFd<'_>> =
        files.iter().map(|file| PollFd::from_borrowed_fd(*file, PollFlags::IN)).collect();
    let timeout = Timespec {
        tv_sec: i64::try_from(timeout_ns / 1_000_000_000).unwrap_or(i64::MAX),
        tv_nsec: (timeout_ns % 1_000_000_000) as _,
    };
    match poll(&mut watched, Some(&timeout)) {
        Ok(_) => Ok(watched.iter().map(|fd| !fd.revents().is_empty()).collect()),
        Err(rustix::io::Errno::INTR) => Ok(vec![false; files.len()]),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_event_device_is_no_gamepad() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("event0"), b"no device").expect("a file");
        std::fs::write(folder.path().join("mouse0"), b"").expect("a file");
        assert!(InputFolder::at(folder.path()).scan(&[]).is_empty());
        assert!(InputFolder::at(folder.path().join("nowhere")).scan(&[]).is_empty());
        let file = File::open(folder.path().join("event0")).expect("a file");
        assert!(ask::<KEY_BYTES>(&file, GET_KEY_BITS).is_err());
    }

    #[test]
    fn bits_and_ranges_are_read_as_the_kernel_lays_them_out() {
        let mut bits = [0; KEY_BYTES];
        bits[0x130 / 8] = 1;
        assert!(bit(&bits, BTN_GAMEPAD) && !bit(&bits, 0x131) && !bit(&bits, 0xffff));
        let mut info = [0; ABSINFO_BYTES];
        for (index, number) in [7_i32, -100, 100, 1, 15, 0].into_iter().enumerate() {
            info[4 * index..4 * index + 4].copy_from_slice(&number.to_ne_bytes());
        }
        assert_eq!(range(3, &info), AbsRange { code: 3, value: 7, min: -100, max: 100, flat: 15 });
    }
}
