//! Credible stiffness of the foam by the age of its calibration: foam hardens, and no measured force can show it.

use crate::config::Config;
use crate::robot::PlantKind;
use anyhow::{Context, Result};
use moca_tactile::calibration::CalibrationFile;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// Age from which on the foam may be [`AGED`] times as stiff as calibrated.
pub const VALID_FOR: Duration = Duration::from_secs(365 * 86_400);
/// Credible stiffness of an old foam, or of one without a date, over the calibrated one.
pub const AGED: f64 = 1.5;

/// Takes the foam's credible stiffness from the calibration's date where `protection.foam_credible` leaves it open, and returns a
/// sentence for the start if it is more than was calibrated. A simulated foam without a calibration is as described.
///
/// # Errors
/// A calibration file that cannot be read.
pub fn settle(config: &mut Config, now: SystemTime) -> Result<Option<String>> {
    let path = &config.board.calibration;
    let stated = config.protection.foam_credible > 0.0;
    let simulated = path.is_empty() && config.plant.kind != PlantKind::Robot;
    if stated || simulated || moca_control::barrier::curves(config).is_none() {
        return Ok(None);
    }
    let date = if path.is_empty() {
        None
    } else {
        let file = CalibrationFile::read(Path::new(path))
            .with_context(|| format!("board.calibration = {path:?}"))?;
        Some(file.date)
    };
    let days = date.as_deref().and_then(|date| days_since(date, now));
    if days.is_some_and(|days| days <= VALID_FOR.as_secs() / 86_400) {
        config.protection.foam_credible = 1.0;
        return Ok(None);
    }
    config.protection.foam_credible = AGED;
    let age = match (date.filter(|date| !date.is_empty()), days) {
        (Some(date), Some(days)) => format!("calibration of {date} is {days} days old"),
        (Some(date), None) => {
            format!("calibration has the date {date:?}, which is no day until today (YYYY-MM-DD)")
        }
        (None, _) => "calibration has no date".into(),
    };
    Ok(Some(format!(
        "the foam's {age}: it may be {AGED} times as stiff, and the base is slower for it; `mocad calibrate --check` with a force gauge or a \
         known mass renews the date, protection.foam_credible states another factor"
    )))
}

/// Whole days from a date (YYYY-MM-DD) to `now`; `None` for what is no date, and for one in the future.
fn days_since(date: &str, now: SystemTime) -> Option<u64> {
    let day = humantime::parse_rfc3339(&format!("{date}T00:00:00Z")).ok()?;
    Some(now.duration_since(day).ok()?.as_secs() / 86_400)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::BarrierReadings;
    use moca_tactile::Firmware;

    fn on(day: &str) -> SystemTime {
        humantime::parse_rfc3339(&format!("{day}T12:00:00Z")).unwrap()
    }

    fn is(value: f64, expected: f64) -> bool {
        (value - expected).abs() < 1e-12
    }

    /// Factor and sentence, for a calibration with that date.
    fn settled(date: &str, today: &str, change: fn(&mut Config)) -> (f64, Option<String>) {
        let (process, thread) = (std::process::id(), std::thread::current().id());
        let path = std::env::temp_dir().join(format!("moca-foam-{process}-{thread:?}.toml"));
        CalibrationFile::new("left", Firmware::Moca, date, "PU LD30").write(&path).unwrap();
        let mut config = Config::default();
        config.board.calibration = path.display().to_string();
        change(&mut config);
        let said = settle(&mut config, on(today)).unwrap();
        std::fs::remove_file(path).unwrap();
        (config.protection.foam_credible, said)
    }

    #[test]
    fn foam_is_as_calibrated_for_a_year() {
        assert_eq!(settled("2026-01-31", "2026-01-31", |_| ()), (1.0, None));
        assert_eq!(settled("2026-01-31", "2027-01-31", |_| ()), (1.0, None));
        let (factor, said) = settled("2026-01-31", "2027-02-01", |_| ());
        assert!(is(factor, AGED));
        assert!(said.unwrap().contains("calibration of 2026-01-31 is 366 days old"));
    }

    #[test]
    fn calibration_without_a_day_until_today_is_old() {
        for (date, words) in [("", "no date"), ("spring", "\"spring\""), ("2026-02-01", "no day until today")]
        {
            let (factor, said) = settled(date, "2026-01-31", |_| ());
            assert!(is(factor, AGED), "{date}");
            assert!(said.unwrap().contains(words), "{date}");
        }
    }

    #[test]
    fn stated_factor_and_a_barrier_that_is_off_are_left_alone() {
        assert_eq!(settled("", "2026-01-31", |config| config.protection.foam_credible = 1.2), (1.2, None));
        let off: fn(&mut Config) = |config| config.protection.contact_barrier = BarrierReadings::Off;
        assert_eq!(settled("", "2026-01-31", off), (0.0, None));
    }

    #[test]
    fn real_robot_without_a_calibration_has_an_old_foam() {
        let mut config = Config::default();
        config.protection.contact_barrier = BarrierReadings::PuLd30;
        assert_eq!(settle(&mut config, on("2026-01-31")).unwrap(), None, "a simulated foam");
        assert!(is(config.protection.foam_credible, 0.0));
        config.plant.kind = PlantKind::Robot;
        assert!(settle(&mut config, on("2026-01-31")).unwrap().unwrap().contains("no date"));
        assert!(is(config.protection.foam_credible, AGED));
    }
}
