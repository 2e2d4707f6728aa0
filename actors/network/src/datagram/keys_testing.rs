//! Keys for tests, from numbers in place of a TLS session.

use super::{Keys, Opener, Sealer, Side};
use trocar_scene::SimTime;

/// How long the openers of these tests know the previous key.
pub const GRACE: SimTime = SimTime::from_millis(100);

/// An exporter of a session that never was.
pub fn exporter(session: u64) -> impl FnOnce(&[u8], &[u8], &mut [u8]) -> Result<(), ()> {
    move |label, context, out| {
        let mut hash = blake3::Hasher::new();
        hash.update(&session.to_le_bytes()).update(label).update(context);
        hash.finalize_xof().fill(out);
        Ok(())
    }
}

/// Keys of a connection and phase of a session.
pub fn keys(connection: u32, phase: u32, session: u64) -> Keys {
    Keys::from_exporter(connection, phase, exporter(session)).expect("the exporter has no errors")
}

/// One end of a connection.
pub struct End {
    pub sealer: Sealer,
    pub opener: Opener,
}

impl End {
    fn new(keys: Keys, side: Side) -> Self {
        let (send, receive) = keys.split(side);
        Self { sealer: Sealer::new(send), opener: Opener::new(receive, GRACE) }
    }
}

/// Client and server with a key, or with checksums.
pub fn ends(is_protected: bool) -> [End; 2] {
    [Side::Client, Side::Server].map(|side| {
        let keys = if is_protected { keys(7, 0, 1) } else { Keys::unprotected(7, 0) };
        End::new(keys, side)
    })
}
