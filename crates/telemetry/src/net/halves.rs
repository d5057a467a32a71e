//! Halves of a connection, whatever carries it.

use tokio::io::{AsyncRead, AsyncWrite};

/// Reading half of a connection.
pub(super) type Reader = Box<dyn AsyncRead + Send + Unpin>;
/// Writing half of a connection.
pub(super) type Writer = Box<dyn AsyncWrite + Send + Unpin>;
