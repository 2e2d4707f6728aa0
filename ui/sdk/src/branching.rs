//! Reset and branching of sessions in virtual time.

use std::any::Any;
use std::sync::Arc;

use thiserror::Error;
use trocar_devices::HapticDevice;
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::lockstep::{LockstepSession, Moment};
use trocar_kernel::spec::{Factory, Peer, SessionSpec};
use trocar_kernel::{BranchError as KernelError, SessionError};
use trocar_scene::{SimTime, Snapshot, Store};

use crate::hands::{HandPort, OpenedHand, SteppedHand};
use crate::network::{NetworkError, ReflectedOrigin, TELEOPERATION};
use crate::session::plan::{BoundToHands, SessionPlan};
use crate::session::{Running, Session};

/// Why a session cannot be reset or branched.
#[derive(Debug, Error)]
pub enum BranchError {
    /// The session runs in real time.
    #[error("a session in real time can neither begin again nor be branched; open it in virtual time")]
    Live,
    /// A device that a person holds, or whose driver cannot copy it.
    #[error("hand {0}: its device exists only once; virtual and replayed hands can be copied")]
    Device(String),
    /// A controller that is bound to the hands that it was made for.
    #[error("controller '{0}' does not say how it serves other hands: Blueprint::for_hands")]
    Controller(String),
    /// The path of a hand behind a packet reflector.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The snapshot cannot be continued from.
    #[error(transparent)]
    Snapshot(#[from] KernelError),
    /// A controller could not be built from the scene.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// The plan and prototypes of a session in virtual time.
pub(crate) struct Origin {
    pub plan: Arc<SessionPlan>,
    /// For each hand its device before it was opened; `None` for a device that exists only once.
    pub prototypes: Vec<Option<Box<dyn HapticDevice>>>,
    pub seed: u64,
    /// Session time at the start.
    pub begin: SimTime,
    /// The hands behind a packet reflector, whose link is made again for each copy.
    pub reflected: Option<ReflectedOrigin>,
}

impl Origin {
    fn fork(&self) -> Self {
        let fork = |device: &Option<Box<dyn HapticDevice>>| device.as_ref().and_then(|device| device.fork());
        Self {
            plan: self.plan.clone(),
            prototypes: self.prototypes.iter().map(fork).collect(),
            seed: self.seed,
            begin: self.begin,
            reflected: self.reflected.as_ref().map(ReflectedOrigin::again),
        }
    }

    fn prototypes<'a>(
        &'a self,
        ports: &'a [HandPort],
    ) -> impl Iterator<Item = Result<(&'a HandPort, &'a dyn HapticDevice), BranchError>> {
        ports.iter().zip(&self.prototypes).map(|(port, prototype)| match prototype {
            Some(prototype) => Ok((port, &**prototype)),
            None => Err(BranchError::Device(port.name.clone())),
        })
    }
}

impl From<BoundToHands> for BranchError {
    fn from(BoundToHands(name): BoundToHands) -> Self {
        Self::Controller(name)
    }
}

fn once(port: &HandPort) -> BranchError {
    BranchError::Device(port.name.clone())
}

impl Session {
    /// Resets the session: the scene and the time of the start, the same seed. Nothing is read or parsed again. A
    /// recording ends here; what follows is not recorded.
    ///
    /// ```
    /// use trocar::prelude::*;
    ///
    /// let mut session = Session::open("wall")?;
    /// session.step(SimTime::from_millis(200));
    /// let hash = session.hash();
    /// session.reset()?;
    /// assert_eq!(session.now(), SimTime::ZERO);
    /// session.step(SimTime::from_millis(200));
    /// assert_eq!(session.hash(), hash, "the same seed gives the same bits");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`BranchError`]; the session is unchanged.
    pub fn reset(&mut self) -> Result<(), BranchError> {
        let (_, origin) = self.virtual_time()?;
        let seed = origin.seed;
        self.reset_with_seed(seed)
    }

    /// Resets the session with another seed, for another tremor of the trainee and other random faults.
    ///
    /// # Errors
    /// [`BranchError`]; the session is unchanged.
    pub fn reset_with_seed(&mut self, seed: u64) -> Result<(), BranchError> {
        let (_, origin) = self.virtual_time()?;
        let mut hands = origin
            .prototypes(&self.hands)
            .map(|hand| {
                hand.and_then(|(port, device)| OpenedHand::anew(port, device).ok_or_else(|| once(port)))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let (ports, mut spec) = cast(origin, seed, Store::from_snapshot(&origin.plan.scene), &hands)?;
        let mut reflected = origin.reflected.as_ref().map(ReflectedOrigin::again);
        let path = reflected.as_mut().map(|reflected| reflected.anew(&mut hands)).transpose()?;
        spec.peers.extend(hands.into_iter().map(OpenedHand::into_peer));
        join(path, &mut spec);
        let begun = Running::Lockstep(Box::new(LockstepSession::new(spec)?));
        if let Running::Lockstep(before) = std::mem::replace(&mut self.running, begun) {
            // Closes its recording, if it has one.
            before.finish();
        }
        self.hands = ports;
        self.fences_raised = false;
        if let Some(origin) = &mut self.origin {
            (origin.seed, origin.reflected) = (seed, reflected);
        }
        Ok(())
    }

    /// Branches the session: another one in the same state, with the same scene, time, score and state hash; rings stay
    /// held and hands keep moving. The two share only immutable data. This session is unchanged.
    ///
    /// Every controller is rebuilt from the scene, as after a failure; drivers, virtual hands and faults in progress
    /// are copied. A branch is not recorded. It costs less than a millisecond in the peg transfer.
    ///
    /// ```
    /// use trocar::prelude::*;
    ///
    /// let mut session = Session::open("wall")?;
    /// session.step(SimTime::from_millis(300));
    /// let (mut one, mut other) = (session.branch()?, session.branch()?);
    /// one.step(SimTime::from_millis(100));
    /// other.step(SimTime::from_millis(100));
    /// assert_eq!(one.hash(), other.hash());
    /// assert_eq!(session.now(), SimTime::from_millis(300), "nobody has told this one");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`BranchError`].
    pub fn branch(&self) -> Result<Self, BranchError> {
        let (session, origin) = self.virtual_time()?;
        self.branch_at(session.present(), origin.fork())
    }

    /// Another session in the same state, as [`Session::branch`] makes it, in which the faults of `plan` happen instead
    /// of those that this one still has before it. Times of the plan are times of the session; what is over by now is
    /// left out.
    ///
    /// So one run up to a critical moment serves any number of faults at that moment.
    ///
    /// ```
    /// use trocar::prelude::*;
    ///
    /// let mut session = Session::open("wall")?;
    /// session.step(SimTime::from_millis(300));
    /// let mut calm = session.branch()?;
    /// let mut struck = session.branch_with_faults(FaultPlan::new(1).at(secs(0.35)).kill("engine"))?;
    /// calm.step(SimTime::from_millis(100));
    /// struck.step(SimTime::from_millis(100));
    /// let restarts = |session: &Session| session.reports().iter().map(|row| row.restarts).sum::<u32>();
    /// assert_eq!((restarts(&calm), restarts(&struck)), (0, 1));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`BranchError`]; also when the plan strikes what the session does not have.
    pub fn branch_with_faults(&self, plan: FaultPlan) -> Result<Self, BranchError> {
        let (session, origin) = self.virtual_time()?;
        let mut origin = origin.fork();
        origin.plan = Arc::new(SessionPlan { faults: Some(plan), ..(*origin.plan).clone() });
        self.branch_at(session.present().with_faults_anew(), origin)
    }

    /// Another session that continues from `snapshot`: a snapshot of this session, of a session that it was branched
    /// from or into, or of a recording of the same scenario.
    ///
    /// For the present snapshot this is [`Session::branch`]. For a past one, hands and drivers continue from their
    /// state in the scene: position and velocity as measured, the force as rendered, and the last energy account that
    /// was written. Of a hand behind a packet reflector nothing is under way: its slave stands for a round trip, and goes to
    /// its master then. The state hash continues from that of the snapshot if it is among the last 256 of this session;
    /// otherwise it starts at the snapshot's scene.
    ///
    /// # Errors
    /// [`BranchError`].
    pub fn branch_from(&self, snapshot: &Snapshot) -> Result<Self, BranchError> {
        let (session, origin) = self.virtual_time()?;
        self.branch_at(session.moment_of(snapshot)?, origin.fork())
    }

    /// The branch of `origin`, which differs from this session's at most in its plan.
    fn branch_at(&self, moment: Moment, mut origin: Origin) -> Result<Self, BranchError> {
        let (session, _) = self.virtual_time()?;
        let mut hands = if moment.is_present() {
            let stepped = session.peers().filter_map(|peer| (peer as &dyn Any).downcast_ref::<SteppedHand>());
            let forks = self.hands.iter().zip(stepped);
            forks.map(|(port, hand)| hand.fork().ok_or_else(|| once(port))).collect::<Result<Vec<_>, _>>()?
        } else {
            let resume = |(port, device)| {
                OpenedHand::resumed(port, device, moment.scene(), moment.at()).ok_or_else(|| once(port))
            };
            origin.prototypes(&self.hands).map(|hand| hand.and_then(resume)).collect::<Result<Vec<_>, _>>()?
        };
        let scene = Store::from_snapshot(moment.scene());
        let (ports, mut spec) = cast(&origin, origin.seed, scene, &hands)?;
        let path = match &mut origin.reflected {
            None => None,
            Some(reflected) if moment.is_present() => Some(reflected.fork(session.peers(), &mut hands)?),
            // What was under way then is not in the scene: slaves stand for a round trip.
            Some(reflected) => Some(reflected.anew(&mut hands)?),
        };
        spec.peers.extend(hands.into_iter().map(OpenedHand::into_peer));
        join(path, &mut spec);
        let running = Running::Lockstep(Box::new(LockstepSession::resume(spec, moment)?));
        Ok(Self::new(running, ports, Vec::new(), Some(origin)))
    }

    fn virtual_time(&self) -> Result<(&LockstepSession, &Origin), BranchError> {
        match (&self.running, &self.origin) {
            (Running::Lockstep(session), Some(origin)) => Ok((session, origin)),
            _ => Err(BranchError::Live),
        }
    }
}

/// Adds the path of reflected hands, whose actor is bound to it.
fn join(path: Option<(Box<dyn Peer>, Factory)>, spec: &mut SessionSpec) {
    let Some((peer, factory)) = path else { return };
    spec.peers.push(peer);
    if let Some(actor) = spec.controllers.iter_mut().find(|actor| actor.name == TELEOPERATION) {
        actor.factory = factory;
    }
}

/// The controllers of the same plan, for other hands.
fn cast(
    origin: &Origin,
    seed: u64,
    scene: Store,
    hands: &[OpenedHand],
) -> Result<(Vec<HandPort>, SessionSpec), BranchError> {
    let ports: Vec<HandPort> = hands.iter().map(|hand| hand.port().clone()).collect();
    let spec = origin.plan.other((seed, origin.begin), scene, &ports)?;
    Ok((ports, spec))
}
