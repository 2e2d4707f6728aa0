//! Sections of Gmsh's formats 2.0 to 2.2: nodes and elements one after the other, tags at each element.

use super::{Encoding, Reading, element_kind};
use crate::mesh::cursor::Cursor;
use crate::mesh::error::MeshError;

/// Largest number of tags of an element: physical, elementary, and the partitions it belongs to.
const TAGS_MAX: i64 = 1024;

pub(super) fn nodes(cursor: &mut Cursor, encoding: Encoding, reading: &mut Reading) -> Result<(), MeshError> {
    let place = cursor.line();
    let declared: u64 = cursor.parse("the number of nodes")?;
    // The shortest line is "1 0 0 0\n"; in binary an int and three doubles.
    let least = if encoding == Encoding::Ascii { 8 } else { 28 };
    let count = cursor.count(place, "nodes", declared, least, cursor.limits.vertices)?;
    reading.reserve_nodes(count);
    if let Encoding::Binary(_) = encoding {
        cursor.next_line();
    }
    for index in 0..count {
        let (place, tag, point) = match encoding {
            Encoding::Ascii => {
                let tag = cursor.parse("a node number")?;
                (cursor.line(), tag, cursor.parse_point("node", index)?)
            }
            Encoding::Binary(order) => {
                let place = cursor.byte();
                let tag = cursor.u32(order, "a node number")?.into();
                (place, tag, cursor.point(order, "node", index)?)
            }
        };
        reading.add_node(cursor, place, tag, point)?;
    }
    Ok(())
}

pub(super) fn elements(
    cursor: &mut Cursor,
    encoding: Encoding,
    reading: &mut Reading,
) -> Result<(), MeshError> {
    let place = cursor.line();
    let declared: u64 = cursor.parse("the number of elements")?;
    // The shortest element is a point: "1 15 0 1\n"; in binary its number and its node.
    let least = if encoding == Encoding::Ascii { 9 } else { 8 };
    let count = cursor.count(place, "elements", declared, least, cursor.limits.elements)?;
    match encoding {
        Encoding::Ascii => (0..count).try_for_each(|_| ascii_element(cursor, reading)),
        Encoding::Binary(_) => {
            cursor.next_line();
            let mut left = count;
            while left > 0 {
                left -= binary_block(cursor, encoding, reading, left)?;
            }
            Ok(())
        }
    }
}

fn ascii_element(cursor: &mut Cursor, reading: &mut Reading) -> Result<(), MeshError> {
    let number = cursor.parse("an element number")?;
    let place = cursor.line();
    let kind = element_kind(cursor, place, cursor.clone().parse("an element type")?)?;
    cursor.token();
    let tags = tag_count(cursor, cursor.clone().parse("the number of tags")?)?;
    cursor.token();
    let mut physical = 0;
    for k in 0..tags {
        let tag = cursor.parse("a tag")?;
        if k == 0 {
            physical = tag;
        }
    }
    reading.add_element(cursor, place, (number, kind, physical), |cursor| cursor.parse("a node number"))
}

/// Elements of one type; returns how many, at least one and at most `left`.
fn binary_block(
    cursor: &mut Cursor,
    encoding: Encoding,
    reading: &mut Reading,
    left: usize,
) -> Result<usize, MeshError> {
    let Encoding::Binary(order) = encoding else { return Ok(left) };
    let place = cursor.byte();
    let kind = cursor.i32(order, "an element type")?;
    let follow = cursor.u32(order, "the number of elements")? as usize;
    let tags = cursor.i32(order, "the number of tags")?;
    let tags = tag_count(cursor, tags.into())?;
    if follow == 0 || follow > left {
        let reason = format!("a block of {follow} elements where 1 to {left} are expected");
        return Err(cursor.malformed(place, reason));
    }
    let kind = element_kind(cursor, place, kind.into())?;
    for _ in 0..follow {
        let place = cursor.byte();
        let number = cursor.u32(order, "an element number")?.into();
        let mut physical = 0;
        for k in 0..tags {
            let tag = cursor.i32(order, "a tag")?;
            if k == 0 {
                physical = tag;
            }
        }
        let node = |cursor: &mut Cursor| cursor.u32(order, "a node number").map(u64::from);
        reading.add_element(cursor, place, (number, kind, physical), node)?;
    }
    Ok(follow)
}

fn tag_count(cursor: &Cursor, count: i64) -> Result<usize, MeshError> {
    if (0..=TAGS_MAX).contains(&count) {
        return Ok(count as usize);
    }
    Err(cursor
        .malformed(cursor.line(), format!("an element with {count} tags (0 to {TAGS_MAX} are possible)")))
}
