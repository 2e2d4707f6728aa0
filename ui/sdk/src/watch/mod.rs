//! What a run watches beside the session: contacts that are not kept, motion of the hands, rates of the actors.

pub mod contacts;
pub mod motion;
pub mod rates;
