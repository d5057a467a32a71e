//! Roles, and the table of what each may ask: the same over sockets, TLS and the page of moca-web.
//!
//! ```
//! use moca_msgs::Request;
//! use moca_telemetry::net::access::{Role, least_role};
//! assert_eq!(least_role(&Request::Stop), Some(Role::Viewer), "anybody may stop");
//! assert!(least_role(&Request::Arm) > Some(Role::Viewer));
//! assert_eq!("operator".parse(), Ok(Role::Operator));
//! ```

use moca_msgs::Request;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// Rights of a person, device or program; each role may also do what the roles before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Watches and stops.
    Viewer,
    /// Also tares, selects the law, runs, resumes and downloads logs.
    Operator,
    /// Also changes parameters, takes taxels out of use and calibrates.
    Maintainer,
}

impl Role {
    /// All of them, least first.
    pub const ALL: [Self; 3] = [Self::Viewer, Self::Operator, Self::Maintainer];

    /// Name as in commands, files and on the page.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Operator => "operator",
            Self::Maintainer => "maintainer",
        }
    }
}

/// A text that is no [`Role`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no role; allowed: viewer, operator, maintainer")]
pub struct RoleError(String);

impl FromStr for Role {
    type Err = RoleError;

    fn from_str(text: &str) -> Result<Self, RoleError> {
        Self::ALL.into_iter().find(|role| role.name() == text).ok_or_else(|| RoleError(text.into()))
    }
}

/// Least role that may ask this; `None` for what no client may ask.
pub const fn least_role(request: &Request) -> Option<Role> {
    match request {
        Request::Stop => Some(Role::Viewer),
        Request::Tare
        | Request::Arm
        | Request::Disarm
        | Request::SelectLaw(_)
        | Request::Resume
        | Request::PressTaxel { .. }
        | Request::Target(_)
        | Request::Waypoint { .. }
        | Request::EndTarget
        | Request::Recentre
        | Request::Gripper(_) => Some(Role::Operator),
        Request::MaskTaxel { .. } | Request::SetParameter { .. } => Some(Role::Maintainer),
        Request::OperatorLost => None,
    }
}

/// Least role that may lead the flange along poses.
pub const TRAJECTORY: Role = Role::Operator;
/// Least role that may calibrate.
pub const CALIBRATE: Role = Role::Maintainer;
/// Least role that may list and download logs.
pub const LOGS: Role = Role::Operator;
