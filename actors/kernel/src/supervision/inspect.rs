//! Read access to the state of a supervisor tree.

use std::sync::Arc;

use super::child::{ChildSpec, GroupSpec};
#[cfg(doc)]
use super::core::INCIDENTS_MAX;
use super::core::{Phase, Stage, Supervisor};
use super::event::{ChildId, Health, Incident};

impl Supervisor {
    /// The tree's specification.
    pub fn tree(&self) -> &Arc<GroupSpec> {
        &self.tree
    }
    /// Number of children.
    pub fn len(&self) -> usize {
        self.children.len()
    }
    /// Always false: a tree without children is refused.
    pub fn is_empty(&self) -> bool {
        self.children.is_empty()
    }
    /// The child of this name.
    pub fn find(&self, name: &str) -> Option<ChildId> {
        self.children.iter().position(|child| child.spec.id == name).map(|i| ChildId(i as u16))
    }
    /// A child's specification; `None` when there is no such child.
    pub fn spec(&self, child: ChildId) -> Option<&ChildSpec> {
        self.children.get(usize::from(child.0)).map(|child| &child.spec)
    }
    /// Health of a child; `None` when there is no such child.
    pub fn health(&self, child: ChildId) -> Option<Health> {
        let child = self.children.get(usize::from(child.0))?;
        Some(match child.phase {
            Phase::Ended { failed: true } if child.held => Health::Held,
            Phase::Ended { failed: true } => Health::Failed,
            Phase::Ended { failed: false } => Health::Stopped,
            Phase::Waiting(_) | Phase::Starting(_) | Phase::Stopping { .. } if child.stalled => {
                Health::Stalled
            }
            Phase::Waiting(_) if child.incarnation > 0 => Health::Restarting,
            Phase::Starting(_) if child.incarnation > 1 => Health::Restarting,
            Phase::Waiting(_) | Phase::Starting(_) => Health::Starting,
            Phase::Stopping { again: true, .. } => Health::Restarting,
            Phase::Stopping { again: false, .. } => Health::Stopped,
            Phase::Running if child.held => Health::Held,
            Phase::Running if child.late => Health::Late,
            Phase::Running => Health::Healthy,
        })
    }
    /// Number of a child's current life, which is its epoch; 0 before the first.
    pub fn incarnation(&self, child: ChildId) -> u32 {
        self.children.get(usize::from(child.0)).map_or(0, |child| child.incarnation)
    }
    /// Number of restarts of a child.
    pub fn restarts(&self, child: ChildId) -> u32 {
        self.incarnation(child).saturating_sub(1)
    }
    /// Whether the watchdog must check this child's heartbeat now.
    pub fn is_watched(&self, child: ChildId) -> bool {
        self.children
            .get(usize::from(child.0))
            .is_some_and(|child| child.phase == Phase::Running && !child.held)
    }
    /// Whether every child runs.
    pub fn is_up(&self) -> bool {
        self.stage == Stage::Up
            && self.children.iter().all(|c| matches!(c.phase, Phase::Running | Phase::Ended { .. }))
    }
    /// Exit code, once everything has ended.
    pub fn exit_code(&self) -> Option<i32> {
        match self.stage {
            Stage::Down(code) => Some(code),
            _ => None,
        }
    }
    /// Why the tree gave up, if it did.
    pub fn reason(&self) -> Option<&str> {
        self.reason.as_deref()
    }
    /// Names of the children held for failing too often, with the reason.
    pub fn given_up(&self) -> Vec<(String, String)> {
        let name = |child: ChildId| self.children[usize::from(child.0)].spec.id.clone();
        self.given_up.iter().map(|(child, why)| (name(*child), why.clone())).collect()
    }
    /// Threads that were abandoned and have not ended since.
    pub fn zombies(&self) -> u32 {
        self.zombies
    }
    /// The failures so far, in order (at most [`INCIDENTS_MAX`]).
    pub fn incidents(&self) -> &[Incident] {
        &self.incidents
    }
    /// Failures beyond [`INCIDENTS_MAX`].
    pub fn incidents_lost(&self) -> u64 {
        self.incidents_lost
    }
}
