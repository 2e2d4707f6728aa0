//! VTK's XML files of unstructured grids (`.vtu`) and poly data (`.vtp`), serial ("VTK File Formats", Kitware: XML file
//! formats): arrays as text, as base64 or appended (raw or base64), of either byte order, compressed by zlib or not.

use std::ops::Range;

use miniz_oxide::inflate::decompress_to_vec_zlib_with_limit;
use nalgebra::Point3;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::{CellList, WHOLE, add_cells, region_rank};
use crate::mesh::base64::Base64;
use crate::mesh::cells::Grid;
use crate::mesh::cursor::{Cursor, LazyPosition, Order, quoted};
use crate::mesh::error::MeshError;
use crate::mesh::number_kind::NumberKind;

/// Deepest nesting of elements.
const DEPTH_MAX: usize = 32;
/// Bytes that all compressed arrays may become, per byte of the file.
const RATIO_MAX: u64 = 100;
/// Bytes that they may become whatever the length of the file.
const INFLATED_ALWAYS: u64 = 64 << 10;
/// Sections of cells in poly data, with VTK's type of a cell of theirs, in the order of the cell data.
const POLY_SECTIONS: [(&str, i64); 4] = [("verts", 2), ("lines", 4), ("strips", 6), ("polys", 7)];

/// How an array is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Ascii,
    Binary,
    Appended,
}

/// An array: its declaration, and its text in the file.
struct Array {
    name: String,
    kind: NumberKind,
    components: u64,
    format: Format,
    offset: u64,
    text: Range<usize>,
    place: LazyPosition,
}

/// The arrays of one piece that are needed.
#[derive(Default)]
struct Piece {
    points: Option<Array>,
    /// Arrays of the cells by their section and name.
    cells: Vec<(String, Array)>,
    regions: Option<(usize, Array)>,
}

/// What stands behind `_` in an `AppendedData` element.
struct Appended {
    begin: usize,
    base64: bool,
}

/// A file as it is written.
struct Document<'a> {
    cursor: Cursor<'a>,
    is_poly: bool,
    order: Order,
    wide_headers: bool,
    compressed: bool,
    pieces: Vec<Piece>,
    appended: Option<Appended>,
    /// Bytes that compressed arrays may still become.
    budget: u64,
}

/// Reads a file from its first character.
pub(super) fn read(cursor: Cursor) -> Result<(Grid, Cursor), MeshError> {
    let mut document = Document::parse(cursor)?;
    let mut grid = Grid { word: "cell", ..Grid::default() };
    for piece in std::mem::take(&mut document.pieces) {
        document.add_piece(&piece, &mut grid)?;
    }
    Ok((grid, document.cursor))
}

fn attribute(element: &BytesStart, name: &str) -> Option<String> {
    let found =
        element.attributes().flatten().find(|a| a.key.as_ref().eq_ignore_ascii_case(name.as_bytes()))?;
    Some(String::from_utf8_lossy(&found.value).trim().to_owned())
}

impl<'a> Document<'a> {
    /// Finds the arrays.
    fn parse(cursor: Cursor<'a>) -> Result<Self, MeshError> {
        let base = cursor.position();
        let text = cursor.remaining();
        let mut reader = Reader::from_reader(text);
        let budget = (text.len() as u64).saturating_mul(RATIO_MAX).saturating_add(INFLATED_ALWAYS);
        let mut document = Document {
            cursor,
            is_poly: false,
            order: Order::Little,
            wide_headers: false,
            compressed: false,
            pieces: Vec::new(),
            appended: None,
            budget,
        };
        let mut path: Vec<String> = Vec::new();
        loop {
            let at = base + reader.buffer_position() as usize;
            let event = reader.read_event().map_err(|why| {
                document.cursor.malformed(LazyPosition::LineOfByte(at), format!("not an XML file: {why}"))
            })?;
            let end = reader.buffer_position() as usize;
            match event {
                Event::Start(element) => {
                    let name = String::from_utf8_lossy(element.name().as_ref()).to_ascii_lowercase();
                    if path.len() == DEPTH_MAX {
                        let reason = format!("elements are nested more than {DEPTH_MAX} deep");
                        return Err(document.cursor.malformed(LazyPosition::LineOfByte(at), reason));
                    }
                    if name == "appendeddata" {
                        document.appended(&element, base + end, at)?;
                        break;
                    }
                    let length = text[end..].iter().position(|&b| b == b'<').unwrap_or(text.len() - end);
                    let inner = base + end..base + end + length;
                    document.element(&element, &name, &path, inner, LazyPosition::LineOfByte(at))?;
                    path.push(name);
                }
                Event::Empty(element) => {
                    let name = String::from_utf8_lossy(element.name().as_ref()).to_ascii_lowercase();
                    let inner = base + end..base + end;
                    document.element(&element, &name, &path, inner, LazyPosition::LineOfByte(at))?;
                }
                Event::End(_) => {
                    path.pop();
                }
                Event::Eof if path.is_empty() => break,
                Event::Eof => {
                    let reason = format!("the file ends within the element '{}'", path[path.len() - 1]);
                    return Err(document.cursor.malformed(LazyPosition::LineOfByte(at), reason));
                }
                _ => {}
            }
        }
        if document.pieces.is_empty() {
            return Err(document.cursor.malformed(WHOLE, "there is no VTKFile with a Piece in the file"));
        }
        Ok(document)
    }

    fn element(
        &mut self,
        element: &BytesStart,
        name: &str,
        path: &[String],
        text: Range<usize>,
        place: LazyPosition,
    ) -> Result<(), MeshError> {
        match name {
            "vtkfile" => self.file(element, place),
            "piece" => {
                self.pieces.push(Piece::default());
                Ok(())
            }
            "dataarray" => self.array(element, path.last().map_or("", String::as_str), text, place),
            _ => Ok(()),
        }
    }

    fn file(&mut self, element: &BytesStart, place: LazyPosition) -> Result<(), MeshError> {
        let value = |name: &str| attribute(element, name);
        let kind = value("type").unwrap_or_default();
        self.is_poly = match kind.to_ascii_lowercase().as_str() {
            "unstructuredgrid" => false,
            "polydata" => true,
            _ => {
                let what = format!("a VTKFile of type {}", quoted(kind.as_bytes()));
                let supported = "UnstructuredGrid and PolyData; of a parallel file give one of its pieces";
                return Err(self.cursor.unsupported(place, what, supported));
            }
        };
        if value("byte_order").is_some_and(|order| order.eq_ignore_ascii_case("BigEndian")) {
            self.order = Order::Big;
        }
        self.wide_headers = value("header_type").is_some_and(|kind| kind.eq_ignore_ascii_case("UInt64"));
        if let Some(compressor) = value("compressor").filter(|name| !name.is_empty()) {
            if !compressor.eq_ignore_ascii_case("vtkZLibDataCompressor") {
                let what = format!("compressor {}", quoted(compressor.as_bytes()));
                return Err(self.cursor.unsupported(place, what, "vtkZLibDataCompressor, or none"));
            }
            self.compressed = true;
        }
        Ok(())
    }

    fn array(
        &mut self,
        element: &BytesStart,
        section: &str,
        text: Range<usize>,
        place: LazyPosition,
    ) -> Result<(), MeshError> {
        let Some(piece) = self.pieces.last_mut() else { return Ok(()) };
        let name = attribute(element, "Name").unwrap_or_default().to_ascii_lowercase();
        let is_poly = POLY_SECTIONS.iter().any(|(poly, _)| *poly == section);
        let rank = region_rank(&name).filter(|_| section == "celldata");
        if !matches!(section, "points" | "cells") && !is_poly && rank.is_none() {
            return Ok(());
        }
        let kind = attribute(element, "type").unwrap_or_default();
        let kind = NumberKind::parse(&self.cursor, place, &kind)?;
        let format = match attribute(element, "format").unwrap_or_default().to_ascii_lowercase().as_str() {
            "" | "ascii" => Format::Ascii,
            "binary" => Format::Binary,
            "appended" => Format::Appended,
            other => {
                let what = format!("format {}", quoted(other.as_bytes()));
                return Err(self.cursor.unsupported(place, what, "ascii, binary, appended"));
            }
        };
        let number = |name: &str, default: u64| match attribute(element, name) {
            None => Ok(default),
            Some(text) => text.parse().map_err(|_| {
                self.cursor.malformed(place, format!("{name} {} is no number", quoted(text.as_bytes())))
            }),
        };
        let components = number("NumberOfComponents", if section == "points" { 3 } else { 1 })?;
        let offset = number("offset", 0)?;
        let array = Array { name, kind, components, format, offset, text, place };
        match (section, rank) {
            ("points", _) => piece.points = Some(array),
            (_, Some(rank)) => {
                let better = piece.regions.as_ref().is_none_or(|(best, _)| rank < *best);
                if better && kind.is_whole() && components == 1 {
                    piece.regions = Some((rank, array));
                }
            }
            _ if piece.cells.len() < 64 => piece.cells.push((section.to_owned(), array)),
            _ => {}
        }
        Ok(())
    }

    fn appended(&mut self, element: &BytesStart, begin: usize, at: usize) -> Result<(), MeshError> {
        let place = LazyPosition::LineOfByte(at);
        let base64 = match attribute(element, "encoding").unwrap_or_default().to_ascii_lowercase().as_str() {
            "raw" => false,
            "" | "base64" => true,
            other => {
                let what = format!("appended data in {}", quoted(other.as_bytes()));
                return Err(self.cursor.unsupported(place, what, "raw, base64"));
            }
        };
        self.cursor.seek(begin);
        let mark = self.cursor.remaining().iter().position(|b| !b.is_ascii_whitespace());
        match mark.filter(|&mark| self.cursor.remaining()[mark] == b'_') {
            Some(mark) => {
                self.appended = Some(Appended { begin: begin + mark + 1, base64 });
                Ok(())
            }
            None => Err(self.cursor.malformed(place, "appended data begins with '_'")),
        }
    }

    fn add_piece(&mut self, piece: &Piece, grid: &mut Grid) -> Result<(), MeshError> {
        let Some(points) = &piece.points else {
            return Err(self.cursor.malformed(WHOLE, "a Piece has no Points"));
        };
        let base = grid.positions.len();
        let numbers = self.numbers(points)?;
        if points.components != 3 || numbers.len() % 3 != 0 {
            let reason =
                format!("{} coordinates of {} components are no points", numbers.len(), points.components);
            return Err(self.cursor.malformed(points.place, reason));
        }
        let count = (base + numbers.len() / 3) as u64;
        if count > self.cursor.limits.vertices {
            return Err(self.cursor.too_large(points.place, "points", count, self.cursor.limits.vertices));
        }
        for (index, point) in numbers.chunks_exact(3).enumerate() {
            self.cursor.finite(points.place, "point", index, point)?;
            grid.positions.push(Point3::new(point[0], point[1], point[2]));
        }
        if self.is_poly {
            for (section, kind) in POLY_SECTIONS {
                if let Some(list) = self.cells(piece, section)? {
                    add_cells(grid, &self.cursor, &list, base, |_| kind, None)?;
                }
            }
            return Ok(());
        }
        let Some(list) = self.cells(piece, "cells")? else {
            return Err(self.cursor.malformed(WHOLE, "a Piece has no Cells with connectivity and offsets"));
        };
        let Some(types) = piece.cells.iter().find(|(_, array)| array.name == "types") else {
            return Err(self.cursor.malformed(WHOLE, "the Cells of a Piece have no types"));
        };
        let kinds = self.whole_numbers(&types.1)?;
        let regions = match &piece.regions {
            None => None,
            Some((_, array)) => {
                let regions = self.whole_numbers(array)?;
                let narrow = |&region: &i64| i32::try_from(region).ok();
                let regions: Option<Vec<i32>> = regions.iter().map(narrow).collect();
                let out = || self.cursor.malformed(array.place, "a region needs more than 32 bits");
                Some(regions.ok_or_else(out)?)
            }
        };
        let told = regions.as_ref().map_or(kinds.len(), Vec::len);
        if kinds.len() != list.count() || told != list.count() {
            let reason =
                format!("there are {} cells, but {} types and {told} regions", list.count(), kinds.len());
            return Err(self.cursor.malformed(types.1.place, reason));
        }
        grid.has_regions |= regions.is_some();
        add_cells(grid, &self.cursor, &list, base, |k| kinds[k], regions.as_deref())
    }

    /// The cells of a section; `None` when it has none.
    fn cells(&mut self, piece: &Piece, section: &str) -> Result<Option<CellList>, MeshError> {
        let find = |name: &str| {
            piece.cells.iter().find(|(of, array)| of == section && array.name == name).map(|(_, array)| array)
        };
        let (Some(connectivity), Some(offsets)) = (find("connectivity"), find("offsets")) else {
            return Ok(None);
        };
        let corners = self.whole_numbers(connectivity)?;
        let mut begins = self.whole_numbers(offsets)?;
        begins.insert(0, 0);
        let count = begins.len() as u64;
        if count > self.cursor.limits.elements {
            return Err(self.cursor.too_large(offsets.place, "cells", count, self.cursor.limits.elements));
        }
        CellList::new(&self.cursor, offsets.place, &begins, corners).map(Some)
    }

    fn numbers(&mut self, array: &Array) -> Result<Vec<f64>, MeshError> {
        if array.format == Format::Ascii {
            return self.words(array);
        }
        let (order, kind) = (self.order, array.kind);
        let bytes = self.bytes(array)?;
        Ok(bytes.chunks_exact(kind.bytes()).map(|number| kind.number(number, order)).collect())
    }

    fn whole_numbers(&mut self, array: &Array) -> Result<Vec<i64>, MeshError> {
        if array.format == Format::Ascii {
            return self.words(array);
        }
        let (order, kind) = (self.order, array.kind);
        let bytes = self.bytes(array)?;
        Ok(bytes.chunks_exact(kind.bytes()).map(|number| kind.whole(number, order)).collect())
    }

    /// Numbers written as text.
    fn words<T: std::str::FromStr>(&self, array: &Array) -> Result<Vec<T>, MeshError> {
        let mut cursor = self.cursor.clone().ending_at(array.text.end);
        cursor.seek(array.text.start);
        let mut numbers = Vec::new();
        loop {
            cursor.skip_space();
            if cursor.remaining().is_empty() {
                return Ok(numbers);
            }
            numbers.push(cursor.parse("a number")?);
        }
    }

    /// Bytes of an array, decoded and decompressed.
    fn bytes(&mut self, array: &Array) -> Result<Vec<u8>, MeshError> {
        let whole = self.cursor.clone();
        let mut inline = whole.clone().ending_at(array.text.end);
        let mut source = match (array.format, &self.appended) {
            (Format::Appended, None) => {
                return Err(self.cursor.malformed(array.place, "the file has no AppendedData"));
            }
            (Format::Appended, Some(appended)) => {
                let mut cursor = whole;
                let offset = usize::try_from(array.offset).unwrap_or(usize::MAX);
                cursor.seek(appended.begin.saturating_add(offset));
                let rest = cursor.remaining();
                if appended.base64 {
                    // The end tag is no symbol of the alphabet.
                    let length = rest.iter().position(|&b| b == b'<').unwrap_or(rest.len());
                    Source::Base64(Base64::new(&rest[..length]))
                } else {
                    Source::Raw(rest)
                }
            }
            _ => {
                inline.seek(array.text.start);
                Source::Base64(Base64::new(inline.remaining()))
            }
        };
        let header = if self.wide_headers { NumberKind::U64 } else { NumberKind::U32 };
        let short = || {
            let reason = format!("the array '{}' is cut short or damaged", array.name);
            self.cursor.malformed(array.place, reason)
        };
        let order = self.order;
        let length = |source: &mut Source| -> Option<usize> {
            let bytes = source.take(header.bytes())?;
            usize::try_from(header.whole(&bytes, order)).ok()
        };
        if !self.compressed {
            let count = length(&mut source).ok_or_else(short)?;
            return source.take(count).ok_or_else(short);
        }
        let [blocks, block, last] = [(); 3].map(|()| length(&mut source));
        let (Some(blocks), Some(block), Some(last)) = (blocks, block, last) else { return Err(short()) };
        if blocks == 0 {
            return Ok(Vec::new());
        }
        let full = if last == 0 { blocks } else { blocks - 1 };
        let total = (full as u64).saturating_mul(block as u64).saturating_add(last as u64);
        if total > self.budget {
            return Err(self.cursor.too_large(array.place, "bytes of compressed arrays", total, self.budget));
        }
        if blocks > source.bytes_max() / header.bytes() {
            return Err(short());
        }
        let sizes: Option<Vec<usize>> = (0..blocks).map(|_| length(&mut source)).collect();
        let mut bytes = Vec::new();
        for (k, size) in sizes.ok_or_else(short)?.into_iter().enumerate() {
            let packed = source.take(size).ok_or_else(short)?;
            let wanted = if k < full { block } else { last };
            let part = decompress_to_vec_zlib_with_limit(&packed, wanted).ok();
            bytes.extend(part.filter(|part| part.len() == wanted).ok_or_else(short)?);
        }
        self.budget -= total;
        Ok(bytes)
    }
}

/// Bytes of a file, raw or as base64.
enum Source<'a> {
    Raw(&'a [u8]),
    Base64(Base64<'a>),
}

impl Source<'_> {
    fn bytes_max(&self) -> usize {
        match self {
            Source::Raw(bytes) => bytes.len(),
            Source::Base64(text) => text.bytes_max(),
        }
    }

    fn take(&mut self, count: usize) -> Option<Vec<u8>> {
        match self {
            Source::Raw(bytes) => {
                let (taken, rest) = bytes.split_at_checked(count)?;
                *bytes = rest;
                Some(taken.to_vec())
            }
            Source::Base64(text) => text.take(count),
        }
    }
}
