//! Diagnosis of a path: whether a ticket would let in, whether datagrams go there and back, also the longest ones, and
//! whether both clocks agree. [`EchoEnd`] is the host's end, [`Examination`] that of whoever asks; both are sans-IO. What
//! comes before, a name that resolves and a port that takes connections, is looked at by [`reach`](crate::live::reach).
//!
//! A stranger learns nothing by it. The host answers the opening only when it knows the ticket's token, and a datagram only
//! when it is sealed with keys of that connection's TLS session and has not come before. The answer has the same payload,
//! so that it is as long as the question, and goes to where that came from. One diagnosis gets [`ECHOES_MAX`] answers.

mod echo_end;
#[cfg(test)]
mod echo_end_tests;
mod examination;

pub use echo_end::{ECHOES_MAX, EchoEnd, NEWS_EVERY};
pub use examination::{
    ECHO_EVERY, ECHOES, Echoed, Examination, Examined, FIRST_AFTER, LONG_BYTES, SHORT_BYTES, WAIT_MAX,
};
