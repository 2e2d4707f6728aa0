//! A sewn thread that is cut, or breaks, outside of the tissue: what is left in the tissue is held there as before, by friction
//! alone, and slides out when it is drawn; the needle keeps what is swaged to it.

use super::state::SutureState;
use super::{Suture, SutureError, tissue_surface};
use crate::suture_thread::{CutAt, Parted, ThreadState};

impl Suture {
    /// Cuts the thread. `None` where it is in the tissue or at a hole, is cut already, or less than two diameters would be left
    /// on a side.
    ///
    /// # Errors
    /// It would have more nodes than a thread may have. It is then what it was.
    pub fn cut_thread(&mut self, at: CutAt) -> Result<Option<Parted>, SutureError> {
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

/// What channels and contacts know of the thread, after it was cut: where along it what is in them is now.
fn renumber(state: &mut SutureState, before: &[(usize, [f64; 2])], parted: &Parted) {
    let SutureState { thread: Some(thread), channel, strand_contacts, .. } = state else { return };
    let begins = begins(thread);
    for point in channel.iter_mut().filter(|point| point.along < 0.0) {
        let at = before.partition_point(|(_, [begin, _])| *begin <= -point.along).saturating_sub(1);
        let Some((edge, [begin, _])) = before.get(at) else { continue };
        // Edges in the tissue are whole.
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

/// Where each edge begins, of those that join something.
fn begins(thread: &ThreadState) -> Vec<Option<f64>> {
    let mut begins = vec![None; thread.rest_lengths.len()];
    thread.spans().for_each(|(edge, [begin, _])| begins[edge] = Some(begin));
    begins
}
