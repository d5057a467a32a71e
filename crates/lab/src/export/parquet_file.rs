//! Columns as a Parquet file, uncompressed: Parquet's own encodings leave little to compress, and a compressor would be a
//! second zstd beside the one of our logs.

use anyhow::{Context, Result};
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, FloatType, Int64Type};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};
use std::fs::File;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// A column, or one of lists of equal length.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Column {
    pub(super) name: String,
    pub(super) values: Values,
    /// Elements of each row's list; `None` where rows are no lists.
    pub(super) width: Option<usize>,
}

/// Values, of lists one row after the other.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Values {
    Singles(Vec<f32>),
    Doubles(Vec<f64>),
    Integers(Vec<i64>),
    Flags(Vec<bool>),
    Texts(Vec<String>),
}

impl Column {
    pub(super) fn new(name: &str, values: Values) -> Self {
        Self { name: name.into(), values, width: None }
    }

    /// Lists of `width`.
    pub(super) fn lists(name: &str, width: usize, values: Values) -> Self {
        Self { name: name.into(), values, width: Some(width) }
    }

    pub(super) fn rows(&self) -> usize {
        let values = match &self.values {
            Values::Singles(values) => values.len(),
            Values::Doubles(values) => values.len(),
            Values::Integers(values) => values.len(),
            Values::Flags(values) => values.len(),
            Values::Texts(values) => values.len(),
        };
        values / self.width.unwrap_or(1).max(1)
    }

    fn schema(&self) -> Result<TypePtr> {
        let (physical, logical) = match &self.values {
            Values::Singles(_) => (Physical::FLOAT, None),
            Values::Doubles(_) => (Physical::DOUBLE, None),
            Values::Integers(_) => (Physical::INT64, None),
            Values::Flags(_) => (Physical::BOOLEAN, None),
            Values::Texts(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let of = |name: &str| {
            Type::primitive_type_builder(name, physical)
                .with_repetition(Repetition::REQUIRED)
                .with_logical_type(logical.clone())
                .build()
        };
        if self.width.is_none() {
            return Ok(Arc::new(of(&self.name)?));
        }
        let list = Type::group_type_builder("list")
            .with_repetition(Repetition::REPEATED)
            .with_fields(vec![Arc::new(of("element")?)])
            .build()?;
        let column = Type::group_type_builder(&self.name)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(Some(LogicalType::List))
            .with_fields(vec![Arc::new(list)]);
        Ok(Arc::new(column.build()?))
    }

    fn write(&self, writer: &mut SerializedColumnWriter<'_>, rows: Range<usize>) -> Result<()> {
        let width = self.width.unwrap_or(1);
        let range = rows.start * width..rows.end * width;
        // Each value is there; a list begins where it does not repeat.
        let levels = self.width.map(|width| {
            let repeats = range.clone().map(|i| i16::from(i % width > 0));
            (vec![1; range.len()], repeats.collect::<Vec<i16>>())
        });
        let (there, repeats) = levels.as_ref().map(|(d, r)| (d.as_slice(), r.as_slice())).unzip();
        match &self.values {
            Values::Singles(v) => writer.typed::<FloatType>().write_batch(&v[range], there, repeats)?,
            Values::Doubles(v) => writer.typed::<DoubleType>().write_batch(&v[range], there, repeats)?,
            Values::Integers(v) => writer.typed::<Int64Type>().write_batch(&v[range], there, repeats)?,
            Values::Flags(v) => writer.typed::<BoolType>().write_batch(&v[range], there, repeats)?,
            Values::Texts(v) => {
                let texts: Vec<ByteArray> = v[range].iter().map(|text| text.as_str().into()).collect();
                writer.typed::<ByteArrayType>().write_batch(&texts, there, repeats)?
            }
        };
        Ok(())
    }
}

/// Writes `columns` in groups of so many rows; `about` is what the file says about itself.
pub(super) fn write(
    path: &Path,
    columns: &[Column],
    about: &[(&str, String)],
    groups: &[usize],
) -> Result<()> {
    let context = || format!("cannot write {}", path.display());
    let fields = columns.iter().map(Column::schema).collect::<Result<Vec<_>>>()?;
    let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
    let about = about.iter().map(|(key, value)| KeyValue::new((*key).to_owned(), value.clone()));
    let properties = WriterProperties::builder().set_key_value_metadata(Some(about.collect())).build();
    let file = File::create_new(path).with_context(context)?;
    let mut writer = SerializedFileWriter::new(file, schema, Arc::new(properties))?;
    let mut from = 0;
    for rows in groups {
        let mut group = writer.next_row_group()?;
        let mut rest = columns.iter();
        while let (Some(mut out), Some(column)) = (group.next_column()?, rest.next()) {
            column.write(&mut out, from..from + rows)?;
            out.close()?;
        }
        group.close()?;
        from += rows;
    }
    writer.close().with_context(context)?;
    Ok(())
}
