//! Part of a body in a contact.

/// A part of a surface or of a line, by its index in the given slices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Part {
    /// A vertex.
    Vertex(u32),
    /// An edge of a surface: its two vertices, the smaller one first.
    Edge([u32; 2]),
    /// A segment of a line.
    Segment(u32),
    /// A triangle of a surface.
    Triangle(u32),
}
