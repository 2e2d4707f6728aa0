//! Exercises: goals, errors, scores.
pub mod fls_score;
pub mod motion_metrics;
