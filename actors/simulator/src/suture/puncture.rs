//! Puncture: transitions of the tip at the end of a substep (touching, puncturing, growing the channel, leaving,
//! withdrawing), and of the channel as needle and thread slide through it.

use nalgebra::{Point3, Vector3};

use super::joints::COMPLIANCE;
use super::needle_tissue::{crossed, touched};
use super::state::{BITES_MAX, Bite, CHANNEL_MAX, ChannelPoint, Event, SutureState, Tip};
use super::tissue::{MaterialPoint, PathEnd};
use super::{EVENTS_MAX, Suture, SutureError};
use crate::suture_thread::PARTED;

/// A tip further from the surface than this is no longer in contact \[m\].
const OFF: f64 = 1e-7;
/// A tip that moved less than this has not advanced \[m\].
const ON: f64 = 1e-10;

impl Suture {
    /// Whether a free tip crossed the surface; it then touches the surface there.
    pub(super) fn meets(&mut self) -> Result<bool, SutureError> {
        if self.trial.tip != Tip::Free || self.has_withdrawn() {
            return Ok(false);
        }
        let from = self.trial.needle.pose() * self.solid.point(self.solid.shape().length());
        let Some(to) = self.tip_at_iterate() else { return Ok(false) };
        let Some(crossing) = self.tissue.entry_crossing(&from, &to) else { return Ok(false) };
        if !self.tissue.name(&crossing.place) {
            return Err(SutureError::Full);
        }
        self.trial.tip = Tip::Touching(crossing.place, crossing.triangle);
        self.trial.tip_force = Vector3::zeros();
        let at = self.tissue.now(&crossing.place);
        self.event(Event::Touched(at));
        Ok(true)
    }

    fn tip_at_iterate(&self) -> Option<Point3<f64>> {
        Some(self.workspace.needle?.pose() * self.solid.point(self.solid.shape().length()))
    }

    /// Whether the free tip has gone back into its exit hole.
    fn has_withdrawn(&self) -> bool {
        let (Some(point), Some(site)) = (self.trial.channel.last(), self.workspace.sites.last()) else {
            return false;
        };
        self.bite(point.bite).is_some_and(|bite| bite.exit.is_some())
            && self.trial.channel.len() == self.workspace.sites.len()
            && site.edge.is_none()
            && site.along > self.solid.shape().length()
    }

    fn bite(&self, number: u32) -> Option<&Bite> {
        self.trial.bites.iter().find(|bite| bite.number == number)
    }

    pub(super) fn event(&mut self, event: Event) {
        if self.events.len() < EVENTS_MAX {
            self.events.push(event);
        }
    }

    /// Makes the island's result the state at the end of the substep.
    pub(super) fn commit(&mut self, dt: f64, gravity: &Vector3<f64>) -> Result<(), SutureError> {
        let Some(needle) = self.workspace.needle else { return Ok(()) };
        // Momenta from the forces, so that exchanged momentum is exact; poses as the island found them.
        let mut impulse = nalgebra::Vector6::zeros();
        for (joint, tied) in self.workspace.joints.iter().zip(self.island.tied()) {
            for (row, force) in joint.needle.iter().zip(tied.force) {
                impulse += row * (force * dt);
            }
        }
        let weight = gravity * (self.solid.mass() * dt);
        self.trial.needle.momentum += impulse.fixed_rows::<3>(0) + weight;
        self.trial.needle.angular_momentum += impulse.fixed_rows::<3>(3);
        (self.trial.needle.center, self.trial.needle.rotation) = (needle.center, needle.rotation);
        if let Some(thread) = &mut self.trial.thread {
            thread.clone_from(self.island.trial());
        }
        touched(&self.workspace, self.island.tied(), &mut self.trial.needle_contacts);
        crossed(&self.workspace, self.island.tied(), &mut self.trial.strand_contacts);
        self.trial.presses.clone_from(&self.workspace.presses);
        self.slide();
        self.tip_goes_on()?;
        self.remove_channel_ahead()?;
        self.cut()?;
        self.pass_through();
        // Forces of points that no longer exist are removed with them.
        self.tissue.deform(self.trial.forces_on_tissue());
        Ok(())
    }

    /// Updates the arc lengths at the channel points, and their forces.
    fn slide(&mut self) {
        let first = self.workspace.layout.channel;
        for index in 0..self.trial.channel.len() {
            let tied = self.island.tied()[first + index];
            let force = self.workspace.force(self.island.tied(), first + index);
            let site = self.workspace.sites[index];
            let point = &mut self.trial.channel[index];
            (point.along, point.force) = (site.along, force);
            // A sticking point keeps its place; a sliding one moves to where it would stick with its present force.
            if tied.gives_way[0] {
                point.stuck = site.along - COMPLIANCE * tied.force[0];
            }
        }
    }

    fn tip_goes_on(&mut self) -> Result<(), SutureError> {
        let Some(tie) = self.workspace.layout.tip else {
            self.trial.tip_force = Vector3::zeros();
            return Ok(());
        };
        let Some(place) = self.trial.tip.place().copied() else { return Ok(()) };
        self.trial.tip_force = self.workspace.force(self.island.tied(), tie);
        let tied = self.island.tied()[tie];
        let (force, off) = (tied.force[0], tied.gap[0] - COMPLIANCE * tied.force[0]);
        let gives_way = tied.gives_way[0];
        let slides = tied.gives_way[1] || tied.gives_way[2];
        let tip = self.trial.needle.pose() * self.solid.point(self.solid.shape().length());
        let length = self.solid.shape().length();
        match self.trial.tip {
            Tip::Free => {}
            Tip::Touching(..) if gives_way && force > 0.0 && off < -ON => {
                let number = self.trial.bites_so_far;
                let triangle = match self.trial.tip {
                    Tip::Touching(_, triangle) => triangle,
                    _ => 0,
                };
                self.open_bite(Bite {
                    number,
                    entry: (place, triangle),
                    exit: None,
                    entry_force: force,
                    exit_force: 0.0,
                })?;
                let pose = self.trial.needle.pose();
                let along = self.solid.nearest(&pose.inverse_transform_point(&self.tissue.now(&place)));
                let along = along.min(length);
                let (stuck, force_there) = (along, Vector3::zeros());
                self.add_to_channel(ChannelPoint { place, along, stuck, force: force_there, bite: number })?;
                self.event(Event::Entered { bite: number, force });
                self.go_to(&place, &tip)?;
            }
            Tip::Touching(..) if force <= 0.0 && off > OFF => self.free(),
            Tip::Touching(..) if slides && force > 0.0 => {
                let (place, triangle) = self.tissue.nearest(&tip);
                self.trial.tip = Tip::Touching(self.named(place)?, triangle);
            }
            Tip::Touching(..) => {}
            Tip::Inside(_) if gives_way && off.abs() > ON => self.go_to(&place, &tip)?,
            Tip::Inside(_) => {}
            Tip::Leaving(_, triangle) if gives_way && force < 0.0 && off > ON => {
                let number = self.trial.channel.last().map_or(0, |point| point.bite);
                if let Some(bite) = self.trial.bites.iter_mut().find(|bite| bite.number == number) {
                    bite.exit = Some((place, triangle));
                    bite.exit_force = -force;
                }
                let (along, force_there) = (length - off, Vector3::zeros());
                // Two neighbouring points, cut before and after the surface sprang back, would pinch the needle.
                let near = |point: &ChannelPoint| along - point.along < 0.5 * self.resistance.spacing;
                let only = self.trial.channel.iter().filter(|point| point.bite == number).count() < 2;
                if !only && self.trial.channel.last().is_some_and(near) {
                    self.trial.channel.pop();
                }
                self.add_to_channel(ChannelPoint {
                    place,
                    along,
                    stuck: along,
                    force: force_there,
                    bite: number,
                })?;
                self.event(Event::Left { bite: number, force: -force });
                self.free();
            }
            Tip::Leaving(..) if off < -OFF => self.go_to(&place, &tip)?,
            Tip::Leaving(..) => {}
        }
        Ok(())
    }

    fn free(&mut self) {
        self.trial.tip = Tip::Free;
        self.trial.tip_force = Vector3::zeros();
    }

    fn named(&mut self, place: MaterialPoint) -> Result<MaterialPoint, SutureError> {
        if self.tissue.name(&place) { Ok(place) } else { Err(SutureError::Full) }
    }

    /// Moves the tip straight on from a material point, to the inside or to the surface from inside.
    fn go_to(&mut self, from: &MaterialPoint, tip: &Point3<f64>) -> Result<(), SutureError> {
        let tangent = self.trial.needle.pose() * self.solid.tangent(self.solid.shape().length());
        let ahead = (tip - self.tissue.now(from)).dot(&tangent) > 0.0;
        self.trial.tip = match self.tissue.walk(from, tip) {
            PathEnd::Ends(place) => Tip::Inside(self.named(place)?),
            PathEnd::Leaves(place, triangle) if ahead => Tip::Leaving(self.named(place)?, triangle),
            // Back out through its entry; its channel is handled elsewhere.
            PathEnd::Leaves(place, _) => Tip::Inside(self.named(place)?),
        };
        Ok(())
    }

    fn open_bite(&mut self, bite: Bite) -> Result<(), SutureError> {
        if self.trial.bites.len() >= BITES_MAX {
            // The oldest empty one.
            let inside = |bite: &Bite| self.trial.channel.iter().any(|point| point.bite == bite.number);
            let Some(done) = self.trial.bites.iter().position(|bite| !inside(bite)) else {
                return Err(SutureError::Full);
            };
            self.trial.bites.remove(done);
        }
        self.trial.bites.push(bite);
        self.trial.bites_so_far += 1;
        Ok(())
    }

    fn add_to_channel(&mut self, point: ChannelPoint) -> Result<(), SutureError> {
        if self.trial.channel.len() >= CHANNEL_MAX {
            return Err(SutureError::Full);
        }
        let place = self.named(point.place)?;
        self.trial.channel.push(ChannelPoint { place, ..point });
        Ok(())
    }

    /// Removes the channel ahead of a withdrawn tip.
    fn remove_channel_ahead(&mut self) -> Result<(), SutureError> {
        let length = self.solid.shape().length();
        while let Some(point) = self.trial.channel.last().copied() {
            if point.along <= length {
                break;
            }
            let closed = self.bite(point.bite).is_some_and(|bite| bite.exit.is_some());
            match self.trial.tip {
                Tip::Free | Tip::Touching(..) if closed => {
                    // Through its exit hole.
                    self.trial.channel.pop();
                    if let Some(bite) = self.trial.bites.iter_mut().find(|bite| bite.number == point.bite) {
                        bite.exit = None;
                    }
                    self.trial.tip_force = Vector3::zeros();
                    let tip = self.trial.needle.pose() * self.solid.point(length);
                    self.event(Event::Back { bite: point.bite });
                    self.go_to(&point.place, &tip)?;
                }
                Tip::Inside(_) | Tip::Leaving(..) => {
                    self.trial.channel.pop();
                    if !self.trial.channel.iter().any(|other| other.bite == point.bite) {
                        self.event(Event::Withdrawn { bite: point.bite });
                        self.free();
                    }
                }
                _ => break,
            }
        }
        Ok(())
    }

    /// Extends the channel behind an advanced tip.
    fn cut(&mut self) -> Result<(), SutureError> {
        let Tip::Inside(_) = self.trial.tip else { return Ok(()) };
        let length = self.solid.shape().length();
        let pose = self.trial.needle.pose();
        while let Some(last) = self.trial.channel.last().copied() {
            let along = last.along + self.resistance.spacing;
            if along > length {
                break;
            }
            let PathEnd::Ends(place) = self.tissue.walk(&last.place, &(pose * self.solid.point(along)))
            else {
                break;
            };
            self.add_to_channel(ChannelPoint {
                place,
                along,
                stuck: along,
                force: Vector3::zeros(),
                bite: last.bite,
            })?;
        }
        Ok(())
    }

    /// Removes the channel points that needle and thread have left behind.
    fn pass_through(&mut self) {
        // A point at the very end of the thread has lost it, and so has one at either end of a cut-off piece.
        let lost = |state: &SutureState, point: &ChannelPoint| {
            let Some(thread) = &state.thread else { return point.along <= 0.0 };
            let arc = -point.along;
            thread.pieces().enumerate().any(|(piece, [begin, end])| {
                let near = 1e-6 * (end - begin);
                let is_at_begin = piece > 0 && arc <= begin + near && arc > begin - 0.5 * PARTED;
                is_at_begin || (arc >= end - near && arc < end + 0.5 * PARTED)
            })
        };
        while let Some(index) = self.trial.channel.iter().position(|point| lost(&self.trial, point)) {
            let point = self.trial.channel.remove(index);
            if !self.trial.channel.iter().any(|other| other.bite == point.bite) {
                self.event(Event::Through { bite: point.bite });
            }
        }
        // A tip in the tissue keeps a channel behind it.
        if self.trial.channel.is_empty() && matches!(self.trial.tip, Tip::Inside(_) | Tip::Leaving(..)) {
            self.free();
        }
    }
}
