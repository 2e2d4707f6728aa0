//! What a session does without, because the system refused it or it had to be taken away.

use trocar_devices::Scheduling;

use super::{Running, Session};

impl Session {
    /// What the system refused (real-time priority of drivers and controllers) and whose real-time priority was taken
    /// away on the way, one sentence each with how to mend it. Empty in virtual time, and when nothing is amiss.
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
