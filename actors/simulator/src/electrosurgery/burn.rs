//! What heat did to the elements of the mesh: how much of each is coagulated, charred, gone. A mechanical solver takes
//! factors of stiffness and shrinkage from here, and the elements to take away.

use super::error::ElectrosurgeryError;
use super::thermal_grid::EDGE;
use super::tissue::Tissue;

/// An element goes when this share of its volume is gone.
const GONE: f64 = 0.5;
/// Elements of less than so many cells are told by the cell in which their middle lies.
const SMALL: f64 = 4.0;

/// Burns by element.
#[derive(Clone, Debug)]
pub(super) struct ElementBurns {
    volume: Vec<f64>,
    pub removed: Vec<f64>,
    pub coagulated: Vec<f64>,
    pub charred: Vec<f64>,
    pub is_removed: Vec<bool>,
    /// Of small elements: the cell of the middle, sorted.
    middles: Vec<([i32; 3], u32)>,
    is_small: Vec<bool>,
    /// Removed since the step began.
    pub gone: Vec<u32>,
    /// All that were removed, in their order.
    pub order: Vec<u32>,
}

/// The number of a cell in the lattice.
pub(super) fn cell_number(block: [i32; 3], cell: usize) -> [i32; 3] {
    let within = super::block::xyz(cell);
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
            is_removed: vec![false; count],
            middles,
            is_small,
            gone: Vec::new(),
            order: Vec::new(),
        })
    }

    /// Books what happened to a cell of that volume \[m³\], of which `element` has the most.
    pub(super) fn book(&mut self, number: [i32; 3], element: u32, volume: f64, event: CellEvent) {
        let element = element as usize;
        if !self.is_small[element] {
            self.add(element, volume, event);
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
                if self.removed[element] >= GONE * self.volume[element] && !self.is_removed[element] {
                    self.is_removed[element] = true;
                    self.gone.push(element as u32);
                    self.order.push(element as u32);
                }
            }
        }
    }

    /// Shares of an element's remaining volume that are coagulated and charred.
    pub(super) fn shares(&self, element: usize) -> (f64, f64) {
        let left = (self.volume[element] - self.removed[element]).max(self.volume[element] * 1e-3);
        let share = |part: f64| (part / left).clamp(0.0, 1.0);
        (share(self.coagulated[element]), share(self.charred[element]))
    }
}
