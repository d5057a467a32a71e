//! Transport and log.
