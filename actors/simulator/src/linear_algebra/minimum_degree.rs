//! Minimum-degree ordering.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

/// A fill-reducing ordering of a graph given by its edges (approximate minimum degree: Amestoy, Davis, Duff 1996): the
/// nodes in elimination order. The identity where there is not enough memory.
#[must_use]
pub fn minimum_degree(nodes: usize, edges: impl Iterator<Item = (u32, u32)>) -> Vec<u32> {
    let natural = || (0..nodes as u32).collect();
    let mut both: Vec<(u32, u32)> =
        edges.filter(|(a, b)| a != b).flat_map(|(a, b)| [(a, b), (b, a)]).collect();
    both.sort_unstable();
    both.dedup();
    let mut starts = vec![0_usize; nodes + 1];
    for &(column, _) in &both {
        starts[column as usize + 1] += 1;
    }
    for column in 0..nodes {
        starts[column + 1] += starts[column];
    }
    let rows: Vec<usize> = both.iter().map(|&(_, row)| row as usize).collect();
    let graph = SymbolicSparseColMatRef::new_checked(nodes, nodes, &starts, None, &rows);
    let (mut order, mut inverse) = (vec![0_usize; nodes], vec![0_usize; nodes]);
    let Ok(mut memory) = MemBuffer::try_new(amd::order_maybe_unsorted_scratch::<usize>(nodes, rows.len()))
    else {
        return natural();
    };
    let stack = MemStack::new(&mut memory);
    match amd::order_maybe_unsorted(&mut order, &mut inverse, graph, amd::Control::default(), stack) {
        Ok(_) => order.into_iter().map(|node| node as u32).collect(),
        Err(_) => natural(),
    }
}
