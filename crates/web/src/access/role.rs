//! Roles, and the table of what each may ask.
//!
//! ```
//! use moca_msgs::Request;
//! use moca_web::access::role::{Role, least_role};
//! assert_eq!(least_role(&Request::Stop), Some(Role::Viewer), "anybody may stop");
//! assert!(least_role(&Request::Arm) > Some(Role::Viewer));
//! ```

use moca_msgs::Request;
use serde::{Deserialize, Serialize};

/// Rights of a device; each role may also do what the roles before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
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
        | Request::Recentre => Some(Role::Operator),
        Request::MaskTaxel { .. } | Request::SetParameter { .. } => Some(Role::Maintainer),
        Request::OperatorLost => None,
    }
}

/// Least role that may calibrate.
pub const CALIBRATE: Role = Role::Maintainer;
/// Least role that may list and download logs.
pub const LOGS: Role = Role::Operator;
