//! Project templates: complete small crates with a program, a scenario and tests, as `trocar new` writes them.
//!
//! They are in `ui/sdk/templates`, each a member of this workspace that is linted and tested with the rest. A written
//! project has another name and the path of Trocar in its manifest, and a profile, which only the root of a workspace
//! may have.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;
use trocar_scene::output_file::{self, Replace};

/// The placeholder for Trocar's path in the templates' manifests.
const SDK: &str = "{ path = \"../..\" }";
const CLI: &str = "{ path = \"../../../cli\" }";
/// Longest name of a crate.
const NAME_MAX: usize = 64;
/// Words of the language, also those that it keeps for later: a path such as `NAME::Breathing` cannot begin with one.
const KEYWORDS: [&str; 49] = [
    "abstract", "as", "async", "await", "become", "box", "break", "const", "continue", "crate", "do", "dyn",
    "else", "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl", "in", "let", "loop",
    "macro", "match", "mod", "move", "mut", "override", "priv", "pub", "ref", "return", "self", "static",
    "struct", "super", "trait", "true", "try", "type", "typeof", "unsafe", "unsized", "use", "virtual",
    "where",
];
/// The rest of them.
const KEYWORDS_MORE: [&str; 2] = ["while", "yield"];
/// Types of the language, which a crate of that name would hide.
const TYPES: [&str; 17] = [
    "bool", "char", "f32", "f64", "i8", "i16", "i32", "i64", "i128", "isize", "str", "u8", "u16", "u32",
    "u64", "u128", "usize",
];
/// Crates that come with the compiler.
const STANDARD: [&str; 5] = ["alloc", "core", "proc-macro", "std", "test"];
/// Folders of cargo beside the program, which has the crate's name.
const FOLDERS: [&str; 5] = ["build", "deps", "doc", "examples", "incremental"];
/// The crates of Trocar besides its facade.
const OURS: [&str; 16] = [
    "trocar-cli",
    "trocar-collision",
    "trocar-devices",
    "trocar-dynamics",
    "trocar-engine",
    "trocar-haptics",
    "trocar-input",
    "trocar-kernel",
    "trocar-network",
    "trocar-scene",
    "trocar-scene-derive",
    "trocar-simulator",
    "trocar-tasks",
    "trocar-test-support",
    "trocar-viewer",
    "trocar-zenoh",
];
/// Names of devices, which no file may have on Windows, with any ending.
const DEVICES: [&str; 4] = ["aux", "con", "nul", "prn"];

/// A project template.
#[derive(Clone, Copy, Debug)]
pub struct Template {
    /// Its name: `controller`.
    pub name: &'static str,
    /// One-line description.
    pub about: &'static str,
    /// Path in the project, and text.
    files: &'static [(&'static str, &'static str)],
}

macro_rules! template {
    ($name:literal, $about:literal, [$($file:literal),* $(,)?]) => {
        Template {
            name: $name,
            about: $about,
            files: &[
                (
                    "Cargo.toml",
                    concat!(
                        include_str!(concat!("../templates/", $name, "/Cargo.toml")),
                        include_str!("../templates/profile.toml")
                    ),
                ),
                (".gitignore", include_str!("../templates/gitignore")),
                $(($file, include_str!(concat!("../templates/", $name, "/", $file))),)*
            ],
        }
    };
}

/// Every template.
pub const TEMPLATES: [Template; 5] = [
    template!(
        "controller",
        "a behaviour with parameters, events and long work, which lives through being killed",
        [
            "src/main.rs",
            "src/lib.rs",
            "src/components.rs",
            "src/plan.rs",
            "scenario.toml",
            "tests/breathing.rs",
        ]
    ),
    template!(
        "component",
        "new data in the scene: schema, checks, recording",
        ["src/main.rs", "src/lib.rs", "src/bleeder.rs", "scenario.toml", "tests/bleeding.rs"]
    ),
    template!(
        "device",
        "a driver for a haptic device with a protocol of bytes, and its emulator",
        [
            "src/main.rs",
            "src/lib.rs",
            "src/protocol.rs",
            "src/emulator.rs",
            "examples/emulator.rs",
            "tests/stylus.rs",
        ]
    ),
    template!(
        "actor",
        "a plain actix actor in a live session: messages, threads of its own, no lock-step",
        ["src/main.rs", "src/lib.rs", "src/speaker.rs", "tests/coach.rs"]
    ),
    template!(
        "engine",
        "a foreign physics engine behind a C ABI, loaded as a library",
        [
            "build.rs",
            "engine/chain.h",
            "engine/chain.c",
            "src/main.rs",
            "src/lib.rs",
            "src/ffi.rs",
            "scenario.toml",
            "tests/chain.rs",
        ]
    ),
];

/// The source of Trocar for a new project.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// A checkout of Trocar's repository.
    Checkout(PathBuf),
    /// The URL of a git repository.
    Git(String),
}

/// Why a project cannot be created.
#[derive(Debug, Error)]
pub enum TemplateError {
    /// No such template.
    #[error("no template is called '{name}'; there are: {known}")]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The valid names.
        known: String,
    },
    /// A name with which the project would not build.
    #[error("'{name}' cannot name a crate: {reason}; '{better}' would do")]
    Name {
        /// The name.
        name: String,
        /// Why.
        reason: String,
        /// A name that could.
        better: String,
    },
    /// The folder exists and is not empty.
    #[error("{}: exists already; nothing is overwritten", .0.display())]
    Exists(PathBuf),
    /// Not a checkout of Trocar.
    #[error("{}: is no checkout of Trocar (it has no ui/sdk/Cargo.toml)", .0.display())]
    NoCheckout(PathBuf),
    /// A path that a manifest cannot hold.
    #[error(
        "'{0}' cannot stand in a manifest; valid: text without quotes, backslashes and control characters"
    )]
    Path(String),
    /// A file cannot be written.
    #[error("{}: {error}", file.display())]
    Write {
        /// The file or folder.
        file: PathBuf,
        /// The system's error.
        error: io::Error,
    },
}

/// The template of that name.
///
/// # Errors
/// [`TemplateError::Unknown`] with the valid names.
pub fn template(name: &str) -> Result<&'static Template, TemplateError> {
    const ALL: &[Template] = &TEMPLATES;
    ALL.iter().find(|template| template.name == name).ok_or_else(|| TemplateError::Unknown {
        name: name.to_owned(),
        known: ALL.iter().map(|template| template.name).collect::<Vec<_>>().join(", "),
    })
}

/// The checkout that this program was built from, if it is still there.
pub fn checkout() -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent()?.parent()?;
    is_checkout(root).then(|| root.to_owned())
}

fn is_checkout(folder: &Path) -> bool {
    folder.join("ui/sdk/Cargo.toml").is_file()
}

impl Template {
    /// Writes the project `name` into `folder`, which must not exist or be empty. Returns the files, in order.
    ///
    /// # Errors
    /// [`TemplateError`]; files written so far are removed.
    pub fn write(&self, name: &str, folder: &Path, source: &Source) -> Result<Vec<PathBuf>, TemplateError> {
        self.check_name(name)?;
        let places = places(source)?;
        let fresh = !folder.exists();
        let is_free = fresh || fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
        if !is_free {
            return Err(TemplateError::Exists(folder.to_owned()));
        }
        let mut files = Vec::with_capacity(self.files.len());
        let written = self
            .write_files(name, folder, &places, &mut files)
            .and_then(|()| share_libraries(folder, source, &mut files));
        match written {
            Ok(()) => Ok(files),
            Err(error) => {
                self.undo(folder, &files, fresh);
                Err(error)
            }
        }
    }

    fn write_files(
        &self,
        name: &str,
        folder: &Path,
        (sdk, cli): &(String, String),
        written: &mut Vec<PathBuf>,
    ) -> Result<(), TemplateError> {
        let (old, own) = (format!("template-{}", self.name), name.replace('-', "_"));
        for (path, text) in self.files {
            let text = text.replace(&old, name).replace(&old.replace('-', "_"), &own);
            write_new(folder.join(path), text.replace(SDK, sdk).replace(CLI, cli).as_bytes(), written)?;
        }
        Ok(())
    }

    /// Takes away what was written, and the folders that are empty then; the first error is the one to return.
    fn undo(&self, folder: &Path, written: &[PathBuf], fresh: bool) {
        for file in written.iter().rev() {
            let _ = fs::remove_file(file);
        }
        let files =
            self.files.iter().map(|(path, _)| folder.join(path)).chain([folder.join(".cargo/config.toml")]);
        let files: Vec<PathBuf> = files.collect();
        let above = files.iter().flat_map(|file| file.ancestors().skip(1));
        let mut folders: Vec<&Path> =
            above.filter(|path| path.starts_with(folder) && (fresh || *path != folder)).collect();
        // The lowest ones first.
        folders.sort_by_key(|path| std::cmp::Reverse(path.components().count()));
        for path in folders {
            let _ = fs::remove_dir(path);
        }
    }
}

/// Writes a file of the project, and the folders above it. A file that is there, from another process that writes a project
/// into the same folder, stays as it is.
fn write_new(file: PathBuf, bytes: &[u8], written: &mut Vec<PathBuf>) -> Result<(), TemplateError> {
    let made = file.parent().map_or(Ok(()), fs::create_dir_all);
    let wrote = || output_file::write(&file, bytes, Replace::Never).map_err(io::Error::from);
    match made.and_then(|()| wrote()) {
        Ok(()) => {
            written.push(file);
            Ok(())
        }
        Err(error) => Err(TemplateError::Write { file, error }),
    }
}

/// The manifest entries for the SDK and for the command line.
fn places(source: &Source) -> Result<(String, String), TemplateError> {
    match source {
        Source::Git(url) => {
            let place = format!("{{ git = \"{}\" }}", plain(url)?);
            Ok((place.clone(), place))
        }
        Source::Checkout(root) => {
            let whole = fs::canonicalize(root).unwrap_or_else(|_| root.clone());
            if !is_checkout(&whole) {
                return Err(TemplateError::NoCheckout(root.clone()));
            }
            let path = |room: &str| -> Result<String, TemplateError> {
                let path = whole.join(room);
                // Every system accepts forward slashes, and they need no escape.
                let text = path.to_string_lossy().replace(std::path::MAIN_SEPARATOR, "/");
                Ok(format!("{{ path = \"{}\" }}", plain(&text)?))
            };
            Ok((path("ui/sdk")?, path("ui/cli")?))
        }
    }
}

/// Lets a project beside a checkout take the libraries that the checkout's own build has compiled: the same versions, in
/// the same target folder.
fn share_libraries(folder: &Path, source: &Source, files: &mut Vec<PathBuf>) -> Result<(), TemplateError> {
    let Source::Checkout(root) = source else { return Ok(()) };
    let whole = fs::canonicalize(root).unwrap_or_else(|_| root.clone());
    if let Ok(lock) = fs::read_to_string(whole.join("Cargo.lock")) {
        // Cargo takes out what the project does not need, and puts the project in.
        let packages = lock.split("\n\n").filter(|package| !package.contains("\nname = \"template-"));
        let lock = packages.collect::<Vec<_>>().join("\n\n");
        write_new(folder.join("Cargo.lock"), lock.as_bytes(), files)?;
    }
    let target = whole.join("target");
    let target = plain(&target.to_string_lossy().replace(std::path::MAIN_SEPARATOR, "/"))?;
    let config = format!(
        "# Libraries that Trocar's own build has compiled serve this project too. Without these lines, or with another\n\
         # profile in Cargo.toml, this project compiles all of them for itself.\n\
         [build]\ntarget-dir = \"{target}\"\n"
    );
    write_new(folder.join(".cargo/config.toml"), config.as_bytes(), files)
}

/// Text that a manifest can hold between quotes.
fn plain(text: &str) -> Result<String, TemplateError> {
    let is_plain = !text.chars().any(|c| c == '"' || c == '\\' || c.is_control());
    if is_plain { Ok(text.to_owned()) } else { Err(TemplateError::Path(text.escape_debug().to_string())) }
}

impl Template {
    /// Refuses names with which the project would not build.
    fn check_name(&self, name: &str) -> Result<(), TemplateError> {
        let letters = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        let dashed = name.replace('_', "-");
        let is = |names: &[&str]| names.contains(&dashed.as_str());
        let reason = if name.is_empty() || name.len() > NAME_MAX || !name.chars().all(letters) {
            format!("valid are 1 to {NAME_MAX} lower-case letters of English, digits, '-' and '_'")
        } else if !name.starts_with(|c: char| c.is_ascii_lowercase()) {
            "it must begin with a letter".to_owned()
        } else if is(&KEYWORDS) || is(&KEYWORDS_MORE) {
            "it is a word of the Rust language".to_owned()
        } else if is(&TYPES) {
            "it is a type of the Rust language".to_owned()
        } else if is(&STANDARD) {
            "a crate of that name comes with the compiler".to_owned()
        } else if is(&FOLDERS) {
            "cargo has a folder of that name, where the program would go".to_owned()
        } else if is(&DEVICES) {
            "Windows has a device of that name".to_owned()
        } else if self.dependencies().any(|other| other.replace('_', "-") == dashed) {
            "the project depends on a crate of that name".to_owned()
        } else if dashed == "trocar" || OURS.contains(&dashed.as_str()) {
            "a crate of Trocar has that name".to_owned()
        } else {
            return Ok(());
        };
        let better: String = name.to_lowercase().chars().map(|c| if letters(c) { c } else { '-' }).collect();
        let better = better.trim_matches(|c: char| !c.is_ascii_lowercase());
        let better = if better.is_empty() { "my-sim".to_owned() } else { format!("my-{better}") };
        let better: String = better.chars().take(NAME_MAX).collect();
        Err(TemplateError::Name { name: name.escape_debug().to_string(), reason, better })
    }

    /// Names of the crates that its manifest asks for.
    fn dependencies(&self) -> impl Iterator<Item = &'static str> {
        let manifest =
            self.files.iter().find(|(path, _)| *path == "Cargo.toml").map_or("", |(_, text)| *text);
        let mut within = false;
        manifest.lines().filter_map(move |line| {
            if line.starts_with('[') {
                within = line.ends_with("dependencies]");
            }
            line.split_once(" = ").map(|(name, _)| name).filter(|_| within)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().expect("a folder")
    }

    fn here() -> Source {
        Source::Checkout(checkout().expect("the checkout that is being tested"))
    }

    #[test]
    fn every_file_of_a_template_is_written_under_the_new_name() {
        for template in &TEMPLATES {
            let place = folder();
            let project = place.path().join("deep").join("my-sim");
            let files = template.write("my-sim", &project, &here()).expect("written");
            assert!(files.iter().all(|file| file.is_file()));
            let mut text = String::new();
            files.iter().for_each(|file| text += &fs::read_to_string(file).expect("text"));
            assert!(!text.contains("template-") && !text.contains("template_"), "{}", template.name);
            assert!(text.contains("name = \"my-sim\"") && text.contains("my_sim::"), "{}", template.name);
            assert!(!text.contains("path = \"../"), "{}", template.name);
        }
    }

    /// The table above holds every file of the templates' folders.
    #[test]
    fn the_table_holds_every_file_that_lies_in_the_folders() {
        fn count(folder: &Path) -> usize {
            let entries =
                fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
            let skipped = ["target", "Cargo.lock"];
            entries
                .filter(|path| {
                    !skipped.contains(&path.file_name().unwrap_or_default().to_string_lossy().as_ref())
                })
                .map(|path| if path.is_dir() { count(&path) } else { 1 })
                .sum()
        }
        for template in &TEMPLATES {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("templates").join(template.name);
            assert_eq!(count(&folder) + 1, template.files.len(), "{}", template.name);
        }
    }

    #[test]
    fn nothing_is_overwritten() {
        let place = folder();
        fs::write(place.path().join("precious.txt"), "mine").expect("a file");
        let error = TEMPLATES[0].write("sim", place.path(), &here()).unwrap_err();
        assert!(matches!(error, TemplateError::Exists(_)), "{error}");
        assert_eq!(fs::read_dir(place.path()).expect("a folder").count(), 1);
    }

    #[test]
    fn a_project_that_cannot_be_written_takes_only_its_own_files_away() {
        let place = folder();
        let project = place.path().join("sim");
        // Another process writes a project into the same folder at the same time.
        let (mut theirs, mut ours) = (Vec::new(), Vec::new());
        write_new(project.join("src/main.rs"), b"theirs", &mut theirs).expect("it is the first");
        let wrote = TEMPLATES[0].write_files("sim", &project, &Default::default(), &mut ours);
        assert!(matches!(wrote, Err(TemplateError::Write { .. })));
        TEMPLATES[0].undo(&project, &ours, true);
        assert_eq!(fs::read(&theirs[0]).expect("a file"), b"theirs");
        assert_eq!(fs::read_dir(&project).expect("a folder").count(), 1, "nothing of ours is left");
        TEMPLATES[0].undo(&project, &theirs, true);
        assert!(!project.exists());
    }

    #[test]
    fn what_cannot_be_is_refused_with_what_can() {
        let place = folder();
        let project = place.path().join("sim");
        for wrong in ["", "Sim", "7up", "my sim", "../sim", "trocar", "a\u{1b}"] {
            let error = TEMPLATES[0].write(wrong, &project, &here()).unwrap_err();
            assert!(matches!(error, TemplateError::Name { .. }), "{wrong}: {error}");
            assert!(!error.to_string().contains('\u{1b}'));
        }
        assert!(
            template("contoller").unwrap_err().to_string().contains("controller, component, device, actor")
        );
        let elsewhere = Source::Checkout(place.path().to_owned());
        let error = TEMPLATES[0].write("sim", &project, &elsewhere).unwrap_err();
        assert!(matches!(error, TemplateError::NoCheckout(_)), "{error}");
        let quoted = Source::Git("https://example.org/\"".to_owned());
        assert!(matches!(TEMPLATES[0].write("sim", &project, &quoted), Err(TemplateError::Path(_))));
        assert!(!project.exists());
    }

    #[test]
    fn names_with_which_no_crate_builds_are_refused_with_one_that_does() {
        let place = folder();
        let project = place.path().join("sim");
        let mut wrong: Vec<String> = [
            &KEYWORDS[..],
            &KEYWORDS_MORE[..],
            &TYPES[..],
            &STANDARD[..],
            &FOLDERS[..],
            &DEVICES[..],
            &OURS[..],
        ]
        .concat()
        .into_iter()
        .map(str::to_owned)
        .collect();
        for name in ["2d-sim", "9", "-sim", "_sim", "leber-öffnen", "肝", "proc_macro", "trocar_cli", "serde"]
        {
            wrong.push(name.to_owned());
        }
        wrong.push("a".repeat(NAME_MAX + 1));
        for name in wrong {
            let error = TEMPLATES[0].write(&name, &project, &here()).unwrap_err();
            let TemplateError::Name { better, .. } = &error else { panic!("{name}: {error}") };
            TEMPLATES[0].check_name(better).unwrap_or_else(|error| panic!("{name} became {better}: {error}"));
            assert!(error.to_string().contains(better.as_str()), "{error}");
        }
        assert!(!project.exists());
        for template in &TEMPLATES {
            let taken: Vec<&str> = template.dependencies().collect();
            assert!(
                taken.contains(&"trocar") && taken.contains(&"trocar-cli"),
                "{}: {taken:?}",
                template.name
            );
            for name in taken {
                assert!(template.check_name(name).is_err(), "{}: {name}", template.name);
            }
        }
        let longest = "a".repeat(NAME_MAX);
        for fine in ["sim", "my-sim", "a", "gallbladder_2", "tester", "x1", "stdlib", longest.as_str()] {
            TEMPLATES[0].check_name(fine).unwrap_or_else(|error| panic!("{fine}: {error}"));
        }
    }

    /// A crate of our own that a project may not be named after is in the list.
    #[test]
    fn every_crate_of_this_workspace_is_among_the_names_that_are_taken() {
        let root = checkout().expect("the checkout that is being tested");
        let lock = fs::read_to_string(root.join("Cargo.lock")).expect("a lock file");
        let ours = lock.lines().filter_map(|line| line.strip_prefix("name = \"trocar")?.strip_suffix('"'));
        for rest in ours.filter(|rest| !rest.is_empty() && *rest != "-tests") {
            assert!(OURS.contains(&format!("trocar{rest}").as_str()), "trocar{rest}");
        }
    }

    #[test]
    fn a_project_shares_the_target_folder_the_versions_and_the_profile_of_its_checkout() {
        let place = folder();
        let project = place.path().join("sim");
        TEMPLATES[0].write("sim", &project, &here()).expect("written");
        let root = checkout().expect("the checkout that is being tested");
        let read = |file: PathBuf| {
            fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
        };
        let config = read(project.join(".cargo/config.toml"));
        let target = fs::canonicalize(&root).expect("a folder").join("target");
        assert!(config.contains(&format!("target-dir = \"{}\"", target.display())), "{config}");
        let (lock, whole) = (read(project.join("Cargo.lock")), read(root.join("Cargo.lock")));
        assert!(lock.split("\n\n").all(|package| whole.contains(package)), "other versions");
        assert!(lock.contains("name = \"naga\"") && lock.contains("name = \"trocar\""), "{lock}");

        // Every setting of the profile is one of the workspace; what is left out is of crates that no project needs.
        let (ours, theirs) = (read(root.join("Cargo.toml")), read(project.join("Cargo.toml")));
        let section = |manifest: &str, head: &str| {
            let text = manifest.split_once(&format!("[{head}]\n"))?.1.to_owned();
            let lines =
                text.lines().take_while(|line| !line.starts_with('[')).filter(|line| line.contains(" = "));
            Some(lines.map(str::to_owned).collect::<Vec<_>>())
        };
        assert_eq!(section(&theirs, "profile.release"), section(&ours, "profile.release"));
        let of_packages = |manifest: &str| -> Vec<String> {
            let heads = manifest.lines().filter_map(|line| line.strip_prefix('[')?.strip_suffix(']'));
            heads.filter(|head| head.starts_with("profile.release.package.")).map(str::to_owned).collect()
        };
        let known = of_packages(&ours);
        for head in of_packages(&theirs) {
            assert!(known.contains(&head), "{head}");
            assert_eq!(section(&theirs, &head), section(&ours, &head), "{head}");
        }
        for crate_name in ["trocar", "trocar-kernel", "naga", "wgpu-core", "egui", "winit", "toml", "gltf"] {
            let head = format!("profile.release.package.{crate_name}");
            assert!(section(&theirs, &head).is_some(), "{head} is missing");
        }
    }

    #[test]
    fn a_project_can_take_trocar_from_a_repository() {
        let place = folder();
        let project = place.path().join("sim");
        let source = Source::Git("https://example.org/trocar.git".to_owned());
        TEMPLATES[0].write("sim", &project, &source).expect("written");
        let manifest = fs::read_to_string(project.join("Cargo.toml")).expect("a manifest");
        assert_eq!(manifest.matches("{ git = \"https://example.org/trocar.git\" }").count(), 2, "{manifest}");
    }
}
