//! Cutting or breaking a sutured thread outside of the tissue: the part inside is still held by friction alone, and
//! slides out when pulled; the needle keeps the part swaged to it.

use super::state::SutureState;
use super::{Suture, SutureError, tissue_surface};
use crate::suture_thread::{CutAt, CutNumbering, ThreadState};

impl Suture {
    /// Cuts the thread. `None` where it is in the tissue or at a hole, is already cut, or a piece would be shorter than
    /// two diameters.
    ///
    /// # Errors
    /// The number of nodes would exceed the limit. The thread is then unchanged.
    pub fn cut_thread(&mut self, at: CutAt) -> Result<Option<CutNumbering>, SutureError> {
        let (length, radius) = (self.solid.shape().length(), self.thread_radius());
        if tissue_surface::is_in_tissue(&self.state, length, &self.resistance, at.edge) {
            return Ok(None);
        }
        let Some(thread) = &mut self.state.thread else { return Ok(None) };
        let before: Vec<_> = thread.spans().collect();
        let Some(parted) = thread.cut(radius, at)? else { return Ok(None) };
        renumber(&mut self.state, &before, &parted);
        Ok(Some(parted))
    }
}

/// Renumbers channels and contacts after a cut: the new arc lengths of their points on the thread.
fn renumber(state: &mut SutureState, before: &[(usize, [f64; 2])], parted: &CutNumbering) {
    let SutureState { thread: Some(thread), channel, strand_contacts, .. } = state else { return };
    let begins = begins(thread);
    for point in channel.iter_mut().filter(|point| point.along < 0.0) {
        let at = before.partition_point(|(_, [begin, _])| *begin <= -point.along).saturating_sub(1);
        let Some((edge, [begin, _])) = before.get(at) else { continue };
        // Edges in the tissue are never divided.
        let Some(now) = parted.edges[*edge].and_then(|now| begins[now as usize]) else { continue };
        let by = begin - now;
        point.along += by;
        point.stuck += by;
    }
    strand_contacts.retain_mut(|contact| {
        let now = parted.edges.get(contact.edge as usize).copied().flatten();
        contact.edge = now.unwrap_or(contact.edge);
        now.is_some()
    });
}

/// Where each real edge begins.
fn begins(thread: &ThreadState) -> Vec<Option<f64>> {
    let mut begins = vec![None; thread.rest_lengths.len()];
    thread.spans().for_each(|(edge, [begin, _])| begins[edge] = Some(begin));
    begins
}
