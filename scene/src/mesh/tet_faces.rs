//! Faces of tetrahedra: shared faces and boundary faces.

/// Corners of the face opposite to each corner, counter-clockwise seen from outside a positive element.
pub const OPPOSITE: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// A face of an element: its corners in ascending order, and in their own order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Face {
    /// Its corners, ascending.
    pub sorted: [u32; 3],
    /// The element.
    pub tet: u32,
    /// Its corners, counter-clockwise seen from outside a positive element.
    pub corners: [u32; 3],
}

impl Face {
    /// Whether the corners run in the sense of the ascending order.
    #[must_use]
    pub fn ascending(&self) -> bool {
        let [a, b, c] = self.corners;
        let smallest = a.min(b).min(c);
        if a == smallest {
            b < c
        } else if b == smallest {
            c < a
        } else {
            a < b
        }
    }
}

/// All faces of all elements, those with the same corners next to each other.
#[must_use]
pub fn faces(tets: &[[u32; 4]]) -> Vec<Face> {
    let mut faces = Vec::with_capacity(4 * tets.len());
    for (tet, nodes) in tets.iter().enumerate() {
        for opposite in OPPOSITE {
            let corners = opposite.map(|corner| nodes[corner]);
            let mut sorted = corners;
            sorted.sort_unstable();
            faces.push(Face { sorted, tet: tet as u32, corners });
        }
    }
    faces.sort_unstable();
    faces
}

/// Faces of one element only, in the order of the elements.
#[must_use]
pub fn surface(tets: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let faces = faces(tets);
    let mut alone: Vec<Face> = faces
        .chunk_by(|one, other| one.sorted == other.sorted)
        .filter(|same| same.len() == 1)
        .map(|same| same[0])
        .collect();
    alone.sort_unstable_by_key(|face| (face.tet, face.sorted));
    alone.into_iter().map(|face| face.corners).collect()
}
