//! Confined paths: paths in a file must stay below that file's folder.

use std::path::{Component, Path, PathBuf};

/// `folder/relative`, if that stays below `folder` as written and, where the file exists, also after symbolic links are
/// resolved.
///
/// # Errors
/// The reason, without the path.
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
}
