//! The supervisor tree: specifications as data and a sans-IO core that both drivers use unchanged.

mod child;

pub use child::{Backoff, ChildSpec, GroupSpec, Intensity, Node, Restart, RuntimeClass, Strategy};
