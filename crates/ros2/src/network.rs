//! The way to other nodes that a program's user names.

use crate::transport::{Transport, TransportError};
use std::net::IpAddr;

/// Network of the other nodes: DDS, or a zenoh router.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Network {
    /// `ROS_DOMAIN_ID`.
    pub domain: u16,
    /// Addresses of this PC that DDS may use; without one all of them.
    pub interfaces: Vec<IpAddr>,
    /// Their zenoh router, such as `tcp/192.168.0.200:7447`; without one they are on DDS.
    pub router: Option<String>,
    /// Name of this program for nodes behind a router.
    pub node: &'static str,
}

impl Network {
    /// Joins it; a router may come later.
    ///
    /// # Errors
    /// No socket, no such interface, a router whose address is none, or a program built without what it takes.
    pub fn join(&self) -> Result<Box<dyn Transport + Send>, TransportError> {
        self.router.as_ref().map_or_else(|| self.dds(), |router| self.zenoh(router))
    }

    #[cfg(feature = "dds")]
    fn dds(&self) -> Result<Box<dyn Transport + Send>, TransportError> {
        Ok(Box::new(crate::dds::Dds::join(self.domain, &self.interfaces)?))
    }

    #[cfg(not(feature = "dds"))]
    fn dds(&self) -> Result<Box<dyn Transport + Send>, TransportError> {
        Err(TransportError(format!("domain {} over DDS needs a build of moca-ros2 with `dds`", self.domain)))
    }

    #[cfg(feature = "zenoh")]
    fn zenoh(&self, router: &str) -> Result<Box<dyn Transport + Send>, TransportError> {
        Ok(Box::new(crate::zenoh::Zenoh::join(self.domain, router, self.node)?))
    }

    #[cfg(not(feature = "zenoh"))]
    fn zenoh(&self, router: &str) -> Result<Box<dyn Transport + Send>, TransportError> {
        Err(TransportError(format!(
            "the zenoh router {router} needs a build with zenoh: --features ros2-zenoh for mocad, zenoh for moca-ros2"
        )))
    }
}
