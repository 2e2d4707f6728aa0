//! Project templates: complete small crates with a program, a scenario and tests, as `trocar new` writes them.
//!
//! They are in `ui/sdk/templates`, each a member of this workspace that is linted and tested with the rest. A written
//! project has another name and the path of Trocar in its manifest, and a profile, which only the root of a workspace
//! may have.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// The placeholder for Trocar's path in the templates' manifests.
const SDK: &str = "{ path = \"../..\" }";
const CLI: &str = "{ path = \"../../../cli\" }";
/// Longest name of a crate.
const NAME_MAX: usize = 64;
/// Names that no crate can have, or that would collide with a crate that every project needs.
const RESERVED: [&str; 12] = [
    "trocar",
    "trocar-cli",
    "test",
    "core",
    "std",
    "alloc",
    "proc-macro",
    "crate",
    "self",
    "super",
    "build",
    "deps",
];

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
    /// A name that no crate can have.
    #[error("'{name}' cannot name a crate: {reason}")]
    Name {
        /// The name.
        name: String,
        /// Why.
        reason: String,
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
        check_name(name)?;
        let places = places(source)?;
        let fresh = !folder.exists();
        let is_free = fresh || fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
        if !is_free {
            return Err(TemplateError::Exists(folder.to_owned()));
        }
        let written = self.write_files(name, folder, &places);
        if written.is_err() {
            // The first error is the one to return.
            let _ = fs::remove_dir_all(folder);
            if !fresh {
                let _ = fs::create_dir(folder);
            }
        }
        written
    }

    fn write_files(
        &self,
        name: &str,
        folder: &Path,
        (sdk, cli): &(String, String),
    ) -> Result<Vec<PathBuf>, TemplateError> {
        let (old, own) = (format!("template-{}", self.name), name.replace('-', "_"));
        let mut written = Vec::with_capacity(self.files.len());
        for (path, text) in self.files {
            let file = folder.join(path);
            let wrong = |error| TemplateError::Write { file: file.clone(), error };
            if let Some(parent) = file.parent() {
                fs::create_dir_all(parent).map_err(wrong)?;
            }
            let text = text.replace(&old, name).replace(&old.replace('-', "_"), &own);
            fs::write(&file, text.replace(SDK, sdk).replace(CLI, cli)).map_err(wrong)?;
            written.push(file);
        }
        Ok(written)
    }
}

/// The manifest entries for the SDK and for the command line.
fn places(source: &Source) -> Result<(String, String), TemplateError> {
    let plain = |text: &str| {
        let is_plain = !text.chars().any(|c| c == '"' || c == '\\' || c.is_control());
        if is_plain { Ok(text.to_owned()) } else { Err(TemplateError::Path(text.escape_debug().to_string())) }
    };
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

fn check_name(name: &str) -> Result<(), TemplateError> {
    let wrong = |reason: String| Err(TemplateError::Name { name: name.escape_debug().to_string(), reason });
    let letters = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    if name.is_empty() || name.len() > NAME_MAX || !name.chars().all(letters) {
        return wrong(format!("valid are 1 to {NAME_MAX} lower-case letters, digits, '-' and '_'"));
    }
    if !name.starts_with(|c: char| c.is_ascii_lowercase()) {
        return wrong("it must begin with a letter".to_owned());
    }
    if RESERVED.contains(&name) {
        return wrong(format!("taken are {}", RESERVED.join(", ")));
    }
    Ok(())
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
    fn a_project_can_take_trocar_from_a_repository() {
        let place = folder();
        let project = place.path().join("sim");
        let source = Source::Git("https://example.org/trocar.git".to_owned());
        TEMPLATES[0].write("sim", &project, &source).expect("written");
        let manifest = fs::read_to_string(project.join("Cargo.toml")).expect("a manifest");
        assert_eq!(manifest.matches("{ git = \"https://example.org/trocar.git\" }").count(), 2, "{manifest}");
    }
}
