//! The calibration file that a session writes into.

use crate::calibration::engine::{Fitted, usable};
use anyhow::{Context, Result, ensure};
use moca_tactile::calibration::file::TaxelEntry;
use moca_tactile::calibration::{CalibrationFile, ModelKind};
use std::path::PathBuf;
use std::time::SystemTime;

/// File of the fits; an existing file keeps its other taxels.
#[derive(Clone, Debug)]
pub struct Store {
    /// The file.
    pub path: PathBuf,
    /// The board as the configuration names it.
    pub board: String,
    /// Foam under the plates, where the file is new.
    pub material: String,
}

impl Store {
    /// Writes the model of this kind and returns the taxels that the file holds now, 1 is T1.
    ///
    /// # Errors
    /// A model that no cover can use, a file of another board or sketch, the disk.
    pub fn save(&self, fitted: &Fitted, kind: ModelKind) -> Result<Vec<u8>> {
        let Self { path, board, material } = self;
        ensure!(usable(kind), "a line with an intercept reads its intercept when untouched");
        let fit = fitted.models.iter().find(|fit| fit.kind == kind).context("there is no such model")?;
        let mut file = if path.exists() {
            CalibrationFile::read(path)?
        } else {
            CalibrationFile::new(board, fitted.sketch, "", material)
        };
        ensure!(file.board == *board, "{} is of board {:?}, not {board:?}", path.display(), file.board);
        ensure!(file.sketch == fitted.sketch.name(), "{} is of sketch {}", path.display(), file.sketch);
        file.date = humantime::format_rfc3339_seconds(SystemTime::now()).to_string()[..10].to_owned();
        let number = fitted.measured.target.number;
        file.taxel.retain(|entry| entry.number != number);
        file.taxel.push(TaxelEntry::new(number, fitted.measured.rest_counts, &fit.model, &fit.quality));
        file.taxel.sort_by_key(|entry| entry.number);
        file.write(path)?;
        Ok(file.taxel.iter().filter_map(|entry| u8::try_from(entry.number).ok()).collect())
    }
}
