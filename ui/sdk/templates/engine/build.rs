//! Builds the engine as a shared library beside the program, so that this crate runs without further setup.
//!
//! For an engine that comes as a compiled library, delete this file and the folder `engine`, and name the library in
//! the environment: `CHAIN_ENGINE=/opt/vendor/libchain.so`.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=engine");
    println!("cargo::rerun-if-env-changed=CC");
    let out = std::env::var("OUT_DIR").expect("cargo sets it");
    let library = Path::new(&out).join(format!(
        "{}chain{}",
        std::env::consts::DLL_PREFIX,
        std::env::consts::DLL_SUFFIX
    ));
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let built = Command::new(&compiler)
        .args(["-std=c11", "-O2", "-Wall", "-Wextra", "-fPIC", "-shared", "engine/chain.c", "-lm", "-o"])
        .arg(&library)
        .status();
    match built {
        Ok(status) if status.success() => {}
        Ok(status) => panic!("{compiler} engine/chain.c: {status}"),
        Err(error) => panic!("a C compiler is needed: {compiler}: {error}; another one is named in CC"),
    }
    println!("cargo::rustc-env=CHAIN_ENGINE_BUILT={}", library.display());
}
