//! What people hold: haptic and input drivers, virtual and replayed ones.
