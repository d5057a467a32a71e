//! Several robots at a glance: a list of them in a file, and a connection to each that only watches.
//!
//! ```
//! use moca_telemetry::net::fleet::{Fleet, parse};
//! let robots = parse("[[robot]]\nname = \"one\"\naddress = \"unix:/no/such/socket\"\n")?;
//! let mut fleet = Fleet::watch(robots)?;
//! let one = &fleet.poll()[0];
//! assert!(one.entry.name == "one" && one.glance.is_none(), "nobody is there");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::{Address, Connection, Link, NetError};
use moca_msgs::{Fault, Mode, Sample, TaxelStatus};
use serde::Deserialize;
use std::time::{Duration, Instant};

/// Most robots of one list: each has a connection and a thread.
pub const ROBOTS_MAX: usize = 64;
/// Samples kept of a robot that nobody looks at: a little more than the second between two looks, 3 MB.
const SAMPLES_KEPT: usize = 1200;
/// State older than this is not shown as live.
pub const FRESH: Duration = Duration::from_secs(1);

/// A robot of the list.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Name for people.
    pub name: String,
    /// Address of its daemon.
    #[serde(deserialize_with = "address")]
    pub address: Address,
    /// Its page, such as `https://robot-2:7643/`.
    #[serde(default)]
    pub page: Option<String>,
}

/// A list that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FleetError {
    /// The text is no list of robots.
    #[error("{0}")]
    Text(String),
    /// Two robots have one name.
    #[error("two robots are called {0:?}: give each a name of its own")]
    SameName(String),
    /// The page is no address of a page.
    #[error("{0:?} is no page of a robot; allowed: https://NAME:PORT/")]
    Page(String),
    /// There are too many.
    #[error("{0} robots are listed; allowed: at most {ROBOTS_MAX}")]
    TooMany(usize),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    #[serde(default)]
    robot: Vec<Entry>,
}

fn address<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Address, D::Error> {
    String::deserialize(from)?.parse().map_err(serde::de::Error::custom)
}

/// Reads the text of a `robots.toml`: `[[robot]]` with `name`, `address` and, if it has one, `page`.
///
/// # Errors
/// Mistakes of the text, with line and column.
pub fn parse(text: &str) -> Result<Vec<Entry>, FleetError> {
    let robots = toml::from_str::<List>(text).map_err(|error| FleetError::Text(error.to_string()))?.robot;
    if robots.len() > ROBOTS_MAX {
        return Err(FleetError::TooMany(robots.len()));
    }
    for (i, robot) in robots.iter().enumerate() {
        if robots[..i].iter().any(|other| other.name == robot.name) {
            return Err(FleetError::SameName(robot.name.clone()));
        }
        if let Some(page) = robot.page.as_ref().filter(|page| !page.starts_with("https://")) {
            return Err(FleetError::Page(page.clone()));
        }
    }
    Ok(robots)
}

/// A robot at a glance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Glance {
    /// Mode of its supervisor.
    pub mode: Mode,
    /// Why it is stopped, if it is.
    pub fault: Option<Fault>,
    /// Largest force on its cover since the poll before, N; only taxels in use count.
    pub force_n: f64,
    /// Taxels that have a force.
    pub taxels_ok: usize,
    /// Taxels that it has.
    pub taxels: usize,
    /// Age of the cover's data, s; negative before the first.
    pub cover_age_s: f64,
}

/// A robot of a fleet, as far as it is known.
pub struct Watched {
    /// The list's entry.
    pub entry: Entry,
    /// Newest state; `None` while its daemon is away or silent for [`FRESH`].
    pub glance: Option<Glance>,
    /// Why there is no state.
    pub why: String,
    /// When the newest sample came.
    pub at: Option<Instant>,
    connection: Connection,
}

/// Connections to several robots. None of them asks anything, so one robot's stop never touches another.
pub struct Fleet {
    robots: Vec<Watched>,
}

impl Fleet {
    /// Connects to every robot of a list, and comes back to each that goes away.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn watch(robots: Vec<Entry>) -> Result<Self, NetError> {
        let watch = |entry: Entry| {
            let connection = Connection::keeping(SAMPLES_KEPT, entry.address.clone(), || {})?;
            Ok(Watched { entry, glance: None, why: "not connected yet".into(), at: None, connection })
        };
        Ok(Self { robots: robots.into_iter().map(watch).collect::<Result<_, NetError>>()? })
    }

    /// Every robot with what has come in since the last call. Never waits for the network.
    pub fn poll(&mut self) -> &[Watched] {
        let now = Instant::now();
        for robot in &mut self.robots {
            robot.poll(now);
        }
        &self.robots
    }
}

impl Watched {
    fn poll(&mut self, now: Instant) {
        let update = self.connection.poll();
        if let Link::Down { reason } = update.link {
            self.glance = None;
            self.why = reason;
            return;
        }
        if let Some(glance) = glance(&update.samples) {
            self.glance = Some(glance);
            self.at = Some(now);
        } else if self.at.is_none_or(|at| now.saturating_duration_since(at) > FRESH) {
            self.glance = None;
            "it sends no samples".clone_into(&mut self.why);
        }
    }
}

fn glance(samples: &[Sample]) -> Option<Glance> {
    let newest = samples.last()?;
    let forces = samples.iter().flat_map(|sample| &sample.taxels);
    let known = forces.filter(|taxel| taxel.status == TaxelStatus::Ok).map(|taxel| taxel.force_n);
    Some(Glance {
        mode: newest.mode,
        fault: newest.fault,
        force_n: known.fold(0.0, f64::max),
        taxels_ok: newest.taxels.iter().filter(|taxel| taxel.status == TaxelStatus::Ok).count(),
        taxels: newest.taxels.len(),
        cover_age_s: newest.frame_age_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::TaxelReading;

    #[test]
    fn list_with_a_mistake_is_refused_with_the_place() {
        let robot = |name: &str, more: &str| {
            format!("[[robot]]\nname = \"{name}\"\naddress = \"127.0.0.1:7611\"\n{more}")
        };
        assert_eq!(parse("").unwrap(), []);
        let two = parse(&(robot("a", "page = \"https://a:7643/\"\n") + &robot("b", ""))).unwrap();
        assert_eq!((two.len(), two[0].page.as_deref()), (2, Some("https://a:7643/")));
        for (text, said) in [
            (robot("a", "") + &robot("a", ""), "two robots are called \"a\""),
            (robot("a", "page = \"javascript:alert(1)\"\n"), "is no page of a robot"),
            (robot("a", "adress = \"x\"\n"), "unknown field `adress`"),
            ("[[robot]]\nname = \"a\"\naddress = \"localhost\"\n".into(), "is no address"),
            ("[[robot]]\nname = \"a\"\n".into(), "missing field `address`"),
            (
                (0..65).map(|i| robot(&i.to_string(), "")).collect(),
                "65 robots are listed; allowed: at most 64",
            ),
        ] {
            let error = parse(&text).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn glance_counts_forces_of_taxels_in_use_only() {
        let reading = |force_n, status| TaxelReading { force_n, status };
        let mut knocked = Sample { mode: Mode::Impedance, ..Sample::default() };
        knocked.taxels.extend([reading(30.0, TaxelStatus::Ok), reading(99.0, TaxelStatus::Stale)]);
        let mut newest = knocked.clone();
        newest.taxels[0].force_n = 1.0;
        let glance = glance(&[knocked, newest]).unwrap();
        assert_eq!((glance.force_n, glance.taxels_ok, glance.taxels), (30.0, 1, 2));
        assert_eq!(super::glance(&[]), None, "nothing new is not zero force");
    }
}
