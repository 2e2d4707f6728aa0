//! Tables as Apache Parquet: columns of DOUBLE, INT64, BOOLEAN and UTF8, in groups of rows.

use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;

use super::columns::{Cell, Columns, Kind};
use super::part_file::PartFile;
use super::tables::TableWriter;

/// Cells of a group of rows: what is kept in memory.
const GROUP_CELLS: usize = 1 << 20;

/// The cells of a column that are not yet written; empty ones have no value.
enum Cells {
    Boolean(Vec<bool>),
    Whole(Vec<i64>),
    Number(Vec<f64>),
    Text(Vec<ByteArray>),
}

struct Column {
    cells: Cells,
    /// 1 for each cell with a value, 0 for each empty one.
    levels: Vec<i16>,
}

/// A table that is written.
pub struct ParquetTable {
    writer: SerializedFileWriter<PartFile>,
    columns: Vec<Column>,
    /// Rows of a group.
    group: usize,
}

impl ParquetTable {
    /// Writes the schema.
    pub fn begin(file: PartFile, columns: &Columns) -> Result<Self, String> {
        let fields: Result<Vec<_>, ParquetError> =
            columns.list().iter().map(|(name, kind)| field(name, *kind)).collect();
        let schema = fields
            .and_then(|fields| Type::group_type_builder("trocar").with_fields(fields).build().map(Arc::new));
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
        let writer = schema
            .and_then(|schema| SerializedFileWriter::new(file, schema, Arc::new(properties)))
            .map_err(|error| error.to_string())?;
        let empty = |kind| match kind {
            Kind::Boolean => Cells::Boolean(Vec::new()),
            Kind::Whole => Cells::Whole(Vec::new()),
            Kind::Number => Cells::Number(Vec::new()),
            Kind::Text | Kind::Nothing => Cells::Text(Vec::new()),
        };
        let column = |(_, kind): &(String, Kind)| Column { cells: empty(*kind), levels: Vec::new() };
        let list = columns.list();
        let group = GROUP_CELLS / list.len().max(1);
        Ok(Self { writer, columns: list.iter().map(column).collect(), group })
    }

    fn write_group(&mut self) -> Result<(), ParquetError> {
        if self.columns.first().is_none_or(|column| column.levels.is_empty()) {
            return Ok(());
        }
        let mut group = self.writer.next_row_group()?;
        for column in &mut self.columns {
            let Some(mut writer) = group.next_column()? else { break };
            let levels = std::mem::take(&mut column.levels);
            match &mut column.cells {
                Cells::Boolean(cells) => write::<BoolType>(&mut writer, cells, &levels)?,
                Cells::Whole(cells) => write::<Int64Type>(&mut writer, cells, &levels)?,
                Cells::Number(cells) => write::<DoubleType>(&mut writer, cells, &levels)?,
                Cells::Text(cells) => write::<ByteArrayType>(&mut writer, cells, &levels)?,
            }
            writer.close()?;
        }
        group.close().map(drop)
    }
}

fn write<T: DataType>(
    writer: &mut SerializedColumnWriter<'_>,
    cells: &mut Vec<T::T>,
    levels: &[i16],
) -> Result<(), ParquetError> {
    writer.typed::<T>().write_batch(cells, Some(levels), None)?;
    cells.clear();
    Ok(())
}

fn field(name: &str, kind: Kind) -> Result<Arc<Type>, ParquetError> {
    let physical = match kind {
        Kind::Boolean => Physical::BOOLEAN,
        Kind::Whole => Physical::INT64,
        Kind::Number => Physical::DOUBLE,
        Kind::Text | Kind::Nothing => Physical::BYTE_ARRAY,
    };
    let text = (physical == Physical::BYTE_ARRAY).then_some(LogicalType::String);
    let field = Type::primitive_type_builder(name, physical);
    field.with_repetition(Repetition::OPTIONAL).with_logical_type(text).build().map(Arc::new)
}

impl TableWriter for ParquetTable {
    fn row(&mut self, cells: &[Cell]) -> Result<(), String> {
        for (column, cell) in self.columns.iter_mut().zip(cells) {
            let has_value = match (&mut column.cells, cell) {
                (Cells::Boolean(cells), Cell::Boolean(value)) => {
                    cells.push(*value);
                    true
                }
                (Cells::Whole(cells), Cell::Whole(value)) => {
                    cells.push(*value);
                    true
                }
                (Cells::Number(cells), Cell::Number(value)) => {
                    cells.push(*value);
                    true
                }
                (Cells::Text(cells), Cell::Text(text)) => {
                    cells.push(ByteArray::from(text.as_str()));
                    true
                }
                _ => false,
            };
            column.levels.push(i16::from(has_value));
        }
        let is_full = self.columns.first().is_some_and(|column| column.levels.len() >= self.group);
        if is_full { self.write_group().map_err(|error| error.to_string()) } else { Ok(()) }
    }

    fn finish(mut self: Box<Self>) -> Result<u64, String> {
        let written = self.write_group().and_then(|()| self.writer.into_inner());
        written.map_err(|error| error.to_string())?.finish().map_err(|error| error.to_string())
    }
}
