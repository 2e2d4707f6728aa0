//! A real X server without a monitor, and hands at its keyboard and mouse.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_trocar");
/// Nothing takes as long as this on the slowest machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A display of its own, so that no test sees the windows of another one.
pub struct Screen {
    server: Child,
    display: String,
}

impl Screen {
    pub fn new() -> Self {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1400x900x24", "-nolisten", "tcp", "-noreset"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb is installed (Debian: xvfb)");
        let mut line = String::new();
        let output = server.stdout.take().expect("it is piped");
        BufReader::new(output).read_line(&mut line).expect("the server says its number");
        Self { server, display: format!(":{}", line.trim()) }
    }

    /// The display goes, as when somebody logs out.
    pub fn vanish(&mut self) {
        self.server.kill().and_then(|()| self.server.wait()).expect("the server ends");
    }

    /// What a person does with mouse and keys, in the words of xdotool.
    pub fn act(&self, what: &str) -> String {
        let output = Command::new("xdotool")
            .args(what.split_whitespace())
            .env("DISPLAY", &self.display)
            .output()
            .expect("xdotool is installed (Debian: xdotool)");
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }

    /// The windows there are.
    pub fn windows(&self) -> Vec<String> {
        self.act("search --name Trocar").lines().map(str::to_owned).collect()
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// The program with a window.
pub struct Running {
    child: Child,
    folder: PathBuf,
}

impl Running {
    /// Starts it, and waits until its window is there and has the keyboard.
    pub fn start(screen: &Screen, folder: &Path, arguments: &[&str]) -> Self {
        let mut running = Self::begin(screen, folder, arguments, &[]);
        running.until("there is a window", |_| !screen.windows().is_empty());
        let window = screen.windows().remove(0);
        screen.act(&format!("windowfocus --sync {window} mousemove --window {window} 700 300"));
        running
    }

    /// Starts it in such an environment.
    pub fn begin(screen: &Screen, folder: &Path, arguments: &[&str], environment: &[(&str, &str)]) -> Self {
        let child = Command::new(PROGRAM)
            .args(arguments)
            .current_dir(folder)
            .env("DISPLAY", &screen.display)
            .env_remove("WAYLAND_DISPLAY")
            .env("NO_COLOR", "1")
            .env("TROCAR_RUNTIME_DIR", folder.join("run"))
            .envs(environment.iter().copied())
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(folder.join("stderr.txt")).expect("a file"))
            .spawn()
            .expect("the program starts");
        Self { child, folder: folder.to_owned() }
    }

    /// Waits, as long as it takes, until something is so.
    pub fn until(&mut self, what: &str, mut is: impl FnMut(&mut Self) -> bool) {
        let begun = Instant::now();
        while !is(self) {
            if let Some(status) = self.child.try_wait().expect("it is our child") {
                panic!("it ended ({status}) before: {what}\n{}", self.stderr());
            }
            assert!(begun.elapsed() < PATIENCE, "in vain: {what}\n{}", self.stderr());
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    pub fn stderr(&self) -> String {
        std::fs::read_to_string(self.folder.join("stderr.txt")).expect("a file")
    }

    /// What the session says to `trocar tune`.
    pub fn tune(&self, arguments: &[&str]) -> Value {
        let output = Command::new(PROGRAM)
            .arg("tune")
            .args(arguments)
            .arg("--json")
            .current_dir(&self.folder)
            .env("TROCAR_RUNTIME_DIR", self.folder.join("run"))
            .output()
            .expect("the program starts");
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    }

    /// Time of the session.
    pub fn seconds(&self) -> f64 {
        self.tune(&["status"])["session_secs"].as_f64().unwrap_or(-1.0)
    }

    /// Takes a picture and gives its pixels.
    pub fn picture(&mut self, screen: &Screen) -> image::RgbaImage {
        let files = |folder: &Path| -> Vec<PathBuf> {
            let entries =
                std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
            // Of two sights the first one is saved first, and comes first.
            let mut files: Vec<PathBuf> =
                entries.filter(|file| file.extension().is_some_and(|ending| ending == "png")).collect();
            files.sort();
            files
        };
        let before = files(&self.folder);
        screen.act("key ctrl+p");
        let mut taken = None;
        self.until("there is a picture", |running| {
            let new = files(&running.folder).into_iter().find(|file| !before.contains(file));
            // Not before it is complete.
            taken = new.and_then(|file| image::open(file).ok());
            taken.is_some()
        });
        taken.expect("it was taken").to_rgba8()
    }

    /// Sends it a signal, as `kill` names it.
    pub fn send(&self, signal: &str) {
        let sent = Command::new("kill").args([signal, &self.child.id().to_string()]).status();
        assert!(sent.expect("kill runs").success(), "it has ended before");
    }

    /// Waits until it ends by itself: its exit code, and what it has printed.
    pub fn end(mut self) -> (Option<i32>, String) {
        use std::io::Read;
        let mut printed = String::new();
        let mut stdout = self.child.stdout.take().expect("it is piped");
        stdout.read_to_string(&mut printed).expect("text");
        (self.child.wait().expect("it ends").code(), printed)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
