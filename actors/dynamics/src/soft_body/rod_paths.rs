//! Paths of the rods in a body's own time. A body that has missed steps stands where its last step left it, while hands have
//! led their instruments on. If it met them at once where they are now, deep in its surface, it would push its light nodes
//! out with many times the instruments' speed. So in its next step the rods begin where the last one left them, and move
//! to where they are, at 2 m/s at most; what remains of the way they make in the steps after it. (A late world of rigid
//! bodies has the same for the instruments that it moves: `instrument/set_point.rs`.)

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_scene::{Access, Commands, Component, Entity, EntitySet, RecordPolicy, Snapshot, Tick};

use super::held_back::HeldBack;
use super::instrument_rods::Rod;

/// Speed of a rod's end in a body's own time, after missed steps \[m/s\]: twice that of a fast hand.
const SPEED_MAX: f64 = 2.0;
/// A rod that is farther away than this was not led there, but put \[m\].
const PUT: f64 = 0.2;

/// Where the last step of a body left the rods; on the body, while rods are near it, so that another life of its controller
/// goes on from there.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "rod_paths", record = RecordPolicy::sampled(10.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct RodPaths {
    /// Number of that step.
    pub number: u64,
    /// The instrument and the ends of each rod at the end of that step, in the body's frame and without what the body itself
    /// has displaced them by \[m\].
    pub rods: Vec<(Entity, [Point3<f64>; 2])>,
    /// Whether some had not arrived where they should be.
    pub is_behind: bool,
}

impl RodPaths {
    /// Resumes from the scene.
    #[must_use]
    pub fn resume(scene: &Snapshot, body: Entity) -> Self {
        scene.get::<Self>(body).cloned().unwrap_or_default()
    }

    /// What a controller with these bodies writes for them.
    #[must_use]
    pub fn access(access: Access, bodies: &[Entity]) -> Access {
        access.writes::<Self>(EntitySet::Of(bodies.to_vec()))
    }

    /// Ends a tick: writes them while rods are near, and once more that they are not.
    pub fn end(&self, scene: &Snapshot, body: Entity, is_near: bool, out: &mut Commands) {
        if is_near {
            out.put(body, self.clone());
        } else if scene.get::<Self>(body).is_some_and(|told| *told != Self::default()) {
            out.put(body, Self::default());
        }
    }

    /// Lets the rods begin where the last step left them, if the body has missed steps since; all in its frame.
    pub fn lead(&mut self, tick: &Tick<'_>, rods: &mut [Rod], held_back: &mut HeldBack) {
        let period = tick.period.as_secs_f64();
        let is_late = tick.number > self.number + 1 || self.is_behind;
        let are_known = self.rods.len() == rods.len()
            && self.rods.iter().zip(&*rods).all(|((instrument, _), rod)| *instrument == rod.instrument);
        let leads = is_late && are_known;
        if !are_known {
            self.rods.clear();
            self.rods.extend(rods.iter().map(|rod| (rod.instrument, rod.ends)));
        }
        self.number = tick.number;
        self.is_behind = false;
        let mut known = &mut self.rods[..];
        for own in rods.chunk_by_mut(|a, b| a.instrument == b.instrument) {
            let (left, others) = std::mem::take(&mut known).split_at_mut(own.len());
            known = others;
            let instrument = own[0].instrument;
            let [offset, velocity] = held_back.displacement(instrument);
            let far = own.iter().zip(&*left).flat_map(|(rod, (_, left))| {
                rod.ends.iter().zip(left).map(|(end, left)| (end - offset - left).norm())
            });
            let far = far.fold(0.0, f64::max);
            let share = (SPEED_MAX * period / far).min(1.0);
            let is_led = leads && far < PUT;
            for (rod, (_, left)) in own.iter_mut().zip(left) {
                for ((end, speed), left) in rod.ends.iter_mut().zip(&mut rod.velocities).zip(left) {
                    let now = *end - offset;
                    if is_led {
                        let way = (now - *left) * share;
                        (*end, *speed) = (*left + offset, way / period + velocity);
                        *left += way;
                    } else {
                        *left = now + (*speed - velocity) * period;
                    }
                }
            }
            if is_led {
                self.is_behind |= share < 1.0;
                // The first rod of an instrument is its shaft.
                held_back.is_led_at(instrument, own[0].velocities[1] - velocity);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use trocar_scene::{EventLog, Events, Jobs, SimTime};

    use super::*;

    const PERIOD: f64 = 2e-3;

    fn rod(along: f64, speed: f64) -> Rod {
        let ends = [Point3::new(along, 0.0, 0.1), Point3::new(along, 0.0, 0.0)];
        let (velocities, is_open_jaw) = ([Vector3::x() * speed; 2], false);
        Rod { instrument: Entity::from_bits(1 << 32), ends, radius: 2.5e-3, velocities, is_open_jaw }
    }

    /// Where the rod begins in a step, and its speed.
    fn step(paths: &mut RodPaths, number: u64, (along, speed): (f64, f64)) -> [f64; 2] {
        let (period, jobs, log) = (SimTime::from_secs_f64(PERIOD), Jobs::default(), EventLog::default());
        let time = SimTime::from_secs_f64(PERIOD * number as f64);
        let me = Entity::from_bits(2 << 32);
        let tick = Tick { time, period, number, me, epoch: 0, events: Events::new(&log, 0), jobs: &jobs };
        let mut rods = [rod(along, speed)];
        paths.lead(&tick, &mut rods, &mut HeldBack::default());
        [rods[0].ends[1].x, rods[0].velocities[1].x]
    }

    #[test]
    fn on_time_rods_are_where_they_are() {
        let mut paths = RodPaths::default();
        for number in 1..5 {
            let along = 1e-4 * number as f64;
            assert_eq!(step(&mut paths, number, (along, 0.05)), [along, 0.05]);
        }
    }

    #[test]
    fn after_missed_steps_they_make_the_way_of_all_in_one() {
        let mut paths = RodPaths::default();
        step(&mut paths, 1, (0.0, 0.05));
        // Ten steps later: 0.9 mm from where the first step left it.
        let [at, speed] = step(&mut paths, 11, (1e-3, 0.05));
        assert!((at - 1e-4).abs() < 1e-12 && (speed - 9e-4 / PERIOD).abs() < 1e-9);
        assert_eq!(step(&mut paths, 12, (1.1e-3, 0.05)), [1.1e-3, 0.05]);
    }

    #[test]
    fn far_away_they_follow_at_a_bounded_speed_and_arrive() {
        let mut paths = RodPaths::default();
        step(&mut paths, 1, (0.0, 0.0));
        let mut at = 0.0;
        for number in 1001..1006 {
            let [begins, speed] = step(&mut paths, number, (0.018, 0.0));
            assert!((begins - at).abs() < 1e-12 && speed <= SPEED_MAX + 1e-9);
            at = begins + speed * PERIOD;
        }
        assert_eq!(step(&mut paths, 1006, (0.018, 0.0)), [0.018, 0.0]);
        // What was put elsewhere is there.
        assert_eq!(step(&mut paths, 2000, (0.5, 0.0)), [0.5, 0.0]);
    }
}
