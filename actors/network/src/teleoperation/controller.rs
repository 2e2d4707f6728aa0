//! The actor of tele-operated hands: it shows in the scene what masters and slaves do, measures how well they track, and
//! tells slaves of emergency stops.

use std::sync::{Arc, Mutex, PoisonError, TryLockError};

use nalgebra::{Isometry3, Vector3};
use trocar_devices::Pedals;
use trocar_scene::kinematics::hand_rig::HandRig;
use trocar_scene::{
    Access, Commands, Controller, ControllerError, EnergyPedal, Entity, EntitySet, ForceFeedback, Hand,
    Instrument, InstrumentForce, Measured, Parent, Port, Pose, SimTime, SlaveOrder, Snapshot, Teleoperation,
    TeleoperationEnd, TeleoperationFigures, Tick,
};

use super::exchange::{LinkReport, SlaveReport, WatchedHand};
use super::reflected_link::WatchedLink;
use super::tracking::{Look, TrackingMeter};
use crate::compensation::Method;

/// A hand as its actor reaches it, with what was measured so far.
struct Watched {
    name: String,
    entity: Entity,
    end: WatchedHand,
    meter: TrackingMeter,
    /// Direction of the shaft of master and slave, for instruments in ports.
    axes: [Option<Vector3<f64>>; 2],
}

/// What all lives of the actor share: the ends of its hands and of their link, and what was measured so far.
#[derive(Clone)]
pub struct TeleoperationWatch(Arc<Mutex<Watch>>);

struct Watch {
    hands: Vec<Watched>,
    link: Option<WatchedLink>,
}

impl TeleoperationWatch {
    /// Hands with their names and entities, and the link of those that are reflected.
    pub fn new(hands: Vec<(String, Entity, WatchedHand)>, link: Option<WatchedLink>) -> Self {
        let watched = |(name, entity, end)| Watched {
            name,
            entity,
            end,
            meter: TrackingMeter::default(),
            axes: [None; 2],
        };
        let hands = hands.into_iter().map(watched).collect();
        Self(Arc::new(Mutex::new(Watch { hands, link })))
    }
}

impl TeleoperationWatch {
    /// The same for a copy of the session, with the ends of its hands in the same order, and of their link.
    pub fn fork(&self, hands: Vec<WatchedHand>, link: Option<WatchedLink>) -> Self {
        // Whoever panicked has measured a little less.
        let watch = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let copied = watch.hands.iter().zip(hands).map(|(hand, end)| Watched {
            name: hand.name.clone(),
            entity: hand.entity,
            end,
            meter: hand.meter.clone(),
            axes: hand.axes,
        });
        let hands = copied.collect();
        Self(Arc::new(Mutex::new(Watch { hands, link })))
    }
}

/// The actor.
pub struct TeleoperationController {
    watch: TeleoperationWatch,
    hands: Vec<Entity>,
}

impl TeleoperationController {
    /// A life of the actor.
    ///
    /// # Errors
    /// When an earlier life hangs in the middle of a tick.
    pub fn new(watch: &TeleoperationWatch) -> Result<Self, ControllerError> {
        let hands = match watch.0.try_lock() {
            Ok(watch) => watch.hands.iter().map(|hand| hand.entity).collect(),
            // Whoever panicked has measured a little less.
            Err(TryLockError::Poisoned(watch)) => {
                watch.into_inner().hands.iter().map(|hand| hand.entity).collect()
            }
            Err(TryLockError::WouldBlock) => {
                return Err(ControllerError::Failed("an earlier life hangs at its work".to_owned()));
            }
        };
        Ok(Self { watch: watch.clone(), hands })
    }
}

impl Controller for TeleoperationController {
    fn access(&self) -> Access {
        Access::new()
            .reads::<Hand>()
            .reads::<Instrument>()
            .reads::<InstrumentForce>()
            .reads::<Port>()
            .reads::<Pose>()
            .reads::<Parent>()
            .reads::<SlaveOrder>()
            .writes::<Teleoperation>(EntitySet::Of(self.hands.clone()))
            .writes::<Measured>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let mut watch = match self.watch.0.try_lock() {
            Ok(watch) => watch,
            Err(TryLockError::Poisoned(watch)) => watch.into_inner(),
            // Another life of this actor is at it.
            Err(TryLockError::WouldBlock) => return Ok(()),
        };
        let reflected = watch.link.as_mut().map(WatchedLink::report).unwrap_or_default();
        let mut measured = Measured::default();
        for hand in &mut watch.hands {
            let order = scene.get::<SlaveOrder>(hand.entity).copied().unwrap_or_default();
            hand.end.control.set_stop(order.stop);
            let Some(report) = *hand.end.reports.read() else { continue };
            let Ok(rig) = HandRig::read(scene, hand.entity) else { continue };
            let link = report.link.unwrap_or(reflected);
            let row = hand.row(&report, &link, &rig, scene);
            tell(&hand.name, &row.figures, &mut measured);
            out.put(hand.entity, row);
        }
        if !measured.values.is_empty() {
            out.put(tick.me, measured);
        }
        Ok(())
    }
}

impl Watched {
    fn tip(&mut self, which: usize, rig: &HandRig, handle_in_device: &Isometry3<f64>) -> Isometry3<f64> {
        let axis = self.axes[which].unwrap_or(-Vector3::z());
        let tip = rig.tip_in_world(handle_in_device, &axis);
        self.axes[which] = Some(tip.rotation * Vector3::z());
        tip
    }

    fn row(
        &mut self,
        report: &SlaveReport,
        link: &LinkReport,
        rig: &HandRig,
        scene: &Snapshot,
    ) -> Teleoperation {
        let master = self.tip(0, rig, &report.master_in_device);
        let slave = report.slave_in_device.map(|slave| self.tip(1, rig, &slave));
        // A slave whose master is elsewhere is compared with nothing, and one elsewhere is not seen.
        let master = if report.end == TeleoperationEnd::Slave { slave.unwrap_or(master) } else { master };
        if let Some(slave) = &slave {
            let force = scene.get::<InstrumentForce>(rig.instrument).map_or(0.0, |force| force.force.norm());
            self.meter.look(&Look {
                at: report.at,
                master_in_world: master.translation.vector,
                slave_in_world: slave.translation.vector,
                force,
            });
        }
        let (compared, squares, largest) = report.errors;
        let known = compared > 0;
        let mut figures = TeleoperationFigures {
            sent: link.sent,
            received: link.received,
            late: link.late,
            refused: link.refused,
            round_trip_mean: link.round_trips.map(|[mean, ..]| mean),
            round_trip_min: link.round_trips.map(|[_, min, ..]| min),
            round_trip_p99: link.round_trips.map(|[_, _, p99, _]| p99),
            round_trip_max: link.round_trips.map(|[.., max]| max),
            delay_error_p99: link.delay_errors.map(|[p99, _]| p99),
            delay_error_max: link.delay_errors.map(|[_, max]| max),
            applied_error_max: known.then_some(largest),
            applied_error_rms: known.then(|| (squares / compared as f64).sqrt()),
            limited: report.limited,
            stops: report.stops,
            silences: report.silences,
            energised: report.energised_secs,
            felt_share: report.feedback.and_then(|feedback| feedback.felt_share),
            ..TeleoperationFigures::default()
        };
        self.meter.fill(&mut figures);
        if report.end != TeleoperationEnd::Both {
            (figures.rms, figures.constant_lag, figures.constant_lag_rms) = (None, None, None);
        }
        let world_from_device = rig.registration.world_from_device().rotation;
        Teleoperation {
            end: report.end,
            state: report.state,
            pedals: pedal(report.pedals),
            master_in_world: pose(&master),
            slave_in_world: pose(&slave.unwrap_or(master)),
            at: report.at,
            applied: report.applied.unwrap_or(SimTime::ZERO),
            round_trip: link.newest.as_secs_f64(),
            force_in_world: world_from_device * report.force_in_device,
            feedback: report.feedback.map_or(ForceFeedback::None, |feedback| method(feedback.method)),
            felt_in_world: report
                .feedback
                .map_or(Vector3::zeros(), |feedback| world_from_device * feedback.force_in_device),
            // Packets of a reflected hand are sealed with a key that never leaves the process; those of ITP are open.
            protected: report.end == TeleoperationEnd::Both,
            figures,
        }
    }
}

fn pedal(pedals: Pedals) -> EnergyPedal {
    match pedals {
        Pedals::None => EnergyPedal::None,
        Pedals::Released => EnergyPedal::Released,
        Pedals::Energy => EnergyPedal::Energy,
        Pedals::Coagulate => EnergyPedal::Coagulate,
    }
}

fn method(method: Method) -> ForceFeedback {
    match method {
        Method::Passivity => ForceFeedback::Passivity,
        Method::WaveVariables => ForceFeedback::WaveVariables,
        Method::ModelMediated => ForceFeedback::ModelMediated,
    }
}

/// A pose with its rotation brought to unit length: products of rotations drift off it.
fn pose(isometry: &Isometry3<f64>) -> Pose {
    let mut rotation = isometry.rotation;
    rotation.renormalize();
    Pose::new(isometry.translation.vector, rotation)
}

/// Figures of the path between a master and its slave, by the names under which an exercise judges them. Only who has both
/// ends knows them.
pub const PATH_FIGURES: [&str; 8] = [
    "felt_share",
    "round_trip_mean_s",
    "round_trip_max_s",
    "delay_error_p99_s",
    "rms_m",
    "constant_lag_rms_m",
    "constant_lag_s",
    "applied_error_max_m",
];

/// The figures by the names under which an exercise judges them: `right.round_trip_mean_s`.
fn tell(hand: &str, figures: &TeleoperationFigures, measured: &mut Measured) {
    let known = [
        ("round_trip_mean_s", figures.round_trip_mean),
        ("round_trip_max_s", figures.round_trip_max),
        ("delay_error_p99_s", figures.delay_error_p99),
        ("rms_m", figures.rms),
        ("constant_lag_rms_m", figures.constant_lag_rms),
        ("constant_lag_s", figures.constant_lag),
        ("applied_error_max_m", figures.applied_error_max),
        ("x_range_m", Some(figures.x_range)),
        ("speed_max_m_per_s", Some(figures.speed_max)),
        ("contact_share", Some(figures.contact_share)),
        ("packets_received", Some(figures.received as f64)),
        ("energised_s", Some(figures.energised)),
        ("felt_share", figures.felt_share),
    ];
    for (name, value) in known {
        if let Some(value) = value {
            measured.values.insert(format!("{hand}.{name}"), value);
        }
    }
}
