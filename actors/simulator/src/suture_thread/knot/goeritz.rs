//! Signature and determinant of a knot from the checkerboard colouring of its diagram (Goeritz 1933; Gordon, Litherland
//! 1978).

use nalgebra::DMatrix;

use super::diagram::Diagram;

/// Signature (−2 for the right-handed trefoil) and determinant.
#[must_use]
pub fn signature_and_determinant(diagram: &Diagram) -> (i32, u64) {
    let crossings = diagram.crossings();
    if crossings == 0 {
        return (0, 1);
    }
    let (regions, places) = (diagram.regions(), diagram.places());
    // The regions to the left and to the right of an arc traversed forwards.
    let mut beside = vec![[0_usize; 2]; 2 * crossings];
    for (region, sides) in regions.iter().enumerate() {
        for &(arc, forwards) in sides {
            beside[arc][usize::from(!forwards)] = region;
        }
    }
    let white = colours(&beside, regions.len());
    let mut matrix = DMatrix::<f64>::zeros(regions.len(), regions.len());
    let mut correction = 0;
    for crossing in 0..crossings {
        let around = diagram.around(crossing, &places);
        // The regions counter-clockwise after each of the four arcs: to the left of an incoming arc lies the one
        // clockwise from it.
        let after = around.map(|(arc, leaves)| beside[arc][usize::from(!leaves)]);
        let positive = diagram.signs[crossing] > 0;
        // The regions swept by the upper strand turning counter-clockwise follow the second and the fourth arc.
        let swept_are_white = white[after[1]];
        let (first, second) = if swept_are_white { (after[1], after[3]) } else { (after[0], after[2]) };
        let kind = if swept_are_white { 1.0 } else { -1.0 };
        if first != second {
            matrix[(first, second)] -= kind;
            matrix[(second, first)] -= kind;
            matrix[(first, first)] += kind;
            matrix[(second, second)] += kind;
        }
        // Both strands run the same way along the black band.
        if positive != swept_are_white {
            correction += i32::from(diagram.signs[crossing]);
        }
    }
    let kept: Vec<_> = (0..regions.len()).filter(|&region| white[region]).skip(1).collect();
    if kept.is_empty() {
        return (-correction, 1);
    }
    let reduced = DMatrix::from_fn(kept.len(), kept.len(), |r, c| matrix[(kept[r], kept[c])]);
    let determinant = reduced.determinant().abs().round() as u64;
    let eigenvalues = reduced.symmetric_eigenvalues();
    let signature: i32 = eigenvalues.iter().map(|&value| if value > 0.0 { 1 } else { -1 }).sum();
    (-(signature + correction), determinant)
}

/// A two-colouring in which regions across an arc differ.
fn colours(beside: &[[usize; 2]], regions: usize) -> Vec<bool> {
    let mut colour = vec![None; regions];
    colour[beside[0][0]] = Some(true);
    loop {
        let mut changed = false;
        for &[left, right] in beside {
            for (from, to) in [(left, right), (right, left)] {
                if let (Some(of), None) = (colour[from], colour[to]) {
                    colour[to] = Some(!of);
                    changed = true;
                }
            }
        }
        if !changed {
            return colour.into_iter().map(|of| of.unwrap_or(false)).collect();
        }
    }
}
