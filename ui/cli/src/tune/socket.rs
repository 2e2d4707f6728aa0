//! The sockets of running sessions: one Unix socket for each, in a folder that only this user can enter.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::protocol::{LINE_BYTES_MAX, Reply, Request};

/// Longest silence of the peer.
const SILENCE_MAX: Duration = Duration::from_secs(2);
/// Longest time until a session answers; it answers between two looks at the scene.
const ANSWER_MAX: Duration = Duration::from_secs(5);

/// The folder of this user's sockets; `TROCAR_RUNTIME_DIR` overrides it.
///
/// # Errors
/// When it cannot be created, or other users could write to it.
pub fn folder() -> io::Result<PathBuf> {
    let uid = rustix::process::getuid().as_raw();
    let folder = match (std::env::var_os("TROCAR_RUNTIME_DIR"), std::env::var_os("XDG_RUNTIME_DIR")) {
        (Some(folder), _) if !folder.is_empty() => PathBuf::from(folder),
        (_, Some(folder)) if !folder.is_empty() => PathBuf::from(folder).join("trocar"),
        _ => std::env::temp_dir().join(format!("trocar-{uid}")),
    };
    private(&folder, uid)?;
    Ok(folder)
}

/// Creates a folder that only `uid` can enter, or checks that an existing one is such a folder.
fn private(folder: &Path, uid: u32) -> io::Result<()> {
    match std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    // Symbolic links are not followed: another user's link is not our folder.
    let found = std::fs::symlink_metadata(folder)?;
    if !found.is_dir() || found.uid() != uid || found.mode() & 0o022 != 0 {
        let reason =
            format!("{}: it must be a folder of this user that others cannot write to", folder.display());
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, reason));
    }
    Ok(())
}

/// A request with the channel for its answer.
pub struct Asked {
    /// The request.
    pub request: Request,
    answer: SyncSender<Reply>,
}

impl Asked {
    /// Sends the answer; it is no failure if the client has gone.
    pub fn answer(self, reply: Reply) {
        let _ = self.answer.try_send(reply);
    }
}

/// A session's socket. Its thread blocks until a request arrives.
pub struct Server {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    questions: Receiver<Asked>,
}

impl Server {
    /// Opens the socket of this process.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn open() -> io::Result<Self> {
        let path = folder()?.join(format!("{}.sock", std::process::id()));
        // A dead process with the same number may have left a socket behind.
        let _ = std::fs::remove_file(&path);
        let listener = UnixListener::bind(&path)?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        // One request at a time: the client waits for its answer.
        let (sender, questions) = sync_channel(1);
        let thread = std::thread::Builder::new().name("tune".into()).spawn(move || {
            for stream in listener.incoming() {
                if stopped.load(Ordering::Acquire) {
                    break;
                }
                match stream {
                    // A client that disconnects in the middle does not concern the session.
                    Ok(stream) => drop(converse(stream, &sender)),
                    // Out of file descriptors: retry once others have been closed.
                    Err(_) => std::thread::sleep(Duration::from_millis(100)),
                }
            }
        })?;
        Ok(Self { path, stop, thread: Some(thread), questions })
    }

    /// The next request, if there is one.
    pub fn question(&self) -> Option<Asked> {
        self.questions.try_recv().ok()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        // Wakes the thread up; pending requests get no answer.
        let woken = UnixStream::connect(&self.path).is_ok();
        let _ = std::fs::remove_file(&self.path);
        while self.questions.try_recv().is_ok() {}
        if let Some(thread) = self.thread.take().filter(|_| woken) {
            let _ = thread.join();
        }
    }
}

fn converse(stream: UnixStream, session: &SyncSender<Asked>) -> io::Result<()> {
    stream.set_read_timeout(Some(SILENCE_MAX))?;
    stream.set_write_timeout(Some(SILENCE_MAX))?;
    let mut reader = BufReader::new(&stream);
    while let Some(line) = line(&mut reader)? {
        let reply = match serde_json::from_str::<Request>(&line) {
            Ok(request) => {
                let (answer, answers) = sync_channel(1);
                match session.try_send(Asked { request, answer }) {
                    Ok(()) => answers
                        .recv_timeout(ANSWER_MAX)
                        .unwrap_or_else(|_| refused("the session did not answer; it is ending, or held up")),
                    Err(_) => refused("the session has not answered the last question yet"),
                }
            }
            Err(error) => refused(&format!("not understood: {error}")),
        };
        let mut text = serde_json::to_string(&reply).map_err(io::Error::other)?;
        text.push('\n');
        (&stream).write_all(text.as_bytes())?;
    }
    Ok(())
}

fn refused(why: &str) -> Reply {
    Reply { error: Some(why.to_owned()), ..Reply::default() }
}

/// A line without its line break; `None` at the end of the stream.
fn line(reader: &mut impl BufRead) -> io::Result<Option<String>> {
    let mut line = String::new();
    let read = reader.by_ref().take(LINE_BYTES_MAX as u64).read_line(&mut line)?;
    match (read, line.ends_with('\n')) {
        (0, _) => Ok(None),
        (_, true) => Ok(Some(line)),
        (_, false) => Err(io::Error::new(io::ErrorKind::InvalidData, "a line without an end")),
    }
}

/// Sends a request to the session behind a socket.
///
/// # Errors
/// When no session listens, or no answer comes.
pub fn ask(socket: &Path, request: &Request) -> io::Result<Reply> {
    let stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(ANSWER_MAX + SILENCE_MAX))?;
    stream.set_write_timeout(Some(SILENCE_MAX))?;
    let mut text = serde_json::to_string(request).map_err(io::Error::other)?;
    text.push('\n');
    if text.len() > LINE_BYTES_MAX {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "too many values at a time"));
    }
    (&stream).write_all(text.as_bytes())?;
    // Answers come from a process of the same user; a list of all fields may be long.
    let mut answer = String::new();
    BufReader::new(&stream).take(64 << 20).read_line(&mut answer)?;
    serde_json::from_str(&answer).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
}

/// Sessions of this user: process numbers and sockets, in order. Sockets of dead processes are removed.
///
/// # Errors
/// When the folder cannot be read.
pub fn sessions() -> io::Result<Vec<(u32, PathBuf)>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder()?)? {
        let path = entry?.path();
        let pid = path.file_name().and_then(|name| name.to_str()?.strip_suffix(".sock")?.parse().ok());
        let Some(pid) = pid else { continue };
        match UnixStream::connect(&path) {
            Ok(_) => found.push((pid, path)),
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                let _ = std::fs::remove_file(&path);
            }
            Err(_) => {}
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A session that answers every request with the pattern in it.
    fn parrot(session: Receiver<Asked>) -> JoinHandle<()> {
        std::thread::spawn(move || {
            while let Ok(asked) = session.recv() {
                let scenario = format!("{:?}", asked.request);
                asked.answer(Reply { scenario, ..Reply::default() });
            }
        })
    }

    fn talk(said: &[u8]) -> Vec<String> {
        let (ours, theirs) = UnixStream::pair().unwrap();
        let (sender, session) = sync_channel(1);
        let parrot = parrot(session);
        let server = std::thread::spawn(move || converse(theirs, &sender));
        (&ours).write_all(said).unwrap();
        ours.shutdown(std::net::Shutdown::Write).unwrap();
        let lines = BufReader::new(&ours).lines().map_while(Result::ok).collect();
        let _ = server.join();
        parrot.join().unwrap();
        lines
    }

    #[test]
    fn a_folder_that_others_can_write_to_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let uid = rustix::process::getuid().as_raw();
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("a/b");
        private(&folder, uid).unwrap();
        assert_eq!(std::fs::metadata(&folder).unwrap().mode() & 0o777, 0o700);
        private(&folder, uid).unwrap();
        assert!(private(&folder, uid + 1).is_err(), "somebody else's");
        std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o777)).unwrap();
        assert!(private(&folder, uid).unwrap_err().to_string().contains("others cannot write to"));
        let link = home.path().join("link");
        std::os::unix::fs::symlink(home.path(), &link).unwrap();
        assert!(private(&link, uid).is_err(), "a link may lead anywhere");
    }

    #[test]
    fn every_question_gets_an_answer_and_nonsense_an_error() {
        let answers = talk(b"{\"do\":\"status\"}\nnonsense\n{\"do\":\"list\",\"pattern\":\"ring.1\"}\n");
        assert_eq!(answers.len(), 3);
        assert!(answers[0].contains("Status") && answers[2].contains("ring.1"));
        assert!(answers[1].contains("not understood"));
    }

    #[test]
    fn a_line_that_never_ends_is_not_kept() {
        let mut endless: &[u8] = &vec![b'x'; LINE_BYTES_MAX + 10];
        assert!(line(&mut endless).is_err());
        let mut binary: &[u8] = b"\xff\xfe\n";
        assert!(line(&mut binary).is_err());
        assert_eq!(line(&mut (b"" as &[u8])).unwrap(), None);
    }
}
