//! Sessions on Zenoh, over sockets of this machine.

mod arbiter;
mod bounds;
mod controllers;
mod foreign;
mod hands;
mod lost;
mod rights;
mod sites;
mod support;
