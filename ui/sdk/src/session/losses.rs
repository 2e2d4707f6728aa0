//! Losses of a session: what the system refused, what was revoked, and which solvers gave up.

use trocar_devices::Scheduling;
use trocar_scene::{DeviceInfo, Frozen, HeatFrozen, MeshRemarks, MeshRepaired, OutOfValidity, Snapshot};

use super::{Running, Session};

/// One sentence for each body that stands still, in all or in its heat, because its solver could not go on.
#[must_use]
pub fn frozen_now(scene: &Snapshot) -> Vec<String> {
    let whole = scene.iter::<Frozen>().map(|(body, frozen)| {
        let since = frozen.since.as_secs_f64();
        format!("{}: it stands still since {since:.2} s: {}", scene.name(body), frozen.reason)
    });
    let heat = scene.iter::<HeatFrozen>().map(|(body, frozen)| {
        let since = frozen.since.as_secs_f64();
        format!("{}: its heat stands still since {since:.2} s: {}", scene.name(body), frozen.reason)
    });
    whole.chain(heat).collect()
}

/// One sentence for each body that moves outside its method's range of validity, or whose mesh had to be repaired or gives
/// reason to doubt; and for each hand whose device strangers may move.
#[must_use]
pub fn doubts(scene: &Snapshot) -> Vec<String> {
    let doubtful = scene.iter::<OutOfValidity>().map(|(body, doubtful)| {
        let since = doubtful.since.as_secs_f64();
        format!("{}: since {since:.2} s {}", scene.name(body), doubtful.reason)
    });
    let repaired = scene
        .iter::<MeshRepaired>()
        .map(|(body, repaired)| format!("{}: its mesh was mended: {}", scene.name(body), repaired.what));
    let remarks = scene.iter::<MeshRemarks>().flat_map(|(body, told)| {
        told.remarks.iter().map(move |remark| format!("{}: its mesh: {remark}", scene.name(body)))
    });
    let open =
        scene.iter::<DeviceInfo>().filter(|(_, device)| device.is_unprotected()).map(|(hand, device)| {
            format!("{}: {}: whoever reaches its port moves it", scene.name(hand), device.model)
        });
    doubtful.chain(repaired).chain(remarks).chain(open).collect()
}

impl Session {
    /// The real-time priority of drivers and controllers that the system refused or that was revoked during the run,
    /// one sentence each with the remedy. Empty in virtual time, and when there are no losses.
    pub fn losses(&self) -> Vec<String> {
        let Running::Live(session, _) = &self.running else { return Vec::new() };
        let mut losses = Vec::new();
        let permission = session.permission();
        if !permission.fifo {
            losses.push(permission.refused);
        }
        for (hand, driver) in self.hands.iter().zip(&self.drivers) {
            if let Some(Scheduling::Refused { priority, reason }) = driver.scheduling() {
                losses.push(format!(
                    "{}: its driver runs without real-time priority (SCHED_FIFO {priority}): {reason}",
                    hand.fault_target()
                ));
            }
        }
        let demoted = session.stats().into_iter().filter(|row| row.demotions > 0);
        losses.extend(demoted.map(|row| {
            format!(
                "{}: its real-time priority was taken away, because its steps kept taking more than 80 % of their \
                 periods (p99 {:.0} µs at {:.0} Hz)",
                row.name, row.step_us.p99, row.target_hz
            )
        }));
        losses
    }
}
