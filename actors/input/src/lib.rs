//! Virtual trainees and other input.
