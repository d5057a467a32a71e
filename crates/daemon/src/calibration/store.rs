//! The calibration file that a session writes into.

use crate::calibration::engine::{Fitted, usable};
use anyhow::{Context, Result, ensure};
use moca_tactile::calibration::file::TaxelEntry;
use moca_tactile::calibration::{CalibrationFile, ModelKind, reference_ratio, residuals};
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
    /// Temperature of this day, °C, where it is known.
    pub temperature_c: Option<f64>,
}

/// Ratio of the reference to the calibrated force, over a whole press, for which a foam is as calibrated.
pub const AS_CALIBRATED: std::ops::RangeInclusive<f64> = 0.9..=1.1;
/// Ratio of the reference to the calibrated force of a loading foam that is believed.
const LOADING: std::ops::RangeInclusive<f64> = 0.5..=2.0;

impl Store {
    /// Writes the model of this kind and returns the taxels that the file holds now, 1 is T1.
    ///
    /// # Errors
    /// A model that no cover can use, a file of another board or sketch, the disk.
    pub fn save(&self, fitted: &Fitted, kind: ModelKind) -> Result<Vec<u8>> {
        let Self { path, board, material, temperature_c } = self;
        ensure!(usable(kind), "a line with an intercept reads its intercept when untouched");
        let fit = fitted.models.iter().find(|fit| fit.kind == kind).context("there is no such model")?;
        let mut file = if path.exists() {
            CalibrationFile::read(path)?
        } else {
            CalibrationFile::new(board, fitted.sketch, "", material)
        };
        self.fits(&file, fitted)?;
        (file.date, file.temperature_c) = (today(), *temperature_c);
        let number = fitted.measured.target.number;
        file.taxel.retain(|entry| entry.number != number);
        file.taxel.push(TaxelEntry::new(number, fitted.measured.rest_counts, &fit.model, &fit.quality));
        file.taxel.sort_by_key(|entry| entry.number);
        file.write(path)?;
        Ok(file.taxel.iter().filter_map(|entry| u8::try_from(entry.number).ok()).collect())
    }

    /// Compares the file's model of a taxel with the presses that were just measured, and renews the file's date if the foam is as
    /// calibrated. `by_weight` says that the reference was a known mass, which only loads: it is compared with how the foam loaded when
    /// it was calibrated. Returns the ratio of the reference to the calibrated force.
    ///
    /// # Errors
    /// A foam that is not as calibrated, a file of another board or sketch or without this taxel, the disk; a known mass and a file that
    /// does not say how the foam loads.
    pub fn check(&self, fitted: &Fitted, by_weight: bool) -> Result<f64> {
        let mut file = CalibrationFile::read(&self.path)?;
        self.fits(&file, fitted)?;
        let number = fitted.measured.target.number;
        let entry = file.taxel.iter().find(|entry| entry.number == number);
        let entry = entry.with_context(|| format!("{} has no taxel T{number}", self.path.display()))?;
        let measured_n = residuals(&entry.model()?, std::slice::from_ref(&fitted.measured.trial));
        let expected = if by_weight { entry.loading_ratio } else { Some(1.0) };
        let expected = expected.filter(|ratio| LOADING.contains(ratio)).with_context(|| {
            format!(
                "{}: loading_ratio of T{number} must be {} to {}, got {}: calibrate the taxel again, or check it with a force gauge",
                self.path.display(),
                LOADING.start(),
                LOADING.end(),
                entry.loading_ratio.map_or("none".into(), |ratio| ratio.to_string())
            )
        })?;
        let ratio = reference_ratio(&measured_n) / expected;
        ensure!(
            AS_CALIBRATED.contains(&ratio),
            "the foam of T{number} is {ratio:.2} times as stiff as calibrated; allowed: {} to {}; calibrate the cover again, or state it \
             in protection.foam_credible",
            AS_CALIBRATED.start(),
            AS_CALIBRATED.end()
        );
        (file.date, file.temperature_c) = (today(), self.temperature_c);
        file.write(&self.path)?;
        Ok(ratio)
    }

    fn fits(&self, file: &CalibrationFile, fitted: &Fitted) -> Result<()> {
        let (path, board) = (self.path.display(), &self.board);
        ensure!(file.board == *board, "{path} is of board {:?}, not {board:?}", file.board);
        ensure!(file.sketch == fitted.sketch.name(), "{path} is of sketch {}", file.sketch);
        Ok(())
    }
}

/// Today's date, YYYY-MM-DD.
fn today() -> String {
    humantime::format_rfc3339_seconds(SystemTime::now()).to_string()[..10].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::engine::{Engine, tests::*};
    use moca_tactile::calibration::session::Target;

    #[test]
    fn known_mass_renews_calibration_of_the_same_foam_alone() {
        let target = Target { number: 1, electrode: 0 };
        let path = std::env::temp_dir().join(format!("mocad-mass-{}.toml", std::process::id()));
        let store =
            Store { path: path.clone(), board: "left".into(), material: String::new(), temperature_c: None };
        let mut engine = Engine::default();
        press(&mut engine, target);
        store.save(engine.fitted().unwrap(), ModelKind::Monotone).unwrap();
        let calibrated = CalibrationFile::read(&path).unwrap();
        let loading = calibrated.taxel[0].loading_ratio.unwrap();
        assert!((loading - 1.0).abs() < 0.01, "a foam without hysteresis: {loading}");
        CalibrationFile { date: "2020-01-01".into(), ..calibrated }.write(&path).unwrap();
        let mut check = |stiffer: f64| {
            lay(&mut engine, target, stiffer);
            store.check(engine.fitted().unwrap_or_else(|| panic!("{:?}", engine.progress())), true)
        };
        // 31.7 counts are read as 32
        let error = check(1.3).unwrap_err().to_string();
        assert!(error.contains("T1 is 1.29") && error.contains("0.9 to 1.1"), "{error}");
        assert_eq!(
            CalibrationFile::read(&path).unwrap().date,
            "2020-01-01",
            "a refused check changes nothing"
        );
        for stiffer in [0.95, 1.05] {
            let ratio = check(stiffer).unwrap();
            assert!((ratio - stiffer).abs() < 0.03, "{ratio} of {stiffer}");
        }
        assert_eq!(CalibrationFile::read(&path).unwrap().date, today());

        // A foam that took a quarter more force in than the mean of both ways; a gauge sees both.
        lay(&mut engine, target, 1.2);
        let loads = |loading_ratio| {
            let mut file = CalibrationFile::read(&path).unwrap();
            file.taxel[0].loading_ratio = loading_ratio;
            file.write(&path).unwrap();
        };
        loads(Some(1.25));
        let fitted = engine.fitted().unwrap();
        let (by_weight, by_gauge) = (store.check(fitted, true).unwrap(), store.check(fitted, false));
        assert!((by_weight - 0.96).abs() < 0.03, "{by_weight}");
        assert!(by_gauge.unwrap_err().to_string().contains("T1 is 1.2"));
        for (unknown, named) in [(None, "got none"), (Some(2.1), "got 2.1"), (Some(f64::NAN), "got NaN")] {
            loads(unknown);
            let error = store.check(fitted, true).unwrap_err().to_string();
            assert!(
                error.contains("loading_ratio of T1 must be 0.5 to 2") && error.contains(named),
                "{error}"
            );
        }
        std::fs::remove_file(path).unwrap();
    }
}
