//! Knots of throws of two turns and more hold with the half step and with the half segment as they do with the whole.

use crate::support::turned_knot::{SLIPPERY, TRIAL, Trial, holds};

#[test]
fn they_hold_with_half_the_step() {
    let half = |trial: Trial| Trial { dt: 0.5 * trial.dt, loaded_dt: 0.5 * trial.loaded_dt, ..trial };
    holds("half the step, 0.1", &half(SLIPPERY));
    for friction in [0.2, 0.3] {
        holds(&format!("half the step, {friction}"), &half(Trial { friction, ..TRIAL }));
    }
}

#[test]
fn they_hold_with_half_the_segment() {
    let half = |trial: Trial| Trial { segment: 0.5 * trial.segment, ..trial };
    holds("half the segment, 0.1", &half(SLIPPERY));
    for friction in [0.2, 0.3] {
        holds(&format!("half the segment, {friction}"), &half(Trial { friction, ..TRIAL }));
    }
}
