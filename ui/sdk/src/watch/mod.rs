//! What a run watches beside the session: contacts that are not kept, bodies that stand still,
//! motion of the hands, rates of the actors.

pub mod contacts;
pub mod frozen;
pub mod motion;
pub mod rates;
