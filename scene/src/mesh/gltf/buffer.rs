//! Buffers and accessors of glTF: decoding of numbers with every access checked.

use std::borrow::Cow;

use ::gltf::json;
use json::accessor::{ComponentType, Type};
use json::validation::Checked;

use crate::confined_path;
use crate::mesh::base64::Base64;
use crate::mesh::cursor::{Cursor, LazyPosition};
use crate::mesh::error::{FilePosition, MeshError};
use crate::mesh::limits::read_bytes;

const WHOLE: LazyPosition = LazyPosition::Known(FilePosition::Whole);

/// The bytes of every buffer of a document.
pub(super) struct Buffers<'a> {
    buffers: Vec<Cow<'a, [u8]>>,
}

impl<'a> Buffers<'a> {
    /// Fetches every buffer: the binary chunk, data URIs, files below the document's folder.
    pub fn open(cursor: &Cursor, root: &json::Root, blob: Option<&'a [u8]>) -> Result<Self, MeshError> {
        let mut buffers = Vec::new();
        let mut left = cursor.limits.bytes;
        for (k, buffer) in root.buffers.iter().enumerate() {
            let bytes: Cow<'a, [u8]> = match &buffer.uri {
                None => match blob {
                    Some(blob) if k == 0 => Cow::Borrowed(blob),
                    _ => return Err(cursor.malformed(WHOLE, format!("buffer {k} has no uri"))),
                },
                Some(uri) if uri.starts_with("data:") => Cow::Owned(
                    data_uri(uri).map_err(|why| cursor.malformed(WHOLE, format!("buffer {k}: {why}")))?,
                ),
                Some(uri) => {
                    let refuse = |why: &str| {
                        let shown: String = uri.chars().take(80).flat_map(char::escape_default).collect();
                        cursor.malformed(WHOLE, format!("buffer {k}, uri '{shown}': {why}"))
                    };
                    let relative = percent_decoded(uri).ok_or_else(|| refuse("invalid percent-encoding"))?;
                    if relative.contains(':') {
                        return Err(refuse("only data URIs and files below the document's folder are read"));
                    }
                    let folder = cursor.file.parent().unwrap_or(std::path::Path::new(""));
                    let file = confined_path::below(folder, &relative).map_err(refuse)?;
                    Cow::Owned(read_bytes(&file, &crate::mesh::Limits { bytes: left, ..*cursor.limits })?)
                }
            };
            left = left.saturating_sub(bytes.len() as u64);
            if (bytes.len() as u64) < buffer.byte_length.0 {
                let (file, declared, possible) =
                    (cursor.file.into(), buffer.byte_length.0, bytes.len() as u64);
                return Err(MeshError::Truncated {
                    file,
                    place: FilePosition::Whole,
                    what: "bytes of a buffer",
                    declared,
                    possible,
                });
            }
            buffers.push(bytes);
        }
        Ok(Self { buffers })
    }

    /// An accessor of vectors with N numbers, which must be finite.
    pub fn vectors<const N: usize>(
        &self,
        cursor: &Cursor,
        root: &json::Root,
        accessor: usize,
        what: &'static str,
    ) -> Result<Vec<[f64; N]>, MeshError> {
        let expected = if N == 2 { Type::Vec2 } else { Type::Vec3 };
        let view = self.accessor(cursor, root, accessor, expected)?;
        let mut vectors = Vec::with_capacity(view.count);
        for k in 0..view.count {
            let mut vector = [0.0; N];
            for (c, number) in vector.iter_mut().enumerate() {
                *number = view.number(k, c);
            }
            cursor.finite(WHOLE, what, k, &vector)?;
            vectors.push(vector);
        }
        Ok(vectors)
    }

    /// An accessor of indices.
    pub fn indices(
        &self,
        cursor: &Cursor,
        root: &json::Root,
        accessor: usize,
    ) -> Result<Vec<u32>, MeshError> {
        let view = self.accessor(cursor, root, accessor, Type::Scalar)?;
        if !matches!(view.kind, ComponentType::U8 | ComponentType::U16 | ComponentType::U32) {
            return Err(
                cursor.malformed(WHOLE, format!("accessor {accessor} holds indices that are not unsigned"))
            );
        }
        Ok((0..view.count).map(|k| view.number(k, 0) as u32).collect())
    }

    fn accessor(
        &self,
        cursor: &Cursor,
        root: &json::Root,
        index: usize,
        expected: Type,
    ) -> Result<View<'_>, MeshError> {
        let fail = |reason: String| cursor.malformed(WHOLE, format!("accessor {index}: {reason}"));
        let accessor = root.accessors.get(index).ok_or_else(|| fail("does not exist".into()))?;
        if accessor.sparse.is_some() {
            return Err(cursor.unsupported(WHOLE, format!("sparse accessor {index}"), "dense accessors"));
        }
        let (Checked::Valid(json::accessor::GenericComponentType(kind)), Checked::Valid(shape)) =
            (accessor.component_type, accessor.type_)
        else {
            return Err(fail("invalid type".into()));
        };
        let components = match shape {
            Type::Scalar => 1,
            Type::Vec2 => 2,
            Type::Vec3 => 3,
            _ => 4,
        };
        if shape != expected {
            return Err(fail(format!("{expected:?} is expected, found {shape:?}")));
        }
        let view = accessor.buffer_view.and_then(|view| root.buffer_views.get(view.value()));
        let view = view.ok_or_else(|| fail("its buffer view does not exist".into()))?;
        let buffer = self.buffers.get(view.buffer.value());
        let buffer = buffer.ok_or_else(|| fail("its buffer does not exist".into()))?;
        let slice = |bytes: &'_ [u8], offset: u64, length: u64| -> Option<std::ops::Range<usize>> {
            let end = offset.checked_add(length).filter(|end| *end <= bytes.len() as u64)?;
            Some(offset as usize..end as usize)
        };
        let range = slice(buffer, view.byte_offset.map_or(0, |offset| offset.0), view.byte_length.0)
            .ok_or_else(|| fail("its buffer view reaches beyond the buffer".into()))?;
        let bytes = &buffer[range];
        let element = kind.size() * components;
        let stride = view.byte_stride.as_ref().map_or(element, |stride| stride.0).max(element);
        let count = accessor.count.0;
        let limit = cursor.limits.vertices.max(cursor.limits.elements.saturating_mul(3));
        if count > limit {
            return Err(cursor.too_large(WHOLE, "elements of an accessor", count, limit));
        }
        let needed = count.saturating_sub(1).saturating_mul(stride as u64).saturating_add(element as u64);
        let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
        let length = if count == 0 { 0 } else { needed };
        let range = slice(bytes, offset, length)
            .ok_or_else(|| fail(format!("{count} elements reach beyond its buffer view")))?;
        let normalized = accessor.normalized;
        Ok(View { bytes: &bytes[range], kind, stride, count: count as usize, normalized })
    }
}

/// `count` elements at a stride, all inside `bytes`.
struct View<'a> {
    bytes: &'a [u8],
    kind: ComponentType,
    stride: usize,
    count: usize,
    normalized: bool,
}

impl View<'_> {
    fn number(&self, element: usize, component: usize) -> f64 {
        let size = self.kind.size();
        let at = element * self.stride + component * size;
        let mut raw = [0u8; 4];
        raw[..size].copy_from_slice(&self.bytes[at..at + size]);
        let (value, full) = match self.kind {
            ComponentType::I8 => (f64::from(raw[0] as i8), 127.0),
            ComponentType::U8 => (f64::from(raw[0]), 255.0),
            ComponentType::I16 => (f64::from(i16::from_le_bytes([raw[0], raw[1]])), 32_767.0),
            ComponentType::U16 => (f64::from(u16::from_le_bytes([raw[0], raw[1]])), 65_535.0),
            ComponentType::U32 => (f64::from(u32::from_le_bytes(raw)), 1.0),
            ComponentType::F32 => (f64::from(f32::from_le_bytes(raw)), 1.0),
        };
        if self.normalized { (value / full).max(-1.0) } else { value }
    }
}

/// `data:TYPE;base64,…` (RFC 2397).
fn data_uri(uri: &str) -> Result<Vec<u8>, &'static str> {
    let (head, body) = uri.split_once(',').ok_or("a data URI without ','")?;
    if !head.ends_with(";base64") {
        return Err("a data URI that is not base64");
    }
    let decoded = Base64::new(body.as_bytes()).all();
    decoded.ok_or("invalid base64")
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, tail)) = rest.split_first() {
        if first == b'%' {
            let digits = std::str::from_utf8(tail.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &tail[2..];
        } else {
            bytes.push(first);
            rest = tail;
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_encoding_decodes_and_refuses_nonsense() {
        assert_eq!(percent_decoded("a%20b"), Some("a b".into()));
        assert_eq!(percent_decoded("a%2"), None);
        assert_eq!(percent_decoded("%zz"), None);
        assert_eq!(percent_decoded("%ff"), None);
    }
}
