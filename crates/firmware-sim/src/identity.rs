//! USB device descriptors.

/// Descriptors that the device returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// USB vendor.
    pub vendor: u16,
    /// USB product.
    pub product: u16,
    /// Interfaces of the configuration.
    pub interfaces: u8,
}
