//! Force rendering, and the controller that serves a haptic device.
