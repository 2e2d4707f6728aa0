//! Exercises: goals, errors, scores.
