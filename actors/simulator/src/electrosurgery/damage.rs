//! Thermal damage of the mesh's elements: coagulated, charred and removed fractions. A mechanical solver takes
//! stiffness and shrinkage factors from here, and the elements to remove.
//!
//! Elements are removed whole, lattice cells one by one. To remove the same volume from a solid's mesh as from the
//! lattice, however coarse the mesh, the difference is carried over: an element that is due but not completely gone
//! waits while more of the mesh was removed than of the lattice; where a whole element's volume is owed and none is
//! due, the one with the largest lost fraction is removed.

use super::error::ElectrosurgeryError;
use super::voxelisation::{CellLocation, EDGE, Tissue};

/// Removed fraction at which an element is due.
const GONE: f64 = 0.5;
/// Removed fraction at which a due element does not wait.
const NOTHING_LEFT: f64 = 0.9;
/// Elements smaller than this many cells are judged by the cell at their centre.
const SMALL: f64 = 4.0;

/// Damage by element.
#[derive(Clone, Debug)]
pub(super) struct ElementBurns {
    volume: Vec<f64>,
    pub removed: Vec<f64>,
    pub coagulated: Vec<f64>,
    pub charred: Vec<f64>,
    /// Volume of each element in removed cells \[m³\].
    pub touched: Vec<f64>,
    /// Volume removed from the lattice but not from the mesh \[m³\]; negative for the opposite.
    pub owed: f64,
    /// Elements to be removed next, in order.
    pub due: Vec<u32>,
    pub is_removed: Vec<bool>,
    /// Centre cells of small elements, sorted.
    middles: Vec<([i32; 3], u32)>,
    is_small: Vec<bool>,
    /// Whether the difference is carried over: not for a membrane, whose cut would be bridged by a waiting element.
    carries: bool,
    /// Elements removed in this step.
    pub gone: Vec<u32>,
    /// All removed elements, in order.
    pub order: Vec<u32>,
}

/// The number of a cell in the lattice.
pub(super) fn cell_number(block: [i32; 3], cell: usize) -> [i32; 3] {
    let within = super::lattice_block::xyz(cell);
    std::array::from_fn(|axis| block[axis] * EDGE as i32 + within[axis] as i32)
}

/// What happened to a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CellEvent {
    Removed { was_coagulated: bool, was_charred: bool },
    Coagulated,
    Charred,
}

impl ElementBurns {
    pub(super) fn new(tissue: &Tissue<'_>, spacing: f64) -> Result<Self, ElectrosurgeryError> {
        let count = tissue.element_count();
        let volume: Vec<f64> = (0..count).map(|element| tissue.volume(element)).collect();
        let is_small: Vec<bool> = volume.iter().map(|volume| *volume < SMALL * spacing.powi(3)).collect();
        let mut middles: Vec<([i32; 3], u32)> = (0..count)
            .filter(|element| is_small[*element])
            .map(|element| {
                let corners = tissue.corners(element);
                let sum = corners.iter().fold(nalgebra::Vector3::zeros(), |sum, vertex| {
                    sum + tissue.positions()[*vertex as usize].coords
                });
                let middle = sum / corners.len() as f64 / spacing;
                ([middle.x, middle.y, middle.z].map(|x| x.floor() as i32), element as u32)
            })
            .collect();
        middles.sort_unstable();
        Ok(Self {
            volume,
            removed: vec![0.0; count],
            coagulated: vec![0.0; count],
            charred: vec![0.0; count],
            touched: vec![0.0; count],
            owed: 0.0,
            due: Vec::new(),
            is_removed: vec![false; count],
            middles,
            is_small,
            carries: matches!(tissue, Tissue::Volume { .. }),
            gone: Vec::new(),
            order: Vec::new(),
        })
    }

    /// Records an event of a cell of this volume \[m³\], distributed over its elements.
    pub(super) fn book(&mut self, number: [i32; 3], site: &CellLocation, volume: f64, event: CellEvent) {
        if matches!(event, CellEvent::Removed { .. }) {
            self.owed += volume;
        }
        let others = f64::from(site.others) * volume;
        for (element, volume) in [(site.element, volume - others), (site.other, others)] {
            if volume == 0.0 {
                continue;
            }
            let element = element as usize;
            if matches!(event, CellEvent::Removed { .. }) {
                self.touched[element] += volume;
            }
            if !self.is_small[element] {
                self.add(element, volume, event);
            }
        }
        let from = self.middles.partition_point(|entry| entry.0 < number);
        let to = from + self.middles[from..].partition_point(|entry| entry.0 == number);
        for index in from..to {
            let small = self.middles[index].1 as usize;
            self.add(small, self.volume[small], event);
        }
    }

    fn add(&mut self, element: usize, volume: f64, event: CellEvent) {
        match event {
            CellEvent::Coagulated => self.coagulated[element] += volume,
            CellEvent::Charred => self.charred[element] += volume,
            CellEvent::Removed { was_coagulated, was_charred } => {
                self.removed[element] += volume;
                self.coagulated[element] -= if was_coagulated { volume } else { 0.0 };
                self.charred[element] -= if was_charred { volume } else { 0.0 };
                let is_due = self.removed[element] >= GONE * self.volume[element];
                if is_due && !self.is_removed[element] && !self.due.contains(&(element as u32)) {
                    self.due.push(element as u32);
                }
            }
        }
    }

    /// Removes elements until as much of the mesh as of the lattice is gone, to within one element. The largest lost
    /// fraction goes first: waiting elements are at the rim.
    pub(super) fn settle(&mut self) {
        loop {
            let lost = |element: usize| self.touched[element] / self.volume[element];
            let more = |a: usize, b: usize| lost(a).total_cmp(&lost(b)).then(b.cmp(&a));
            let due = (0..self.due.len()).max_by(|a, b| more(self.due[*a] as usize, self.due[*b] as usize));
            let element = if let Some(at) = due {
                let volume = self.volume[self.due[at] as usize];
                let waits = self.carries && self.owed <= -0.5 * volume;
                if waits && lost(self.due[at] as usize) < NOTHING_LEFT {
                    break;
                }
                self.due.remove(at)
            } else {
                let touched = (0..self.volume.len())
                    .filter(|element| self.touched[*element] > 0.0 && !self.is_removed[*element]);
                let most = touched.max_by(|a, b| more(*a, *b));
                let owed = |most: &usize| self.carries && self.volume[*most] <= self.owed;
                let Some(most) = most.filter(owed) else { break };
                most as u32
            };
            if !std::mem::replace(&mut self.is_removed[element as usize], true) {
                self.owed -= self.volume[element as usize];
                self.gone.push(element);
                self.order.push(element);
            }
        }
    }

    /// Coagulated and charred fractions of an element's remaining volume.
    pub(super) fn shares(&self, element: usize) -> (f64, f64) {
        let left = (self.volume[element] - self.removed[element]).max(self.volume[element] * 1e-3);
        let share = |part: f64| (part / left).clamp(0.0, 1.0);
        (share(self.coagulated[element]), share(self.charred[element]))
    }
}
