//! Sessions over a network: programs that join each other, and sessions in virtual time.

mod blocked_datagrams;
mod host_and_join;
mod live_pairs;
mod mentoring;
mod robots;
mod stations;
