//! The plan of a session, kept so that resets and branches need not read or parse anything.

use std::sync::Arc;

use trocar_kernel::FlowLimit;
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::spec::{ControllerSpec, Factory, Fence, SessionSpec, StopWhen, ZeroForces};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::{SimTime, Snapshot, Store, TaskState};

use crate::hands::{HandFaults, HandPort};
use crate::kind::{Blueprint, ForHands};
use crate::options::FaultTargets;

/// Session time between two checks whether the exercise is over.
const STOP_CHECK: SimTime = SimTime::from_millis(20);

/// A session's controllers, scene and limits. Immutable, so that any number of sessions share it.
#[derive(Clone)]
pub(crate) struct SessionPlan {
    pub scenario: String,
    pub station: u16,
    /// The scene at the start.
    pub scene: Snapshot,
    pub roles: Vec<Role>,
    pub until: Option<SimTime>,
    /// The fault plan, if any.
    pub faults: Option<FaultPlan>,
    /// Further targets for faults.
    pub fault_targets: FaultTargets,
}

/// A controller of the session: its entry, and how it is built.
#[derive(Clone)]
pub(crate) struct Role {
    pub name: String,
    pub writer: u16,
    pub rate_hz: f64,
    pub phase: SimTime,
    pub class: RuntimeClass,
    factory: Factory,
    fences: Vec<Arc<dyn Fence>>,
    for_hands: Option<ForHands>,
}

/// A controller that cannot serve other hands than those it was made for.
#[derive(Debug)]
pub(crate) struct BoundToHands(pub String);

impl Role {
    pub fn new(name: &str, writer: u16, rate_hz: f64, blueprint: Blueprint) -> Self {
        let Blueprint { class, factory, fences, for_hands, arrange: _ } = blueprint;
        Self {
            name: name.to_owned(),
            writer,
            rate_hz,
            phase: SimTime::ZERO,
            class,
            factory,
            fences,
            for_hands,
        }
    }

    fn spec(&self, (factory, fences): (Factory, Vec<Arc<dyn Fence>>)) -> ControllerSpec {
        let mut spec =
            ControllerSpec::new(&self.name, self.writer, self.class, self.rate_hz, move |context| {
                factory(context)
            });
        spec.phase = self.phase;
        spec.fences = fences;
        if self.class == RuntimeClass::Network {
            // A scene that arrives whole is one batch, of whatever size.
            spec.flow = FlowLimit::UNLIMITED;
        }
        spec
    }

    /// Its specification for the session that it was made for.
    fn first(&self) -> ControllerSpec {
        self.spec((self.factory.clone(), self.fences.clone()))
    }

    /// Its specification for a session with other hands.
    fn other(&self, hands: &[HandPort]) -> Result<ControllerSpec, BoundToHands> {
        let bound = || BoundToHands(self.name.clone());
        match &self.for_hands {
            Some(for_hands) => Ok(self.spec(for_hands(hands).ok_or_else(bound)?)),
            // A controller with a device's fence serves that device, whatever its kind says.
            None if self.fences.is_empty() => Ok(self.first()),
            None => Err(bound()),
        }
    }
}

impl SessionPlan {
    /// The session that the plan was made for, with this seed and begin.
    pub fn first(&self, start: (u64, SimTime), hands: &[HandPort]) -> SessionSpec {
        let controllers = self.roles.iter().map(Role::first).collect();
        let mut spec = self.session(start, Store::from_snapshot(&self.scene), controllers, hands);
        // A session derived from this one later registers its own windows, if any.
        spec.fault_sinks.extend(self.fault_targets.0.iter().cloned());
        spec
    }

    /// Another session of the same controllers, with this seed and begin, beginning in `scene`.
    pub fn other(
        &self,
        start: (u64, SimTime),
        scene: Store,
        hands: &[HandPort],
    ) -> Result<SessionSpec, BoundToHands> {
        let controllers = self.roles.iter().map(|role| role.other(hands)).collect::<Result<_, _>>()?;
        Ok(self.session(start, scene, controllers, hands))
    }

    fn session(
        &self,
        (seed, begin): (u64, SimTime),
        scene: Store,
        controllers: Vec<ControllerSpec>,
        hands: &[HandPort],
    ) -> SessionSpec {
        let mut spec = SessionSpec::new(&self.scenario, seed, scene, controllers);
        spec.station = self.station;
        spec.begin = begin;
        spec.until = self.until;
        spec.stop_when = Some(StopWhen {
            every: STOP_CHECK,
            check: Arc::new(|scene| scene.iter::<TaskState>().any(|(_, task)| task.over)),
        });
        spec.faults = self.faults.clone().unwrap_or(spec.faults);
        for port in hands {
            let fence = port.slot.fence().clone();
            let zero: ZeroForces = Arc::new(move || fence.zero_all_forces());
            spec.zero_forces.push(zero);
            spec.fault_sinks.push((port.fault_target(), HandFaults::sink(port, begin)));
        }
        spec
    }
}
