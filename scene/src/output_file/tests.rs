//! What is written stays, place by place.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use super::{Claim, OutputError, Replace, check, discard, open, write};

fn here() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

fn refused<T: std::fmt::Debug>(answer: Result<T, OutputError>) -> String {
    answer.expect_err("it is refused").to_string()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder");
    let name =
        |entry: io::Result<fs::DirEntry>| entry.expect("an entry").file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = entries.map(name).collect();
    names.sort();
    names
}

#[test]
fn a_file_is_written_whole_or_not_at_all_and_an_earlier_one_stays_unless_it_is_forced() {
    let folder = here();
    let file = folder.path().join("a.html");
    write(&file, b"one", Replace::Never).expect("nothing is there");
    let told = refused(write(&file, b"two", Replace::Never));
    assert!(told.contains("a.html: exists already; --force"), "{told}");
    assert_eq!(fs::read(&file).expect("a file"), b"one");
    write(&file, b"two", Replace::Always).expect("it is forced");
    assert_eq!(fs::read(&file).expect("a file"), b"two");
    let mut protected = fs::metadata(&file).expect("a file").permissions();
    protected.set_readonly(true);
    fs::set_permissions(&file, protected).expect("its mode");
    for (replace, told) in [(Replace::Never, "and is read-only; --force"), (Replace::Writable, "read-only")] {
        let refusal = refused(write(&file, b"three", replace));
        assert!(refusal.contains(told), "{refusal}");
        assert!(check(&file, replace).is_err());
    }
    write(&file, b"three", Replace::Always).expect("it is forced");
    assert!(fs::metadata(&file).expect("a file").permissions().readonly(), "the mode is the old one's");
    assert_eq!(names(folder.path()), ["a.html"], "nothing else is left");
    let told = refused(write(&folder.path().join("no/b.html"), b"x", Replace::Always));
    assert!(told.contains("no does not exist"), "{told}");
    let told = refused(write(folder.path(), b"x", Replace::Always));
    assert!(told.contains("is a directory; valid are"), "{told}");
}

#[test]
fn a_place_has_one_writer_from_the_check_to_the_result() {
    let folder = here();
    let file = folder.path().join("a.mcap");
    let first = Claim::take(&file, Replace::Never).expect("nothing is there");
    assert!(refused(Claim::take(&file, Replace::Never)).contains("exists already"));
    if cfg!(unix) {
        assert!(refused(Claim::take(&file, Replace::Always)).contains("another session is writing it"));
    }
    drop(first);
    assert_eq!(names(folder.path()), [] as [&str; 0], "a claim that is not filled leaves nothing");
    let mut kept = Claim::take(&file, Replace::Never).expect("it is free again");
    open(&file).expect("it grows there").write_all(b"rec").expect("room");
    kept.keep();
    if cfg!(unix) {
        assert!(refused(Claim::take(&file, Replace::Always)).contains("another session is writing it"));
    }
    drop(kept);
    assert_eq!(fs::read(&file).expect("a file"), b"rec");

    // The old one is whole until the new one takes its place, and goes on growing there.
    let mut part = Claim::take(&file, Replace::Always).and_then(Claim::part).expect("it is forced");
    part.file().write_all(b"ne").expect("room");
    assert_eq!(fs::read(&file).expect("a file"), b"rec");
    part.finish().expect("it takes the place");
    part.file().write_all(b"w").expect("room");
    if cfg!(unix) {
        assert!(refused(Claim::take(&file, Replace::Always)).contains("another session is writing it"));
    }
    assert_eq!(part.path(), file);
    drop(part);
    assert_eq!(fs::read(&file).expect("a file"), b"new");
    drop(Claim::take(&file, Replace::Always).and_then(Claim::part).expect("it is free again"));
    assert_eq!(fs::read(&file).expect("a file"), b"new", "a part that is not finished changes nothing");
    assert_eq!(names(folder.path()), ["a.mcap"]);
}

#[test]
#[cfg(unix)]
fn an_empty_file_that_a_killed_process_left_is_no_result_and_one_that_is_held_stays() {
    let folder = here();
    let file = folder.path().join("a.html");
    File::create(&file).expect("a file");
    let claim = Claim::take(&file, Replace::Never).expect("nobody holds it");
    assert!(refused(Claim::take(&file, Replace::Never)).contains("exists already"));
    drop(claim);
    assert_eq!(names(folder.path()), ["a.html"], "it is as it was");
    write(&file, b"one", Replace::Never).expect("nobody holds it");
    assert!(refused(write(&file, b"two", Replace::Never)).contains("exists already"));
    let protected = folder.path().join("b.html");
    let mut mode = File::create(&protected).and_then(|file| file.metadata()).expect("a file").permissions();
    mode.set_readonly(true);
    fs::set_permissions(&protected, mode).expect("its mode");
    assert!(refused(write(&protected, b"two", Replace::Never)).contains("read-only"));
    assert_eq!(fs::read(&file).expect("a file"), b"one");
}

#[test]
fn what_somebody_else_wrote_in_the_meantime_stays() {
    let folder = here();
    let file = folder.path().join("a.html");
    let claim = Claim::take(&file, Replace::Never).expect("nothing is there");
    fs::remove_file(&file).expect("it was there");
    fs::write(&file, "theirs").expect("room");
    assert!(refused(claim.write(b"ours")).contains("exists already"));
    assert_eq!(fs::read(&file).expect("a file"), b"theirs");
    assert_eq!(names(folder.path()), ["a.html"]);
}

#[test]
#[cfg(unix)]
fn a_link_stays_a_link_and_one_that_leads_nowhere_is_refused() {
    use std::os::unix::fs::symlink;
    let folder = here();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("below")).expect("a folder");
    fs::write(at("below/real.html"), "old").expect("room");
    symlink("below/real.html", at("link.html")).expect("a link");
    assert!(refused(write(&at("link.html"), b"new", Replace::Never)).contains("exists already"));
    write(&at("link.html"), b"new", Replace::Always).expect("it is forced");
    assert!(fs::symlink_metadata(at("link.html")).expect("a link").is_symlink());
    assert_eq!(fs::read(at("below/real.html")).expect("a file"), b"new");
    symlink("nowhere.html", at("dead.html")).expect("a link");
    for replace in [Replace::Never, Replace::Always] {
        assert!(refused(write(&at("dead.html"), b"x", replace)).contains("leads nowhere"));
    }
    assert!(!at("nowhere.html").exists());
    // A link that somebody planted under the name of a part is neither followed nor removed.
    fs::write(at("precious"), "kept").expect("room");
    symlink("precious", at("a.html.0.part")).expect("a link");
    write(&at("a.html"), b"x", Replace::Never).expect("another part is free");
    assert_eq!(fs::read(at("precious")).expect("a file"), b"kept");
    assert_eq!(
        names(folder.path()),
        ["a.html", "a.html.0.part", "below", "dead.html", "link.html", "precious"]
    );
}

#[test]
#[cfg(unix)]
fn a_device_and_a_fifo_are_written_to_as_they_are() {
    use std::io::Read;
    use std::os::unix::fs::FileTypeExt;
    let null = Path::new("/dev/null");
    write(null, b"x", Replace::Never).expect("it takes everything");
    open(null).expect("it takes everything");
    discard(null);
    assert!(fs::symlink_metadata(null).expect("a device").file_type().is_char_device());
    if Path::new("/dev/full").exists() {
        assert!(refused(write(Path::new("/dev/full"), b"x", Replace::Never)).contains("No space left"));
    }
    let folder = here();
    let fifo = folder.path().join("fifo");
    rustix::fs::mknodat(rustix::fs::CWD, &fifo, rustix::fs::FileType::Fifo, 0o600.into(), 0).expect("a FIFO");
    for answer in [write(&fifo, b"x", Replace::Always), open(&fifo).map(drop)] {
        assert!(refused(answer).contains("nobody reads from"));
    }
    let bytes = vec![7; 200_000];
    let read = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let mut read = Vec::new();
            File::open(&fifo).and_then(|mut file| file.read_to_end(&mut read)).expect("a writer");
            read
        });
        // Until the reader is there, it is refused.
        while write(&fifo, &bytes, Replace::Never).is_err() {}
        reader.join().expect("it reads")
    });
    assert_eq!(read, bytes);
    assert_eq!(names(folder.path()), ["fifo"]);
    discard(&fifo);
    assert_eq!(names(folder.path()), ["fifo"]);
}
