//! Sections of Gmsh's formats 4.0 and 4.1: blocks of nodes and elements by model entity; physical groups at the entities.

use std::collections::HashMap;

use super::{Encoding, Reading, Version, element_kind};
use crate::mesh::cursor::{Cursor, LazyPosition};
use crate::mesh::error::MeshError;

/// First physical group of each volume, by the volume's number. Looked up only.
pub(super) type PhysicalGroups = HashMap<i32, i32>;

/// Numbers of either encoding: counts and node numbers are `size_t`, entity numbers and types are `int`.
struct Numbers<'c, 'a> {
    cursor: &'c mut Cursor<'a>,
    encoding: Encoding,
}

impl Numbers<'_, '_> {
    fn here(&self) -> LazyPosition {
        match self.encoding {
            Encoding::Ascii => self.cursor.line(),
            Encoding::Binary(_) => self.cursor.byte(),
        }
    }
    fn size(&mut self, what: &str) -> Result<u64, MeshError> {
        match self.encoding {
            Encoding::Ascii => self.cursor.parse(what),
            Encoding::Binary(order) => self.cursor.u64(order, what),
        }
    }
    fn int(&mut self, what: &str) -> Result<i32, MeshError> {
        match self.encoding {
            Encoding::Ascii => self.cursor.parse(what),
            Encoding::Binary(order) => self.cursor.i32(order, what),
        }
    }
    fn double(&mut self, what: &str) -> Result<f64, MeshError> {
        match self.encoding {
            Encoding::Ascii => self.cursor.parse(what),
            Encoding::Binary(order) => self.cursor.f64(order, what),
        }
    }
    fn point(&mut self, index: usize) -> Result<[f64; 3], MeshError> {
        match self.encoding {
            Encoding::Ascii => self.cursor.parse_point("node", index),
            Encoding::Binary(order) => self.cursor.point(order, "node", index),
        }
    }
    /// Number and dimension of a model entity, which versions 4.0 and 4.1 write in opposite orders.
    fn entity(&mut self, version: Version) -> Result<(i32, i32), MeshError> {
        let first = self.int("the number or dimension of an entity")?;
        let second = self.int("the number or dimension of an entity")?;
        Ok(if version == Version::V41 { (second, first) } else { (first, second) })
    }
    /// A declared count, against what is left of the file at `ascii` or `binary` bytes each.
    fn count(&mut self, what: &'static str, ascii: u64, binary: u64, limit: u64) -> Result<usize, MeshError> {
        let place = self.here();
        let declared = self.size(what)?;
        let least = if self.encoding == Encoding::Ascii { ascii } else { binary };
        self.cursor.count(place, what, declared, least, limit)
    }
}

pub(super) fn entities(
    cursor: &mut Cursor,
    version: Version,
    encoding: Encoding,
) -> Result<PhysicalGroups, MeshError> {
    let limit = cursor.limits.elements;
    let mut numbers = Numbers { cursor, encoding };
    let mut counts = [0; 4];
    for (count, what) in counts.iter_mut().zip(["points", "curves", "surfaces", "volumes"]) {
        *count = numbers.count(what, 2, 36, limit)?;
    }
    let mut groups = PhysicalGroups::new();
    for (dimension, &count) in counts.iter().enumerate() {
        for _ in 0..count {
            let tag = numbers.int("an entity number")?;
            for _ in 0..if dimension == 0 && version == Version::V41 { 3 } else { 6 } {
                // Bounding boxes of empty entities hold ±1e22 or infinities; nothing depends on them.
                numbers.double("a bound")?;
            }
            let physical = numbers.count("physical groups", 2, 4, limit)?;
            for k in 0..physical {
                let group = numbers.int("a physical group")?;
                if dimension == 3 && k == 0 {
                    groups.insert(tag, group);
                }
            }
            if dimension > 0 {
                for _ in 0..numbers.count("bounding entities", 2, 4, limit)? {
                    numbers.int("a bounding entity")?;
                }
            }
        }
    }
    Ok(groups)
}

pub(super) fn nodes(
    cursor: &mut Cursor,
    version: Version,
    encoding: Encoding,
    reading: &mut Reading,
) -> Result<(), MeshError> {
    let limits = *cursor.limits;
    let mut numbers = Numbers { cursor, encoding };
    let blocks = numbers.count("blocks of nodes", 8, 20, limits.elements)?;
    let total = numbers.count("nodes", 8, 32, limits.vertices)?;
    if version == Version::V41 {
        numbers.size("the smallest node number")?;
        numbers.size("the largest node number")?;
    }
    reading.reserve_nodes(total);
    let mut tags = Vec::new();
    for _ in 0..blocks {
        let place = numbers.here();
        let (_, dimension) = numbers.entity(version)?;
        let dimension = match dimension {
            0..=3 => dimension as usize,
            _ => return Err(numbers.cursor.malformed(place, format!("an entity of dimension {dimension}"))),
        };
        let parametric = numbers.int("whether nodes are parametric")? != 0;
        let left = total - reading.grid.positions.len();
        let count = numbers.count("nodes in a block", 8, 32, limits.vertices)?;
        if count > left {
            let reason = format!("a block of {count} nodes where {left} are left of the declared {total}");
            return Err(numbers.cursor.malformed(place, reason));
        }
        tags.clear();
        // In version 4.0 the number of a node stands before its coordinates.
        for _ in 0..if version == Version::V41 { count } else { 0 } {
            tags.push(numbers.size("a node number")?);
        }
        for k in 0..count {
            let place = numbers.here();
            let tag = match tags.get(k) {
                Some(&tag) => tag,
                None => numbers.size("a node number")?,
            };
            let point = numbers.point(reading.grid.positions.len())?;
            if parametric {
                for _ in 0..dimension {
                    numbers.double("a parametric coordinate")?;
                }
            }
            reading.add_node(numbers.cursor, place, tag, point)?;
        }
    }
    let read = reading.grid.positions.len();
    if read < total {
        let reason = format!("{total} nodes are declared, but the blocks hold {read}");
        return Err(numbers.cursor.malformed(numbers.here(), reason));
    }
    Ok(())
}

pub(super) fn elements(
    cursor: &mut Cursor,
    version: Version,
    encoding: Encoding,
    reading: &mut Reading,
    physical: &PhysicalGroups,
) -> Result<(), MeshError> {
    let limit = cursor.limits.elements;
    let mut numbers = Numbers { cursor, encoding };
    let blocks = numbers.count("blocks of elements", 8, 20, limit)?;
    let total = numbers.count("elements", 4, 16, limit)?;
    if version == Version::V41 {
        numbers.size("the smallest element number")?;
        numbers.size("the largest element number")?;
    }
    let mut left = total;
    for _ in 0..blocks {
        let place = numbers.here();
        let (entity, _) = numbers.entity(version)?;
        let kind = numbers.int("an element type")?;
        let count = numbers.count("elements in a block", 4, 16, limit)?;
        if count > left {
            let reason = format!("a block of {count} elements where {left} are left of the declared {total}");
            return Err(numbers.cursor.malformed(place, reason));
        }
        left -= count;
        let kind = element_kind(numbers.cursor, place, kind.into())?;
        let tag = physical.get(&entity).copied().unwrap_or(0);
        for _ in 0..count {
            let place = numbers.here();
            let number = numbers.size("an element number")?;
            let node = |cursor: &mut Cursor| match encoding {
                Encoding::Ascii => cursor.parse("a node number"),
                Encoding::Binary(order) => cursor.u64(order, "a node number"),
            };
            reading.add_element(numbers.cursor, place, (number, kind, tag), node)?;
        }
    }
    if left > 0 {
        let reason = format!("{total} elements are declared, but the blocks hold {}", total - left);
        return Err(numbers.cursor.malformed(numbers.here(), reason));
    }
    Ok(())
}
