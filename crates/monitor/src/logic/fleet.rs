//! Several robots at a glance: a row of each, and how well it is.

use moca_msgs::Mode;
use moca_telemetry::net::fleet::{Glance, Watched};

/// A robot of the list.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name.
    pub name: String,
    /// Newest state, or why there is none: never the last one of a robot that is away.
    pub seen: Result<Glance, String>,
}

impl From<&Watched> for Row {
    fn from(robot: &Watched) -> Self {
        Self { name: robot.entry.name.clone(), seen: robot.glance.ok_or_else(|| robot.why.clone()) }
    }
}

impl Row {
    /// Name of its mode.
    pub fn mode(&self) -> &'static str {
        self.seen.as_ref().map_or("away", |glance| glance.mode.name())
    }

    /// Largest force on its cover, the taxels that it has, and the age of their data.
    pub fn contact(&self) -> [String; 3] {
        match &self.seen {
            Ok(glance) if glance.taxels == 0 => ["–".into(), "no cover".into(), "–".into()],
            Ok(glance) => {
                let age_ms = glance.cover_age_s * 1e3;
                let age = if age_ms < 0.0 { "none yet".into() } else { format!("{age_ms:.0} ms old") };
                let taxels = format!("{} of {} taxels", glance.taxels_ok, glance.taxels);
                [format!("{:.1} N", glance.force_n), taxels, age]
            }
            Err(_) => std::array::from_fn(|_| "–".into()),
        }
    }

    /// Health from 0 to 1: the share of taxels with a force; nothing of a robot that is away or in a fault.
    pub fn health(&self) -> f32 {
        match &self.seen {
            Ok(glance) if glance.mode == Mode::Fault => 0.0,
            Ok(glance) if glance.taxels == 0 => 1.0,
            #[expect(clippy::cast_precision_loss, reason = "a share of some taxels")]
            Ok(glance) => glance.taxels_ok as f32 / glance.taxels as f32,
            Err(_) => 0.0,
        }
    }

    /// Fault with its remedy, or why it is away; empty of one that is well.
    pub fn trouble(&self) -> String {
        match &self.seen {
            Ok(glance) => glance.fault.map_or_else(String::new, |fault| fault.to_string()),
            Err(why) => why.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::BoardFault;

    #[test]
    fn row_shows_nothing_old_of_a_robot_that_is_away() {
        let away = Row { name: "two".into(), seen: Err("no connection".into()) };
        assert_eq!((away.mode(), away.trouble().as_str()), ("away", "no connection"));
        assert_eq!(away.contact(), ["–", "–", "–"]);
        assert!(away.health() < 0.01);
    }

    #[test]
    fn health_is_the_share_of_usable_taxels() {
        let glance =
            Glance { mode: Mode::Ready, taxels_ok: 9, taxels: 12, cover_age_s: 0.012, ..Glance::default() };
        let row = |glance| Row { name: "one".into(), seen: Ok(glance) };
        assert!((row(glance).health() - 0.75).abs() < 1e-6);
        assert_eq!(row(glance).contact(), ["0.0 N", "9 of 12 taxels", "12 ms old"]);
        let fault = Glance { mode: Mode::Fault, fault: Some(BoardFault::Lost.of(0)), ..glance };
        assert!(row(fault).health() < 0.01 && row(fault).trouble().contains(BoardFault::Lost.of(0).remedy()));
        let arm_alone = Glance { taxels: 0, taxels_ok: 0, ..glance };
        assert!((row(arm_alone).health() - 1.0).abs() < 1e-6);
        assert_eq!(row(Glance { cover_age_s: -1.0, ..glance }).contact()[2], "none yet");
    }
}
