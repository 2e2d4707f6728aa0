//! Tests of touch at a station.
