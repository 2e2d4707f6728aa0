//! Tables of an export: one for each component, with the columns that a first reading found.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use trocar_scene::SimTime;
use trocar_scene::output_file::Replace;

use super::columns::{Cell, Columns, Kind};
use super::csv::CsvTable;
use super::flatten::{ENTITY, INDEX, Lists, TIME, entry_cells};
use super::parquet::ParquetTable;
use super::part_file::PartFile;
use crate::failure::Failure;
use crate::recording::TableFormat;

/// Most columns of a table.
const COLUMNS_MAX: usize = 2_000;
/// Takes the rows of one file.
pub trait TableWriter {
    /// Writes a row: a cell for each column.
    fn row(&mut self, cells: &[Cell]) -> Result<(), String>;
    /// Writes what is left, and gives the file its name.
    fn finish(self: Box<Self>) -> Result<u64, String>;
}

/// What a first reading has found of a table.
#[derive(Default)]
struct Found {
    has_entity: bool,
    lists: Lists,
    fields: Columns,
    entries: Columns,
}

/// What a first reading has found.
#[derive(Default)]
pub struct Survey {
    tables: BTreeMap<String, Found>,
}

impl Survey {
    /// Notes a row.
    pub fn row(&mut self, table: &str, has_entity: bool, value: &Value) {
        if !self.tables.contains_key(table) {
            self.tables.insert(table.to_owned(), Found { has_entity, ..Found::default() });
        }
        if let Some(found) = self.tables.get_mut(table) {
            found.lists.note(value);
            found.note(value);
        }
    }

    /// A table without entities that is there even without rows, with these columns first.
    pub fn expect(&mut self, table: &str, columns: &[(&str, Kind)]) {
        let mut found = Found::default();
        columns.iter().for_each(|(name, kind)| found.fields.widen(name, *kind));
        self.tables.insert(table.to_owned(), found);
    }

    /// Whether there is such a table.
    pub fn has(&self, table: &str) -> bool {
        self.tables.contains_key(table)
    }
}

impl Found {
    fn note(&mut self, value: &Value) {
        let Self { lists, fields, entries, .. } = self;
        lists.cells(value, &mut |name, cell| fields.note(name, cell), &mut |name, list| {
            for entry in list {
                entry_cells(name, entry, &mut |name, part| entries.note(name, part));
            }
        });
    }

    /// The columns of the table, and where those of the fields begin.
    fn columns(&self) -> Columns {
        let mut all = Columns::default();
        all.widen(TIME, Kind::Number);
        if self.has_entity {
            all.widen(ENTITY, Kind::Text);
        }
        if self.lists.any_long() {
            all.widen(INDEX, Kind::Whole);
        }
        // A list that turned out to be long only later has left columns of its first entries.
        let is_left = |name: &str| {
            let parents = name.match_indices('.').map(|(at, _)| &name[..at]);
            let mut parents =
                parents.filter(|parent| self.lists.is_long(parent) || self.lists.is_text(parent));
            parents.next().is_some()
        };
        for (name, kind) in self.fields.list().iter().filter(|(name, _)| !is_left(name)) {
            all.widen(name, *kind);
        }
        for (name, kind) in self.entries.list() {
            all.widen(name, *kind);
        }
        all
    }
}

/// A table that was written.
pub struct Written {
    /// The component's name.
    pub name: String,
    /// The file.
    pub file: PathBuf,
    /// Its rows.
    pub rows: u64,
    /// Names of its columns.
    pub columns: Vec<String>,
    /// Bytes of the file.
    pub bytes: u64,
}

struct Table {
    lists: Lists,
    columns: Columns,
    writer: Box<dyn TableWriter>,
    file: PathBuf,
    rows: u64,
}

/// The tables while they are written.
pub struct Tables {
    tables: BTreeMap<String, Table>,
}

impl Tables {
    /// Begins the files.
    pub fn create(
        survey: Survey,
        folder: &Path,
        format: TableFormat,
        replace: Replace,
    ) -> Result<Self, Failure> {
        let mut tables = BTreeMap::new();
        for (name, found) in survey.tables {
            let columns = found.columns();
            let count = columns.list().len();
            if count > COLUMNS_MAX {
                return Err(Failure::invalid(format!(
                    "'{name}' would be a table of {count} columns, more than {COLUMNS_MAX}: leave it out with \
                     --component"
                )));
            }
            let ending = match format {
                TableFormat::Csv => "csv",
                TableFormat::Parquet => "parquet",
            };
            let file = folder.join(format!("{name}.{ending}"));
            let part = PartFile::create(&file, replace)?;
            let writer: Result<Box<dyn TableWriter>, String> = match format {
                TableFormat::Csv => CsvTable::begin(part, &columns).map(|table| Box::new(table) as _),
                TableFormat::Parquet => ParquetTable::begin(part, &columns).map(|table| Box::new(table) as _),
            };
            let writer = writer.map_err(|error| failed(&file, &error))?;
            tables.insert(name, Table { lists: found.lists, columns, writer, file, rows: 0 });
        }
        Ok(Self { tables })
    }

    /// Writes a value: as a row, or as a row for each entry of its long lists.
    pub fn row(
        &mut self,
        table: &str,
        time: SimTime,
        entity: Option<&str>,
        value: &Value,
    ) -> Result<(), Failure> {
        let Some(table) = self.tables.get_mut(table) else { return Ok(()) };
        let Table { lists, columns, writer, file, rows: count } = table;
        let mut cells = vec![Cell::Empty; columns.list().len()];
        // The number nearest to it, which is the shortest as text.
        cells[0] = Cell::Number(time.as_nanos() as f64 / 1e9);
        let set = |cells: &mut [Cell], name: &str, value: &Value| {
            if let Some((place, kind)) = columns.find(name) {
                cells[place] = Cell::new(value, kind);
            }
        };
        if let Some((place, _)) = columns.find(ENTITY) {
            cells[place] = entity.map_or(Cell::Empty, |entity| Cell::Text(entity.to_owned()));
        }
        let mut long: Vec<(String, &[Value])> = Vec::new();
        lists.cells(value, &mut |name, value| set(&mut cells, name, value), &mut |name, entries| {
            long.push((name.to_owned(), entries))
        });
        let rows = long.iter().map(|(_, entries)| entries.len()).max().unwrap_or(0);
        let index = columns.find(INDEX).map(|(place, _)| place).filter(|_| rows > 0);
        for row in 0..rows.max(1) {
            let mut cells = cells.clone();
            for (name, entry) in long.iter().filter_map(|(name, entries)| Some((name, entries.get(row)?))) {
                entry_cells(name, entry, &mut |name, part| set(&mut cells, name, part));
            }
            if let Some(place) = index {
                cells[place] = Cell::Whole(row as i64);
            }
            writer.row(&cells).map_err(|error| failed(file, &error))?;
            *count += 1;
        }
        Ok(())
    }

    /// Ends the files.
    pub fn finish(self) -> Result<Vec<Written>, Failure> {
        let tables = self.tables.into_iter().map(|(name, table)| {
            let bytes = table.writer.finish().map_err(|error| failed(&table.file, &error))?;
            let columns = table.columns.list().iter().map(|(name, _)| name.clone()).collect();
            Ok(Written { name, file: table.file, rows: table.rows, columns, bytes })
        });
        tables.collect()
    }
}

fn failed(file: &Path, error: &str) -> Failure {
    Failure::invalid(format!("{}: cannot be written: {error}", file.display()))
}
