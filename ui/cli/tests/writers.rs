//! Every command that writes a file, at every kind of place, as the user of the tests and as an ordinary one.

use std::ffi::OsStr;
use std::fs::{self, File, Permissions};
use std::io::Read;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, chown, symlink};
use std::os::unix::net::UnixListener;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::support::{BRIEF, assert_valid, here, names, object, stderr, stdout, trocar};

/// A command that writes a file.
pub struct Writer {
    /// Its words, in a folder beside the recording `r.mcap` and the mesh `face.obj`.
    pub words: &'static str,
    /// The file that it writes.
    pub file: &'static str,
    /// Whether it tells the score of a session even when the file cannot be written in the end.
    pub plays: bool,
}

const fn writer(words: &'static str, file: &'static str, plays: bool) -> Writer {
    Writer { words, file, plays }
}

/// All of them but `tune export`, which needs a session, and `bench --plot`, which takes minutes.
pub const WRITERS: [Writer; 13] = [
    // A recording that cannot begin is refused before the run.
    writer("run wall --lockstep --seconds 0.1 --no-report --record a.mcap", "a.mcap", false),
    writer("run wall --lockstep --seconds 0.1 --no-record --report a.html", "a.html", true),
    writer(
        "run wall --lockstep --seconds 0.1 --no-record --no-report --size 32x24 --quality plain --picture a.png",
        "a.png",
        true,
    ),
    writer(
        "run wall --lockstep --seconds 0.1 --no-record --no-report --size 32x24 --quality plain --film a.gif",
        "a.gif",
        true,
    ),
    writer("replay ../r.mcap --headless --report b.html", "b.html", true),
    writer("replay ../r.mcap --size 32x24 --quality plain --picture b.png", "b.png", true),
    writer("replay ../r.mcap --size 32x24 --quality plain --film c.png", "c.png", true),
    writer("recording recover ../r.mcap --out whole.mcap", "whole.mcap", false),
    writer("recording export ../r.mcap --component pose --out .", "pose.csv", false),
    writer("recording export ../r.mcap --component pose --format parquet --out .", "pose.parquet", false),
    writer("mesh ../face.obj --repair --out a.ply", "a.ply", false),
    writer("mesh ../face.obj --picture d.png --size 32x24", "d.png", false),
    writer("gallery . --scenario wall --at 0.1 --size 32x24", "wall.png", false),
];

/// What is completed at its beginning in the end, which nothing but a file can take.
const END_LAST: &str = "c.png";

/// A user whose number no file of the system has.
const NOBODY: u32 = 65_534;

/// A folder to work in, beside the inputs, and a user who works there.
pub struct Workplace {
    folder: tempfile::TempDir,
    program: PathBuf,
    /// Whether the work is done as [`NOBODY`]: in a test of root.
    as_nobody: bool,
}

fn set_mode(path: &Path, mode: u32) {
    fs::set_permissions(path, Permissions::from_mode(mode)).expect("allowed");
}

impl Workplace {
    fn new(as_nobody: bool) -> Self {
        let folder = here();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("face.obj"), "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n").expect("room");
        let record = [&BRIEF[..], &["--no-report", "--record", "r.mcap"]].concat();
        assert_eq!(trocar(folder.path(), &record).status.code(), Some(0));
        let mut program = PathBuf::from(env!("CARGO_BIN_EXE_trocar"));
        if as_nobody {
            // Where the program was built, others may not be allowed to look. Another process copies it: a handle of this
            // one that a sibling test inherits would keep it from being run.
            let copied = Command::new("cp").arg(&program).arg(at("trocar")).status();
            assert!(copied.expect("cp runs").success());
            program = at("trocar");
            set_mode(&program, 0o755);
            set_mode(folder.path(), 0o755);
        }
        Self { folder, program, as_nobody }
    }

    /// As the user of the tests, and, when that is root, as an ordinary one as well.
    pub fn all() -> Vec<Self> {
        let is_root = fs::metadata("/proc/self").is_ok_and(|found| found.uid() == 0);
        if is_root { vec![Self::new(false), Self::new(true)] } else { vec![Self::new(false)] }
    }

    /// The folder of the inputs.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Whether the system refuses this user what a mode forbids: not root.
    fn is_ordinary(&self) -> bool {
        self.as_nobody || fs::metadata("/proc/self").is_ok_and(|found| found.uid() != 0)
    }

    /// The words of a shell that run the program as this user.
    pub fn shell_words(&self) -> String {
        let program = self.program.display();
        if !self.as_nobody {
            return format!("\"{program}\"");
        }
        format!("setpriv --reuid={NOBODY} --regid={NOBODY} --clear-groups \"{program}\"")
    }

    fn work(&self) -> PathBuf {
        self.folder.path().join("work")
    }

    /// Begins again with an empty folder, which the user may write to.
    fn clear(&self) {
        let work = self.work();
        if work.exists() {
            set_mode(&work, 0o755);
            fs::remove_dir_all(&work).expect("it goes");
        }
        fs::create_dir(&work).expect("a folder");
        self.give(&work);
    }

    fn give(&self, path: &Path) {
        if self.as_nobody {
            chown(path, Some(NOBODY), Some(NOBODY)).expect("root may");
        }
    }

    fn run(&self, words: &str, more: &[&str]) -> Output {
        let mut command = Command::new(&self.program);
        command.args(words.split(' ')).args(more).current_dir(self.work()).env("NO_COLOR", "1");
        if self.as_nobody {
            command.uid(NOBODY).gid(NOBODY);
        }
        command.output().expect("the program starts")
    }

    /// Runs a command that is refused, and returns what it says.
    fn refused(&self, writer: &Writer, more: &[&str]) -> String {
        let output = self.run(writer.words, more);
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(4), "{}: {told}", writer.words);
        assert!(!told.contains("panicked"), "{}: {told}", writer.words);
        told
    }

    /// Runs a command that writes its file.
    fn writes(&self, writer: &Writer, more: &[&str]) -> Output {
        let output = self.run(writer.words, more);
        assert!(matches!(output.status.code(), Some(0 | 1)), "{}: {}", writer.words, stderr(&output));
        output
    }

    /// Puts a file there, of the user.
    fn put(&self, name: &str, mode: u32) {
        let file = self.work().join(name);
        fs::write(&file, "precious").expect("room");
        set_mode(&file, mode);
        self.give(&file);
    }
}

/// What is at the place.
#[derive(Clone, Copy, Debug)]
enum There {
    Earlier,
    Protected,
    Link,
    DeadLink,
    Fifo,
    Socket,
    Folder,
}

impl There {
    const ALL: [(Self, &'static str); 7] = [
        (Self::Earlier, "exists already; --force overwrites it"),
        (Self::Protected, "exists already and is read-only; --force"),
        (Self::Link, "exists already; --force overwrites it"),
        (Self::DeadLink, "is a link that leads nowhere"),
        (Self::Fifo, "is a FIFO that nobody reads from"),
        (Self::Socket, "is a socket; valid are"),
        (Self::Folder, "is a directory; valid are"),
    ];

    /// Whether `--force` lets a result take the place.
    fn yields(self) -> bool {
        matches!(self, Self::Earlier | Self::Protected | Self::Link)
    }

    fn put(self, workplace: &Workplace, name: &str) {
        let file = workplace.work().join(name);
        match self {
            Self::Earlier => workplace.put(name, 0o644),
            Self::Protected => workplace.put(name, 0o444),
            Self::Link => {
                workplace.put("real", 0o640);
                symlink("real", file).expect("a link");
            }
            Self::DeadLink => symlink("nowhere", file).expect("a link"),
            Self::Fifo => make_fifo(workplace, &file),
            Self::Socket => drop(UnixListener::bind(file).expect("a socket")),
            Self::Folder => fs::create_dir(file).expect("a folder"),
        }
    }

    /// Whether it is still of its kind; and whether it holds what it held, where it holds anything.
    fn is_there(self, file: &Path) -> (bool, bool) {
        let found = fs::symlink_metadata(file).expect("something is there");
        let (kind, mode) = (found.file_type(), found.permissions().mode() & 0o777);
        let precious = || fs::read(file).is_ok_and(|bytes| bytes == b"precious");
        match self {
            Self::Earlier => (kind.is_file() && mode == 0o644, precious()),
            Self::Protected => (kind.is_file() && mode == 0o444, precious()),
            Self::Link => {
                let real = fs::metadata(file).expect("it leads somewhere").permissions().mode() & 0o777;
                (kind.is_symlink() && real == 0o640, precious())
            }
            Self::DeadLink => (kind.is_symlink(), !file.with_file_name("nowhere").exists()),
            Self::Fifo => (kind.is_fifo(), true),
            Self::Socket => (kind.is_socket(), true),
            Self::Folder => (kind.is_dir(), names(file).is_empty()),
        }
    }
}

fn make_fifo(workplace: &Workplace, file: &Path) {
    assert!(Command::new("mkfifo").arg(file).status().expect("mkfifo runs").success());
    workplace.give(file);
}

#[test]
fn what_is_there_stays_as_it_is_and_with_force_earlier_results_alone_are_replaced() {
    for workplace in Workplace::all() {
        for writer in &WRITERS {
            let file = workplace.work().join(writer.file);
            for (there, why) in There::ALL {
                workplace.clear();
                there.put(&workplace, writer.file);
                let before = names(&workplace.work());
                let told = workplace.refused(writer, &[]);
                assert!(told.contains(writer.file) && told.contains(why), "{}: {told}", writer.words);
                assert_eq!(there.is_there(&file), (true, true), "{}: {there:?}", writer.words);
                if there.yields() {
                    workplace.writes(writer, &["--force"]);
                    assert_eq!(there.is_there(&file), (true, false), "{}: {there:?}", writer.words);
                } else {
                    let told = workplace.refused(writer, &["--force"]);
                    assert!(told.contains(why), "{}: {told}", writer.words);
                    assert_eq!(there.is_there(&file), (true, true), "{}: {there:?}", writer.words);
                }
                let mut after = names(&workplace.work());
                // Beside its pictures a gallery has a page.
                after.retain(|name| name != "index.html");
                assert_eq!(after, before, "{}: {there:?}", writer.words);
            }
        }
    }
}

#[test]
fn devices_take_what_is_written_and_stay_devices() {
    let [null, full] = ["/dev/null", "/dev/full"].map(Path::new);
    for workplace in Workplace::all() {
        for writer in &WRITERS {
            for device in [null, full] {
                if !device.exists() {
                    continue;
                }
                for more in [&[][..], &["--force"]] {
                    workplace.clear();
                    symlink(device, workplace.work().join(writer.file)).expect("a link");
                    if device == null && writer.file == END_LAST {
                        assert!(workplace.refused(writer, more).contains("a GIF can be written there"));
                    } else if device == null {
                        workplace.writes(writer, more);
                    } else {
                        let output = workplace.run(writer.words, more);
                        let told = stderr(&output);
                        assert_eq!(output.status.code(), Some(4), "{}: {told}", writer.words);
                        let why = if writer.file == END_LAST { "a GIF can" } else { "No space left" };
                        assert!(told.contains(why), "{}: {told}", writer.words);
                        let is_told = stdout(&output).contains("state hash");
                        assert_eq!(
                            is_told,
                            writer.plays && writer.file != END_LAST,
                            "{}: {told}",
                            writer.words
                        );
                    }
                    let found = fs::symlink_metadata(device).expect("a device");
                    assert!(found.file_type().is_char_device(), "{}", writer.words);
                    let link = fs::read_link(workplace.work().join(writer.file)).expect("a link");
                    assert_eq!(link, device, "{}", writer.words);
                }
            }
        }
    }
}

#[test]
fn a_fifo_takes_what_the_file_would_hold() {
    for workplace in Workplace::all() {
        for writer in WRITERS.iter().filter(|writer| writer.file != END_LAST) {
            workplace.clear();
            workplace.writes(writer, &[]);
            let length = fs::metadata(workplace.work().join(writer.file)).expect("a result").len();
            workplace.clear();
            let fifo = workplace.work().join(writer.file);
            make_fifo(&workplace, &fifo);
            // Held open at both ends, so that neither waits for the other.
            let held = File::options().read(true).write(true).open(&fifo).expect("a FIFO");
            let mut reader = File::open(&fifo).expect("it has a writer");
            let read = std::thread::scope(|scope| {
                let reading = scope.spawn(move || {
                    let mut read = Vec::new();
                    reader.read_to_end(&mut read).map(|_| read)
                });
                workplace.writes(writer, &[]);
                drop(held);
                reading.join().expect("it reads").expect("what was written")
            });
            assert_begins(&read, writer);
            // Some results tell the time of day or how long something took, in a few digits more or less.
            let difference = (read.len() as f64 - length as f64).abs();
            assert!(
                difference <= 0.02 * length as f64 + 64.0,
                "{}: {} bytes, in a file {length}",
                writer.words,
                read.len()
            );
            assert!(fs::symlink_metadata(&fifo).expect("it is there").file_type().is_fifo());
        }
    }
}

/// Whether the bytes are a file of the kind that the ending promises.
fn assert_begins(bytes: &[u8], writer: &Writer) {
    let begins: &[u8] = match Path::new(writer.file).extension().and_then(OsStr::to_str) {
        Some("mcap") => b"\x89MCAP0\r\n",
        Some("html") => b"<!doctype html>",
        Some("png") => b"\x89PNG\r\n",
        Some("gif") => b"GIF89a",
        Some("csv") => b"time",
        Some("parquet") => b"PAR1",
        Some("ply") => b"ply\n",
        ending => panic!("{ending:?}"),
    };
    let head = &bytes[..bytes.len().min(16)];
    assert!(bytes.starts_with(begins), "{}: {:?}", writer.words, String::from_utf8_lossy(head));
}

#[test]
fn in_a_folder_that_is_closed_to_the_user_the_system_refuses_and_nothing_is_lost() {
    for workplace in Workplace::all().into_iter().filter(Workplace::is_ordinary) {
        for writer in &WRITERS {
            for is_there in [false, true] {
                workplace.clear();
                if is_there {
                    workplace.put(writer.file, 0o644);
                }
                set_mode(&workplace.work(), 0o555);
                let told = workplace.refused(writer, &["--force"]);
                assert!(
                    told.contains(writer.file) && told.contains("cannot be written: Permission denied"),
                    "{}: {told}",
                    writer.words
                );
                let file = workplace.work().join(writer.file);
                let is_kept = || There::Earlier.is_there(&file) == (true, true);
                assert!(!is_there || is_kept(), "{}", writer.words);
                assert_eq!(names(&workplace.work()).len(), usize::from(is_there), "{}", writer.words);
            }
        }
    }
}

#[test]
fn a_run_of_an_ordinary_user_says_its_score_where_its_files_cannot_be_written() {
    let run = BRIEF.join(" ");
    for workplace in Workplace::all().into_iter().filter(Workplace::is_ordinary) {
        workplace.clear();
        assert_eq!(workplace.run(&run, &[]).status.code(), Some(0));
        assert_eq!(names(&workplace.work()), ["report-wall.html", "wall.mcap"]);
        workplace.clear();
        workplace.put("earlier.html", 0o444);
        set_mode(&workplace.work(), 0o555);
        for (more, name) in [("--no-record", "report-wall.html"), ("--no-report", "wall.mcap")] {
            let refused = workplace.run(&run, &[more]);
            assert_eq!(refused.status.code(), Some(4), "{more}: {}", stderr(&refused));
            let told = format!("{name}: cannot be written: Permission denied");
            assert!(stderr(&refused).contains(&told), "{more}: {}", stderr(&refused));
        }
        let report = ["--no-record", "--report", "earlier.html", "--force", "--json"];
        let lost = workplace.run(&run, &report);
        assert_eq!(lost.status.code(), Some(4), "{}", stderr(&lost));
        let summary = object(&lost);
        assert_valid("run", &summary);
        assert!(summary["state_hash"].is_string() && summary["report"].is_null(), "{summary}");
        let losses = summary["losses"].to_string();
        assert!(losses.contains("no report: earlier.html: cannot be written"), "{losses}");
        assert_eq!(fs::read(workplace.work().join("earlier.html")).expect("a file"), b"precious");
    }
}
