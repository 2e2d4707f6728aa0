//! A reflected link in virtual time: a peer of the session, with the packet reflector inside.
//!
//! A packet arrives at the very time at which it is due, and not at the next step: so its delay is the path's, as it is over
//! sockets, whose thread waits for them.

use trocar_kernel::spec::Peer;
use trocar_scene::SimTime;

use crate::hands_link::HandsLink;
use crate::reflector::{Parcel, Reflector};
use crate::teleoperation::{LinkError, LinkedHand, ReflectedLink, WatchedLink};

/// A link over a reflector, both stepped every millisecond.
pub struct ReflectedPeer {
    name: String,
    link: ReflectedLink<()>,
    reflector: Reflector<()>,
}

impl ReflectedPeer {
    /// The link at this reflector.
    pub fn new(name: &str, link: ReflectedLink<()>, reflector: Reflector<()>) -> Self {
        Self { name: name.to_owned(), link, reflector }
    }

    /// A copy in the same state for the hands of a copied session, with all that is under way.
    ///
    /// # Errors
    /// [`LinkError`].
    pub fn fork(&self, hands: Vec<LinkedHand>) -> Result<(Self, WatchedLink), LinkError> {
        let (link, watched) = self.link.fork(hands)?;
        Ok((Self { name: self.name.clone(), link, reflector: self.reflector.clone() }, watched))
    }
}

impl Peer for ReflectedPeer {
    fn name(&self) -> &str {
        &self.name
    }

    fn period_ns(&self) -> u64 {
        SimTime::from_millis(1).as_nanos()
    }

    fn step(&mut self, now: SimTime) {
        let Self { link, reflector, .. } = self;
        // What is held for reordering may be due at once, before what was due earlier: its time is the latest so far.
        let mut arrived = SimTime::ZERO;
        while let Some(due) = reflector.next_due().filter(|due| *due <= now) {
            arrived = arrived.max(due);
            let Some(Parcel { mut bytes, .. }) = reflector.due(arrived) else { break };
            link.receive(arrived, (), &mut bytes, &mut |(), _| false);
        }
        link.tick(now, &mut |(), datagram| {
            reflector.receive(datagram, (), now);
            true
        });
    }
}
