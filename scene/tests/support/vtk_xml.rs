//! VTK's XML files.

use miniz_oxide::deflate::compress_to_vec_zlib;
use trocar_scene::mesh::TetData;

use super::Order;

/// How the arrays of a file are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    Ascii,
    Base64,
    AppendedBase64,
    AppendedRaw,
}

/// A form with its details.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    pub form: Form,
    pub order: Order,
    pub compressed: bool,
    /// Whether lengths have 64 bits.
    pub wide: bool,
}

/// Every combination.
pub fn styles() -> Vec<Style> {
    let mut styles = Vec::new();
    for form in [Form::Ascii, Form::Base64, Form::AppendedBase64, Form::AppendedRaw] {
        for order in [Order::Little, Order::Big] {
            for (compressed, wide) in [(false, false), (false, true), (true, false), (true, true)] {
                styles.push(Style { form, order, compressed, wide });
            }
        }
    }
    styles
}

pub fn base64(bytes: &[u8]) -> String {
    const SYMBOLS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in bytes.chunks(3) {
        let bits = (0..3).fold(0u32, |bits, k| bits << 8 | u32::from(chunk.get(k).copied().unwrap_or(0)));
        for k in 0..4 {
            let symbol = SYMBOLS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= chunk.len() { symbol as char } else { '=' });
        }
    }
    text
}

impl Style {
    fn number(self, bytes: &[u8]) -> Vec<u8> {
        match self.order {
            Order::Little => bytes.to_vec(),
            Order::Big => bytes.iter().rev().copied().collect(),
        }
    }

    fn length(self, length: usize) -> Vec<u8> {
        let wide = (length as u64).to_le_bytes();
        self.number(if self.wide { &wide } else { &wide[..4] })
    }

    /// The header of an array and its data.
    fn packed(self, data: &[u8]) -> (Vec<u8>, Vec<u8>) {
        if !self.compressed {
            return (self.length(data.len()), data.to_vec());
        }
        // Small blocks, so that there are several and a last one that is shorter.
        const BLOCK: usize = 100;
        let blocks: Vec<Vec<u8>> = data.chunks(BLOCK).map(|block| compress_to_vec_zlib(block, 6)).collect();
        let mut header = self.length(blocks.len());
        header.extend(self.length(BLOCK));
        header.extend(self.length(data.len() % BLOCK));
        blocks.iter().for_each(|block| header.extend(self.length(block.len())));
        (header, blocks.concat())
    }

    fn array(self, attributes: &str, text: &str, data: &[u8], appended: &mut Vec<u8>) -> String {
        let (header, packed) = self.packed(data);
        // VTK encodes the lengths of compressed blocks apart from the blocks, and a plain length with its data.
        let encoded = || match self.compressed {
            true => base64(&header) + &base64(&packed),
            false => base64(&[header.clone(), packed.clone()].concat()),
        };
        let offset = appended.len();
        match self.form {
            Form::Ascii => format!("<DataArray {attributes} format=\"ascii\">\n{text}\n</DataArray>\n"),
            Form::Base64 => {
                format!("<DataArray {attributes} format=\"binary\">\n{}\n</DataArray>\n", encoded())
            }
            Form::AppendedBase64 => {
                appended.extend(encoded().into_bytes());
                format!("<DataArray {attributes} format=\"appended\" offset=\"{offset}\"/>\n")
            }
            Form::AppendedRaw => {
                appended.extend([header, packed].concat());
                format!("<DataArray {attributes} format=\"appended\" offset=\"{offset}\"/>\n")
            }
        }
    }
}

/// An unstructured grid with the tags as an array `region`.
pub fn write_vtu(volume: &TetData, style: Style) -> Vec<u8> {
    let (wide, little) = (if style.wide { "UInt64" } else { "UInt32" }, style.order == Order::Little);
    let order = if little { "LittleEndian" } else { "BigEndian" };
    let compressor = if style.compressed { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
    let mut appended = Vec::new();
    let bytes = |numbers: &mut dyn Iterator<Item = Vec<u8>>| -> Vec<u8> {
        numbers.flat_map(|number| style.number(&number)).collect()
    };
    fn words<T: ToString>(numbers: impl Iterator<Item = T>) -> String {
        numbers.map(|number| number.to_string()).collect::<Vec<_>>().join(" ")
    }
    let coordinates = || volume.positions.iter().flat_map(|p| [p.x, p.y, p.z]);
    let corners = || volume.tets.iter().flatten().copied();
    let offsets = || (1..=volume.tets.len()).map(|k| 4 * k as i64);
    let types = || volume.tets.iter().map(|_| 10u8);
    let tags = || volume.tags.iter().copied();
    let mut array =
        |attributes: &str, text: String, data: Vec<u8>| style.array(attributes, &text, &data, &mut appended);
    let points = array(
        "type=\"Float64\" NumberOfComponents=\"3\"",
        words(coordinates()),
        bytes(&mut coordinates().map(|x| x.to_le_bytes().to_vec())),
    );
    let connectivity = array(
        "type=\"Int32\" Name=\"connectivity\"",
        words(corners()),
        bytes(&mut corners().map(|x| x.to_le_bytes().to_vec())),
    );
    let offsets = array(
        "type=\"Int64\" Name=\"offsets\"",
        words(offsets()),
        bytes(&mut offsets().map(|x| x.to_le_bytes().to_vec())),
    );
    let types = array("type=\"UInt8\" Name=\"types\"", words(types()), bytes(&mut types().map(|x| vec![x])));
    let regions = array(
        "type=\"Int32\" Name=\"region\"",
        words(tags()),
        bytes(&mut tags().map(|x| x.to_le_bytes().to_vec())),
    );
    let mut file = format!(
        "<?xml version=\"1.0\"?>\n<!-- a comment -->\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" \
         byte_order=\"{order}\" header_type=\"{wide}\"{compressor}>\n<UnstructuredGrid>\n\
         <Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n<CellData>\n{regions}</CellData>\n\
         <Points>\n{points}</Points>\n<Cells>\n{connectivity}{offsets}{types}</Cells>\n</Piece>\n</UnstructuredGrid>\n",
        volume.positions.len(),
        volume.tets.len()
    )
    .into_bytes();
    if !appended.is_empty() {
        let encoding = if style.form == Form::AppendedRaw { "raw" } else { "base64" };
        file.extend_from_slice(format!("<AppendedData encoding=\"{encoding}\">\n   _").as_bytes());
        file.extend(appended);
        file.extend_from_slice(b"\n</AppendedData>\n");
    }
    file.extend_from_slice(b"</VTKFile>\n");
    file
}
