//! Safe bindings to the engine's C ABI. All unsafe code of this crate is here; this file exports only safe functions.

use std::ffi::c_void;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;
use std::sync::Arc;

use libloading::{Library, Symbol};
use thiserror::Error;

/// The version of the ABI that this file supports: `CHAIN_ABI` in `chain.h`.
pub const ABI: u32 = 1;
const OK: i32 = 0;

/// Why an engine cannot be used.
#[derive(Debug, Error)]
pub enum EngineError {
    /// The file does not exist or is no library.
    #[error("{file}: cannot be loaded: {reason}", file = file.display())]
    Load {
        /// The library.
        file: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// A function is missing.
    #[error("{file}: has no function '{symbol}'; it needs chain_abi, chain_create, chain_set, chain_get, \
             chain_step and chain_destroy", file = file.display())]
    Symbol {
        /// The library.
        file: PathBuf,
        /// The function.
        symbol: &'static str,
    },
    /// Another version of the ABI.
    #[error("{file}: was built for version {found} of the ABI; this program speaks version {ABI}", file = file.display())]
    Abi {
        /// The library.
        file: PathBuf,
        /// Its version.
        found: u32,
    },
    /// The engine refused these parameters.
    #[error("the engine makes no chain of these figures: {0}")]
    Create(String),
    /// A call failed.
    #[error("the engine refused {call}: code {code}")]
    Call {
        /// The function.
        call: &'static str,
        /// Its error code.
        code: i32,
    },
    /// The engine returned a NaN or an infinity.
    #[error("the engine's state is no longer finite")]
    NotFinite,
}

type Handle = *mut c_void;
type Create = unsafe extern "C" fn(u32, f64, f64, f64, f64) -> Handle;
type Set = unsafe extern "C" fn(Handle, *const f64, *const f64, u32) -> i32;
type Get = unsafe extern "C" fn(Handle, *mut f64, *mut f64, u32) -> i32;
type Step = unsafe extern "C" fn(Handle, f64, f64, *const f64) -> i32;
type Destroy = unsafe extern "C" fn(Handle);

/// A loaded engine: its functions, and the library that must stay loaded while they are called.
pub struct Engine {
    create: Create,
    set: Set,
    get: Get,
    step: Step,
    destroy: Destroy,
    _library: Library,
}

impl Engine {
    /// Loads a library and checks its version and all functions, so that none can be missing later.
    ///
    /// # Errors
    /// [`EngineError`] names the file, and what is wrong with it.
    pub fn load(file: &Path) -> Result<Arc<Self>, EngineError> {
        // SAFETY: loading runs the library's initialisers. The user who names the library, on the command line or in
        // the environment, trusts it as much as the program itself.
        let library = unsafe { Library::new(file) }
            .map_err(|error| EngineError::Load { file: file.to_owned(), reason: error.to_string() })?;
        // SAFETY: `chain.h` declares this signature, in every version of the ABI.
        let abi: unsafe extern "C" fn() -> u32 = unsafe { symbol(&library, file, "chain_abi") }?;
        // SAFETY: it takes no arguments and has no side effects.
        let found = unsafe { abi() };
        if found != ABI {
            return Err(EngineError::Abi { file: file.to_owned(), found });
        }
        // SAFETY: the library reports the version whose `chain.h` declares these signatures.
        unsafe {
            Ok(Arc::new(Self {
                create: symbol(&library, file, "chain_create")?,
                set: symbol(&library, file, "chain_set")?,
                get: symbol(&library, file, "chain_get")?,
                step: symbol(&library, file, "chain_step")?,
                destroy: symbol(&library, file, "chain_destroy")?,
                _library: library,
            }))
        }
    }
}

/// A function of the library.
///
/// # Safety
/// `T` must be the signature of the function of that name.
unsafe fn symbol<T: Copy>(library: &Library, file: &Path, name: &'static str) -> Result<T, EngineError> {
    // SAFETY: guaranteed by the caller.
    let found: Result<Symbol<T>, _> = unsafe { library.get(name.as_bytes()) };
    found.map(|symbol| *symbol).map_err(|_| EngineError::Symbol { file: file.to_owned(), symbol: name })
}

/// One chain in the engine.
pub struct Chain {
    engine: Arc<Engine>,
    handle: NonNull<c_void>,
    masses: usize,
}

// SAFETY: the ABI has no thread-local state, and a `Chain` is used by one thread at a time, since it is not `Sync`.
unsafe impl Send for Chain {}

impl Chain {
    /// `masses` masses of `mass` \[kg\] on springs of `length` \[m\], `stiffness` [N/m] and `damping` [N·s/m].
    ///
    /// # Errors
    /// When the engine refuses these parameters.
    pub fn new(
        engine: &Arc<Engine>,
        masses: u32,
        mass: f64,
        length: f64,
        stiffness: f64,
        damping: f64,
    ) -> Result<Self, EngineError> {
        // SAFETY: plain numbers; the engine checks them.
        let handle = unsafe { (engine.create)(masses, mass, length, stiffness, damping) };
        let handle = NonNull::new(handle).ok_or_else(|| {
            EngineError::Create(format!(
                "{masses} masses of {mass} kg, {length} m apart, {stiffness} N/m, {damping} N·s/m"
            ))
        })?;
        Ok(Self { engine: engine.clone(), handle, masses: masses as usize })
    }

    /// Sets positions \[m\] and velocities [m/s], three numbers per mass.
    ///
    /// # Errors
    /// When their number is wrong.
    pub fn set(&mut self, positions: &[f64], velocities: &[f64]) -> Result<(), EngineError> {
        // The engine trusts the number that it is given: both arrays must have that length.
        if positions.len() != velocities.len() {
            return Err(EngineError::Call { call: "chain_set", code: -1 });
        }
        let numbers = positions.len() as u32;
        // SAFETY: both arrays have `numbers` elements; the engine refuses any other number than its own.
        let code = unsafe {
            (self.engine.set)(self.handle.as_ptr(), positions.as_ptr(), velocities.as_ptr(), numbers)
        };
        answered("chain_set", code)
    }

    /// Reads positions \[m\] and velocities [m/s] into buffers, which are reused.
    ///
    /// # Errors
    /// When the engine fails, or returns a NaN or an infinity: a library is an untrusted source like any file.
    pub fn get(&self, positions: &mut Vec<f64>, velocities: &mut Vec<f64>) -> Result<(), EngineError> {
        positions.resize(3 * self.masses, 0.0);
        velocities.resize(3 * self.masses, 0.0);
        let numbers = positions.len() as u32;
        // SAFETY: both buffers have `numbers` elements, and the engine writes no more.
        let code = unsafe {
            (self.engine.get)(self.handle.as_ptr(), positions.as_mut_ptr(), velocities.as_mut_ptr(), numbers)
        };
        answered("chain_get", code)?;
        if positions.iter().chain(velocities.iter()).all(|number| number.is_finite()) {
            Ok(())
        } else {
            Err(EngineError::NotFinite)
        }
    }

    /// Advances by `seconds`, under `gravity` [m/s²] along z and a force \[N\] on the last mass.
    ///
    /// # Errors
    /// When the engine refuses the parameters.
    pub fn step(&mut self, seconds: f64, gravity: f64, force: [f64; 3]) -> Result<(), EngineError> {
        // SAFETY: `force` has the three elements that the engine reads.
        let code = unsafe { (self.engine.step)(self.handle.as_ptr(), seconds, gravity, force.as_ptr()) };
        answered("chain_step", code)
    }
}

impl Drop for Chain {
    fn drop(&mut self) {
        // SAFETY: the handle came from `create`, is destroyed once, and the library is still loaded.
        unsafe { (self.engine.destroy)(self.handle.as_ptr()) };
    }
}

fn answered(call: &'static str, code: i32) -> Result<(), EngineError> {
    if code == OK { Ok(()) } else { Err(EngineError::Call { call, code }) }
}
