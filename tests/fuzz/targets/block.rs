//! The body of a block of a recording, unpacked: rows in columns.
#![no_main]

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::Bound;
use trocar_kernel::recorder::rows_of_body;

/// A number of one byte is held as a word among the planes, the rows, the history and the values that are made of it.
const BLOCK: Bound = Bound { per_byte: 384, always: 64 << 10 };

// Twice: the second time with the first as its history.
fuzz_target!(|bytes: &[u8]| {
    let (first, second) = bytes.split_at(bytes.len() / 2);
    for bodies in [&[bytes][..], &[first, second]] {
        // Read or refused, it must not panic.
        let _ = BLOCK.holds(bytes.len(), || rows_of_body(bodies));
    }
});
