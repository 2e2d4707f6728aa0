//! Paths in files are relative and confined to the folder that they belong to, and to folders that the caller allows.

use std::path::{Component, Path, PathBuf};

/// The path of `relative` below `folder`.
///
/// # Errors
/// When the path is empty or absolute, contains `..`, backslashes or NUL, or leaves the folder through a link.
pub fn below(folder: &Path, relative: &str) -> Result<PathBuf, &'static str> {
    if relative.is_empty() {
        return Err("a path must not be empty");
    }
    if relative.contains(['\\', '\0']) {
        return Err("a path is written with '/' and holds no '\\' or NUL");
    }
    for part in Path::new(relative).components() {
        match part {
            Component::Normal(_) | Component::CurDir => {}
            Component::ParentDir => return Err("a path must not leave its folder ('..')"),
            Component::RootDir | Component::Prefix(_) => return Err("a path must be relative to its folder"),
        }
    }
    let joined = folder.join(relative);
    // A missing file is reported when it is opened.
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    if let (Ok(folder), Ok(file)) = (folder.canonicalize(), joined.canonicalize())
        && !file.starts_with(&folder)
    {
        return Err("a path must not leave its folder through a link");
    }
    Ok(joined)
}

/// Folders outside of a scenario's own from which meshes may be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Assets {
    /// Without links and `..`.
    roots: Vec<PathBuf>,
}

impl Assets {
    /// These folders.
    ///
    /// # Errors
    /// Names the first one that is no folder, or cannot be read.
    pub fn new(folders: &[PathBuf]) -> Result<Self, String> {
        let root = |folder: &PathBuf| {
            let found = folder.canonicalize().map_err(|why| format!("{}: {why}", folder.display()))?;
            if found.is_dir() { Ok(found) } else { Err(format!("{}: it is no folder", folder.display())) }
        };
        Ok(Self { roots: folders.iter().map(root).collect::<Result<_, _>>()? })
    }

    /// The path of `written` below `folder`; a file that is not there is looked for below the allowed folders in turn.
    /// A path that leaves `folder` must lead into one of them.
    ///
    /// # Errors
    /// The reason, and the option that allows a folder.
    pub fn find(&self, folder: &Path, written: &str) -> Result<PathBuf, String> {
        let own = below(folder, written);
        if let Ok(path) = &own {
            if !path.exists()
                && let Some(found) =
                    self.roots.iter().filter_map(|root| below(root, written).ok()).find(|path| path.exists())
            {
                return Ok(found);
            }
            return Ok(path.clone());
        }
        let reason = own.err().unwrap_or_default();
        if written.is_empty() || written.contains(['\\', '\0']) {
            return Err(reason.into());
        }
        let allowed = |file: &PathBuf| self.roots.iter().any(|root| file.starts_with(root));
        if let Some(file) = folder.join(written).canonicalize().ok().filter(allowed) {
            return Ok(file);
        }
        let shown: Vec<String> = self.roots.iter().map(|root| root.display().to_string()).collect();
        Err(match shown.is_empty() {
            true => format!("{reason}; '--assets DIR' allows meshes below another folder"),
            false => format!("{reason}, nor those that '--assets' allows: {}", shown.join(", ")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_paths_below_the_folder_pass() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let inside = folder.path().join("inside");
        std::fs::create_dir(&inside).expect("a folder");
        std::fs::write(folder.path().join("secret"), "x").expect("a file");
        std::fs::write(inside.join("mesh.obj"), "x").expect("a file");
        assert_eq!(below(&inside, "mesh.obj"), Ok(inside.join("mesh.obj")));
        assert_eq!(below(&inside, "./sub/missing.obj"), Ok(inside.join("./sub/missing.obj")));
        for bad in ["", "..", "../secret", "sub/../../secret", "/etc/passwd", "a\\b", "a\0b"] {
            assert!(below(&inside, bad).is_err(), "{bad:?} must be refused");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(folder.path().join("secret"), inside.join("link")).expect("a link");
            assert!(below(&inside, "link").is_err());
        }
    }

    #[test]
    fn allowed_folders_are_searched_and_may_be_led_into_and_others_not() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |path: &str| folder.path().join(path);
        for path in ["scenario", "meshes/sub", "others"] {
            std::fs::create_dir_all(at(path)).expect("a folder");
        }
        for file in ["scenario/own.obj", "meshes/own.obj", "meshes/sub/liver.obj", "others/secret.obj"] {
            std::fs::write(at(file), "x").expect("a file");
        }
        let assets = Assets::new(&[at("meshes")]).expect("a folder");
        let scenario = at("scenario");
        let same = |written: &str, file: &str| {
            let found = assets.find(&scenario, written).expect(written);
            assert_eq!(found.canonicalize().expect("a file"), at(file).canonicalize().expect("a file"));
        };
        same("own.obj", "scenario/own.obj");
        same("sub/liver.obj", "meshes/sub/liver.obj");
        same("../meshes/sub/liver.obj", "meshes/sub/liver.obj");
        same(&at("meshes/own.obj").display().to_string(), "meshes/own.obj");
        for bad in
            ["../others/secret.obj", "../meshes/../others/secret.obj", "/etc/passwd", "../meshes/none.obj"]
        {
            let refused = assets.find(&scenario, bad).expect_err(bad);
            assert!(refused.contains("--assets") && refused.contains("meshes"), "{refused}");
            let refused = Assets::default().find(&scenario, bad).expect_err(bad);
            assert!(refused.contains("--assets DIR"), "{refused}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("others/secret.obj"), at("meshes/link.obj")).expect("a link");
            assert!(assets.find(&scenario, "../meshes/link.obj").is_err());
        }
        assert!(Assets::new(&[at("missing")]).expect_err("not there").contains("missing"));
        assert!(Assets::new(&[at("scenario/own.obj")]).expect_err("a file").contains("no folder"));
    }
}
