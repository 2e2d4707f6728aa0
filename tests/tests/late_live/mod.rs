//! Live sessions in which actors are late.

mod too_slow;
mod under_load;
