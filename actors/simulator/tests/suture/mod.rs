//! Needle, thread and tissue.

mod controller;
mod island;
mod knot;
mod needle;
mod needle_instrument;
mod needle_rigid_body;
mod needle_thread_contact;
mod puncture;
mod stitch;
mod tightened;
mod tissue_surface;
