//! What exists, and the contract of those who act on it.
