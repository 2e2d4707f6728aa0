//! Selected inverse: its entries between some rows, from a sparse Cholesky factor. With the columns Z = L⁻¹ E of those
//! rows it is Zᵀ Z, which is symmetric; the non-zeros of a column of Z are its row's ancestors in the elimination tree.
//! No other entries are computed, and both parts are products of dense blocks.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::{Accum, Mat, Par};

/// Number of columns solved at once.
const GROUP: usize = 96;

/// Columns of Z for neighbouring rows, over the union of their supernodes.
struct Group {
    /// Range among the sorted rows.
    members: Range<usize>,
    /// The supernodes, ascending, each with its first row in `z`.
    reach: Vec<(usize, usize)>,
    z: Mat<f64>,
}

/// Visits the entries of A⁻¹ between distinct rows: the indices of row and column among `rows`, and the entry; each
/// pair in both orders. `progress` receives the completed fraction and may cancel by `false`; then the result is
/// `false`.
pub(super) fn inverse_between(
    factor: &SupernodalLltRef<'_, usize, f64>,
    rows: &[usize],
    mut visit: impl FnMut(usize, usize, f64),
    progress: &mut dyn FnMut(f64) -> bool,
) -> bool {
    let count = factor.symbolic().n_supernodes();
    let mut supernode_of = Vec::new();
    for index in 0..count {
        let node = factor.supernode(index);
        supernode_of.extend(std::iter::repeat_n(index, node.val().ncols()));
    }
    let mut sorted: Vec<usize> = (0..rows.len()).collect();
    sorted.sort_unstable_by_key(|&index| rows[index]);
    let mut groups: Vec<Group> = Vec::new();
    let mut marked = vec![false; count];
    let mut offset = vec![0; count];
    for start in (0..sorted.len()).step_by(GROUP) {
        let members = start..(start + GROUP).min(sorted.len());
        let own: Vec<usize> = sorted[members.clone()].iter().map(|&index| rows[index]).collect();
        let (reach, z) = solve_group(factor, &own, &supernode_of, &mut marked, &mut offset);
        groups.push(Group { members, reach, z });
        if !progress(0.5 * groups.len() as f64 * GROUP as f64 / (rows.len() + GROUP) as f64) {
            return false;
        }
    }
    let mut product = Mat::<f64>::zeros(GROUP, GROUP);
    for (done, one) in groups.iter().enumerate() {
        for other in &groups[..=done] {
            let (height, width) = (one.members.len(), other.members.len());
            let mut block = product.as_mut().submatrix_mut(0, 0, height, width);
            block.fill(0.0);
            for (mine, theirs, size) in common(one, other) {
                matmul(
                    block.as_mut(),
                    Accum::Add,
                    one.z.as_ref().subrows(mine, size).transpose(),
                    other.z.as_ref().subrows(theirs, size),
                    1.0,
                    Par::Seq,
                );
            }
            for (c, column) in other.members.clone().enumerate() {
                for (r, row) in one.members.clone().enumerate() {
                    visit(sorted[row], sorted[column], block[(r, c)]);
                    visit(sorted[column], sorted[row], block[(r, c)]);
                }
            }
        }
        // Later groups have more partners.
        if !progress(0.5 + 0.5 * ((done + 1) as f64 / groups.len() as f64).powi(2)) {
            return false;
        }
    }
    true
}

/// Z for some rows, ascending, and its supernodes.
fn solve_group(
    factor: &SupernodalLltRef<'_, usize, f64>,
    rows: &[usize],
    supernode_of: &[usize],
    marked: &mut [bool],
    offset: &mut [usize],
) -> (Vec<(usize, usize)>, Mat<f64>) {
    let mut reached = Vec::new();
    for &row in rows {
        let mut at = Some(supernode_of[row]);
        while let Some(index) = at.filter(|&index| !marked[index]) {
            marked[index] = true;
            reached.push(index);
            at = factor.supernode(index).pattern().first().map(|&parent| supernode_of[parent]);
        }
    }
    reached.sort_unstable();
    let mut height = 0;
    let mut reach = Vec::with_capacity(reached.len());
    for index in reached {
        marked[index] = false;
        offset[index] = height;
        reach.push((index, height));
        height += factor.supernode(index).val().ncols();
    }
    let place = |row: usize| {
        let index = supernode_of[row];
        offset[index] + row - factor.supernode(index).start()
    };
    let mut z = Mat::<f64>::zeros(height, rows.len());
    for (column, &row) in rows.iter().enumerate() {
        z[(place(row), column)] = 1.0;
    }
    let mut below = Mat::<f64>::zeros(0, 0);
    let mut to = Vec::new();
    for &(index, first) in &reach {
        let node = factor.supernode(index);
        let (values, pattern) = (node.val(), node.pattern());
        let size = values.ncols();
        let (upper, lower) = values.split_at_row(size);
        let mut own = z.as_mut().subrows_mut(first, size);
        solve_lower_triangular_in_place(upper, own.as_mut(), Par::Seq);
        below.resize_with(pattern.len(), rows.len(), |_, _| 0.0);
        matmul(below.as_mut(), Accum::Replace, lower, own.as_ref(), 1.0, Par::Seq);
        to.clear();
        to.extend(pattern.iter().map(|&row| place(row)));
        for column in 0..rows.len() {
            let from = below.col(column);
            let mut into = z.col_mut(column);
            for (k, &row) in to.iter().enumerate() {
                into[row] -= from[k];
            }
        }
    }
    (reach, z)
}

/// Common rows of two groups: their starts in each, and their number.
fn common(one: &Group, other: &Group) -> Vec<(usize, usize, usize)> {
    let end = |group: &Group, at: usize| group.reach.get(at + 1).map_or(group.z.nrows(), |next| next.1);
    let mut runs: Vec<(usize, usize, usize)> = Vec::new();
    let (mut i, mut j) = (0, 0);
    while i < one.reach.len() && j < other.reach.len() {
        let ((a, mine), (b, theirs)) = (one.reach[i], other.reach[j]);
        if a == b {
            let size = end(one, i) - mine;
            match runs.last_mut() {
                Some((m, t, length)) if *m + *length == mine && *t + *length == theirs => *length += size,
                _ => runs.push((mine, theirs, size)),
            }
        }
        i += usize::from(a <= b);
        j += usize::from(b <= a);
    }
    runs
}
