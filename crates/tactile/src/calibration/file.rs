//! Calibration files: TOML that names its schema, board, sketch, date and material. Whatever does not fit the cover
//! it is applied to is an error; nothing falls back to a default.

use super::Quality;
use crate::CoverConfig;
use crate::Firmware;
use crate::model::{CompensatedCurve, CurveError, MonotoneCurve, TaxelModel};
use crate::zero::{ExpectedRest, LINEAR_MIN, OPEN_MIN, REST_RANGE_COUNTS};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// Version of the file's layout; another one is refused.
pub const SCHEMA_VERSION: u32 = 1;
/// Steepest slope that is believed, N per count (100 N over a single count).
const NEWTON_PER_COUNT_MAX: f64 = 100.0;
/// Widest range of a taxel's rest that is believed, counts: a fifth of what a stock board reads untouched.
const REST_RANGE_MAX: f64 = 144.0;

/// A calibrated cover, or the part of it on one board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationFile {
    /// [`SCHEMA_VERSION`].
    pub schema: u32,
    /// Identity of the board as the daemon's configuration names it (its `/dev/serial/by-path`: serial numbers are
    /// empty).
    pub board: String,
    /// Firmware of the board: `moca`, `stock-2018`, `stock-2015` or `pi-cap`.
    pub sketch: String,
    /// Day of the calibration, or of the last check against a force gauge, YYYY-MM-DD.
    pub date: String,
    /// Temperature on that day, °C, where it is known: a cold foam is stiffer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Foam under the plates.
    pub material: String,
    /// One entry a taxel.
    pub taxel: Vec<TaxelEntry>,
}

/// Calibration of one taxel and how good it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaxelEntry {
    /// 1 is T1.
    pub number: usize,
    /// FDAT at rest, counts.
    pub rest_counts: f64,
    /// A tare within this distance of it is believed, counts.
    #[serde(default = "rest_range")]
    pub rest_range_counts: f64,
    /// Samples of the fit.
    pub samples: usize,
    /// RMSE over everything, N.
    pub rmse_n: f64,
    /// RMSE while the force rose, N.
    pub rmse_loading_n: f64,
    /// RMSE while it fell, N.
    pub rmse_unloading_n: f64,
    /// Reference over modelled force while the force rose: a foam takes more force in than it gives back. A known weight only loads,
    /// and is compared with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub loading_ratio: Option<f64>,
    /// Valid up to these counts below rest.
    pub counts_max: f64,
    /// Valid up to this force, N.
    pub force_max_n: f64,
    /// The model.
    pub model: StoredModel,
}

const fn rest_range() -> f64 {
    REST_RANGE_COUNTS
}

/// A [`TaxelModel`] as stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum StoredModel {
    /// F = slope · counts.
    LineThroughZero {
        /// N per count.
        newton_per_count: f64,
    },
    /// The paper's line; for reporting, and refused by [`CalibrationFile::apply`].
    LineWithIntercept {
        /// N per count.
        newton_per_count: f64,
        /// N at rest.
        intercept_n: f64,
    },
    /// Monotone curve.
    Monotone {
        /// \[counts, N\] in rising order; (0, 0) is implied.
        knots: Vec<[f64; 2]>,
    },
    /// Curve with foam memory.
    Compensated {
        /// \[counts, N\] of the elastic curve.
        knots: Vec<[f64; 2]>,
        /// Relaxing shares.
        share: [f64; 3],
    },
}

impl From<&TaxelModel> for StoredModel {
    fn from(model: &TaxelModel) -> Self {
        match *model {
            TaxelModel::LineThroughZero { newton_per_count } => Self::LineThroughZero { newton_per_count },
            TaxelModel::LineWithIntercept { newton_per_count, intercept_n } => {
                Self::LineWithIntercept { newton_per_count, intercept_n }
            }
            TaxelModel::Monotone(curve) => Self::Monotone { knots: curve.knots().collect() },
            TaxelModel::Compensated(curve) => {
                Self::Compensated { knots: curve.elastic().knots().collect(), share: curve.share() }
            }
        }
    }
}

/// Why a file cannot be used.
#[derive(Debug)]
pub enum FileError {
    /// The operating system refused.
    Io {
        /// The file.
        path: PathBuf,
        /// Its answer.
        error: std::io::Error,
    },
    /// A calibration with a key or value that does not belong there; the message has line and column.
    Syntax(String),
    /// Something else: nothing of it is quoted, for it may be secret.
    NotACalibration {
        /// Why it is none.
        why: String,
    },
    /// Another [`SCHEMA_VERSION`].
    Schema {
        /// In the file.
        found: u32,
    },
    /// A value that cannot be.
    Value {
        /// 1 is T1.
        taxel: usize,
        /// Name of the value, and its range.
        what: String,
    },
    /// The file belongs to something else.
    Mismatch {
        /// `board` or `sketch`.
        what: &'static str,
        /// Configured or measured.
        expected: String,
        /// In the file.
        found: String,
    },
    /// The file lacks this taxel, has it twice, or has one that the cover has not (1 is T1).
    Taxels(usize),
}

impl core::fmt::Display for FileError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Io { path, error } => write!(f, "calibration file {}: {error}", path.display()),
            Self::Syntax(text) => write!(f, "calibration file: {text}"),
            Self::NotACalibration { why } => write!(
                f,
                "not a calibration file: {why}; name a file that `mocad calibrate` or the dashboard wrote"
            ),
            Self::Schema { found } => write!(
                f,
                "calibration file has schema {found}, this program reads schema {SCHEMA_VERSION}: calibrate again"
            ),
            Self::Value { taxel, what } => write!(f, "calibration of T{taxel}: {what}"),
            Self::Mismatch { what, expected, found } => write!(
                f,
                "calibration was made for {what} {found:?}, but the cover has {expected:?}: use its own file or \
                 calibrate again"
            ),
            Self::Taxels(taxel) => write!(
                f,
                "calibration must hold every taxel of the cover exactly once; T{taxel} is missing, double or \
                 unknown"
            ),
        }
    }
}

impl std::error::Error for FileError {}

impl TaxelEntry {
    /// Builds the entry of taxel `number` (1 is T1) from a fit.
    pub fn new(number: usize, rest_counts: f64, model: &TaxelModel, quality: &Quality) -> Self {
        Self {
            number,
            rest_counts,
            rest_range_counts: REST_RANGE_COUNTS,
            samples: quality.samples,
            rmse_n: quality.rmse_n,
            rmse_loading_n: quality.rmse_loading_n,
            rmse_unloading_n: quality.rmse_unloading_n,
            loading_ratio: Some(quality.loading_ratio),
            counts_max: quality.counts_max,
            force_max_n: quality.force_max_n,
            model: model.into(),
        }
    }

    /// Returns the taxel's reading at rest, checked.
    pub fn expected_rest(&self) -> Result<ExpectedRest, FileError> {
        let within = |what: &str, value: f64, low: f64, high: f64| {
            let what = || std::format!("{what} must be {low} to {high} counts, got {value}");
            if value >= low && value <= high {
                Ok(value)
            } else {
                Err(FileError::Value { taxel: self.number, what: what() })
            }
        };
        Ok(ExpectedRest {
            counts: within("rest_counts", self.rest_counts, LINEAR_MIN, OPEN_MIN)?,
            range_counts: within("rest_range_counts", self.rest_range_counts, 1.0, REST_RANGE_MAX)?,
        })
    }

    /// The model, checked.
    pub fn model(&self) -> Result<TaxelModel, FileError> {
        let value = |what: String| FileError::Value { taxel: self.number, what };
        let curve = |error: CurveError| value(error.to_string());
        let slope = |newton_per_count: f64| {
            if newton_per_count > 0.0 && newton_per_count <= NEWTON_PER_COUNT_MAX {
                Ok(newton_per_count)
            } else {
                Err(value(std::format!(
                    "newton_per_count must be above 0 and at most {NEWTON_PER_COUNT_MAX} N per count, got \
                     {newton_per_count}"
                )))
            }
        };
        Ok(match &self.model {
            StoredModel::LineThroughZero { newton_per_count } => {
                TaxelModel::LineThroughZero { newton_per_count: slope(*newton_per_count)? }
            }
            StoredModel::LineWithIntercept { .. } => {
                return Err(value(
                    "a line with intercept reads its intercept when untouched; it is for reporting, choose \
                     line-through-zero, monotone or compensated"
                        .to_string(),
                ));
            }
            StoredModel::Monotone { knots } => {
                TaxelModel::Monotone(MonotoneCurve::new(knots).map_err(curve)?)
            }
            StoredModel::Compensated { knots, share } => {
                let elastic = MonotoneCurve::new(knots).map_err(curve)?;
                TaxelModel::Compensated(CompensatedCurve::new(elastic, *share).map_err(curve)?)
            }
        })
    }
}

impl CalibrationFile {
    /// An empty calibration of today's schema.
    pub fn new(board: &str, sketch: Firmware, date: &str, material: &str) -> Self {
        Self {
            schema: SCHEMA_VERSION,
            board: board.to_string(),
            sketch: sketch.name().to_string(),
            date: date.to_string(),
            temperature_c: None,
            material: material.to_string(),
            taxel: Vec::new(),
        }
    }

    /// Reads and checks the layout of a file.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let text =
            super::read_text(path).map_err(|error| FileError::Io { path: path.to_path_buf(), error })?;
        Self::parse(&text)
    }

    /// Parses a text. The schema is checked first, so that an old file is called old, not wrong, and so that nothing of a file
    /// that is no calibration gets into an error.
    pub fn parse(text: &str) -> Result<Self, FileError> {
        let place = |error: &toml::de::Error| {
            let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or("");
            let line = 1 + before.bytes().filter(|&byte| byte == b'\n').count();
            std::format!(
                "line {line}, column {}",
                1 + before.chars().rev().take_while(|&c| c != '\n').count()
            )
        };
        let table = toml::from_str::<toml::Table>(text).map_err(|error| FileError::NotACalibration {
            why: std::format!("{} is not TOML", place(&error)),
        })?;
        let schema = table.get("schema").and_then(toml::Value::as_integer);
        let Some(found) = schema.and_then(|schema| u32::try_from(schema).ok()) else {
            return Err(FileError::NotACalibration { why: "it has no schema = 1".to_string() });
        };
        if found != SCHEMA_VERSION {
            return Err(FileError::Schema { found });
        }
        toml::from_str(text).map_err(|error: toml::de::Error| {
            FileError::Syntax(std::format!("{}: {}", place(&error), error.message()))
        })
    }

    /// The file's text.
    pub fn to_toml(&self) -> Result<String, FileError> {
        toml::to_string(self).map_err(|error| FileError::Syntax(error.to_string()))
    }

    /// Writes the file whole: beside it first, then over it.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        let io = |error| FileError::Io { path: path.to_path_buf(), error };
        let beside = path.with_extension("toml.new");
        std::fs::write(&beside, self.to_toml()?).map_err(io)?;
        std::fs::rename(&beside, path).map_err(io)
    }

    /// The firmware that the calibration was made with.
    pub fn firmware(&self) -> Result<Firmware, FileError> {
        Firmware::named(&self.sketch).ok_or_else(|| FileError::Mismatch {
            what: "sketch",
            expected: "moca, stock-2018, stock-2015 or pi-cap".to_string(),
            found: self.sketch.clone(),
        })
    }

    /// Puts the models into `config` for a cover whose board is called `board`. The sketch is compared when the
    /// board has spoken: another one is then [`moca_msgs::BoardFault::CalibrationMismatch`].
    pub fn apply<const K: usize>(&self, board: &str, config: &mut CoverConfig<K>) -> Result<(), FileError> {
        if self.board != board {
            return Err(FileError::Mismatch {
                what: "board",
                expected: board.to_string(),
                found: self.board.clone(),
            });
        }
        let mut models = [None; K];
        for entry in &self.taxel {
            let place = entry.number.checked_sub(1).filter(|i| *i < config.taxels);
            let slot = place.and_then(|i| models.get_mut(i));
            match slot {
                Some(slot) if slot.is_none() => *slot = Some((entry.model()?, entry.expected_rest()?)),
                _ => return Err(FileError::Taxels(entry.number)),
            }
        }
        if let Some(missing) = models.iter().take(config.taxels).position(Option::is_none) {
            return Err(FileError::Taxels(missing + 1));
        }
        let generation = self.firmware()?;
        for (i, (model, expected)) in models.into_iter().flatten().enumerate() {
            config.models[i] = model;
            config.expected_rest[i] = Some(expected);
        }
        config.calibrated_firmware = Some(generation);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> CalibrationFile {
        let quality = Quality {
            samples: 700,
            rmse_n: 2.5,
            rmse_loading_n: 2.0,
            rmse_unloading_n: 3.0,
            loading_ratio: 1.1,
            worst_n: 9.0,
            counts_max: 84.0,
            force_max_n: 100.0,
        };
        let curve = MonotoneCurve::new(&[[4.0, 5.0], [84.0, 100.0]]).unwrap();
        let models = [
            TaxelModel::PAPER,
            TaxelModel::Monotone(curve),
            TaxelModel::Compensated(CompensatedCurve::new(curve, [0.1, 0.0, 0.05]).unwrap()),
        ];
        let mut file = CalibrationFile::new("left", Firmware::Stock2018, "2026-11-21", "PU LD30");
        for (i, model) in models.iter().enumerate() {
            file.taxel.push(TaxelEntry::new(i + 1, 719.6, model, &quality));
        }
        file
    }

    #[test]
    fn a_file_comes_back_as_it_was_written_and_configures_its_cover() {
        let file = file();
        let back = CalibrationFile::parse(&file.to_toml().unwrap()).unwrap();
        assert_eq!(back, file);
        let mut config = CoverConfig::<3>::default();
        back.apply("left", &mut config).unwrap();
        assert_eq!(StoredModel::from(&config.models[2]), file.taxel[2].model);
        assert_eq!(config.calibrated_firmware, Some(Firmware::Stock2018));
        assert_eq!(config.expected_rest[2], Some(ExpectedRest { counts: 719.6, range_counts: 10.0 }));
        let older = file.to_toml().unwrap().replace("rest_range_counts = 10.0\n", "");
        assert_eq!(
            CalibrationFile::parse(&older).unwrap(),
            file,
            "a file without the range means the usual one"
        );
    }

    fn message<const K: usize>(file: &CalibrationFile, board: &str) -> String {
        file.apply(board, &mut CoverConfig::<K>::default()).unwrap_err().to_string()
    }

    #[test]
    fn whatever_does_not_fit_is_an_error_that_says_so() {
        let mut file = file();
        assert!(message::<3>(&file, "right").contains("made for board \"left\""));
        assert!(message::<4>(&file, "left").contains("T4 is missing"));
        assert!(message::<2>(&file, "left").contains("T3"));
        file.taxel[1].number = 1;
        assert!(message::<3>(&file, "left").contains("T1"));
        file.taxel[1].number = 2;
        file.taxel[0].model = StoredModel::LineThroughZero { newton_per_count: f64::NAN };
        assert!(message::<3>(&file, "left").contains("newton_per_count must be above 0"));
        file.taxel[0].model = StoredModel::LineWithIntercept { newton_per_count: 1.29, intercept_n: 7.1 };
        assert!(message::<3>(&file, "left").contains("for reporting"));
        file.taxel[0].model = StoredModel::Monotone { knots: Vec::new() };
        assert!(message::<3>(&file, "left").contains("1 to 16 knots"));
        file.taxel[0].model = file.taxel[1].model.clone();
        file.taxel[0].rest_range_counts = f64::NAN;
        assert!(message::<3>(&file, "left").contains("rest_range_counts must be 1 to 144 counts, got NaN"));
        file.taxel[0].rest_counts = 100.0;
        assert!(message::<3>(&file, "left").contains("rest_counts must be 217 to 1000 counts, got 100"));
    }

    #[test]
    fn file_that_is_no_calibration_is_not_quoted() {
        for secret in [
            "root:$y$secret$hash:19000:0:99999:7:::\n",
            "secret\n",
            "secret = \"hash\"\n",
            "[secret]\nhash = 1\n",
            "schema = \"secret hash\"\n",
            "schema = secret-hash\n",
            "key = 1\nsecret-hash\n",
            "\"secret\\uhash\" = 1",
        ] {
            let said = CalibrationFile::parse(secret).unwrap_err().to_string();
            assert!(said.starts_with("not a calibration file: "), "{said}");
            assert!(!said.contains("secret") && !said.contains("hash"), "{said}");
        }
    }

    #[test]
    fn other_schemas_unknown_keys_and_garbage_are_refused() {
        let text = file().to_toml().unwrap();
        let parse = |text: &str| CalibrationFile::parse(text).unwrap_err().to_string();
        assert!(parse(&text.replace("schema = 1", "schema = 2")).contains("schema 2"));
        assert!(parse(&text.replace("material", "materiel")).contains("materiel"));
        assert!(parse("").contains("schema"));
        assert!(parse("\u{0}").contains("calibration file"));
        assert!(
            parse(&text.replace("rmse_n = ", "rmse_n = \"x\" #"))
                .contains("line 12, column 10: invalid type")
        );
        let mut file = file();
        file.sketch = "2031".to_string();
        assert!(message::<3>(&file, "left").contains("2031"));
        assert!(
            CalibrationFile::read(Path::new("/no/such.toml"))
                .unwrap_err()
                .to_string()
                .contains("/no/such.toml")
        );
    }
}
