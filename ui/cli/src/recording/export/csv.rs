//! Tables as comma-separated values. Every number is the shortest text that reads back to the same bits.

use csv::Writer;

use super::columns::{Cell, Columns};
use super::part_file::PartFile;
use super::tables::TableWriter;

/// A table that is written.
pub struct CsvTable {
    writer: Writer<PartFile>,
}

impl CsvTable {
    /// Writes the names of the columns.
    pub fn begin(file: PartFile, columns: &Columns) -> Result<Self, String> {
        let mut writer = Writer::from_writer(file);
        let names = columns.list().iter().map(|(name, _)| name);
        writer.write_record(names).map_err(|error| error.to_string())?;
        Ok(Self { writer })
    }
}

impl TableWriter for CsvTable {
    fn row(&mut self, cells: &[Cell]) -> Result<(), String> {
        let written = cells.iter().try_for_each(|cell| match cell {
            Cell::Empty => self.writer.write_field(""),
            Cell::Boolean(value) => self.writer.write_field(value.to_string()),
            Cell::Whole(value) => self.writer.write_field(value.to_string()),
            // With an exponent where that is shorter.
            Cell::Number(value) => self.writer.write_field(format!("{value:?}")),
            Cell::Text(text) => self.writer.write_field(text),
        });
        written.and_then(|()| self.writer.write_record(None::<&[u8]>)).map_err(|error| error.to_string())
    }

    fn finish(self: Box<Self>) -> Result<u64, String> {
        let file = self.writer.into_inner().map_err(|error| error.to_string())?;
        file.finish().map_err(|error| error.to_string())
    }
}
