//! Where a daemon listens: a port on loopback, or a Unix socket whose file mode says who may come in.
//!
//! ```
//! use moca_telemetry::net::Address;
//! let port: Address = "127.0.0.1:7611".parse()?;
//! let socket: Address = "unix:/run/mocad/telemetry.sock".parse()?;
//! assert!(port.is_local() && socket.is_local());
//! assert!("localhost".parse::<Address>().is_err(), "a port is missing");
//! # Ok::<(), moca_telemetry::net::address::AddressError>(())
//! ```

use super::NetError;
use std::{
    fmt, io,
    net::SocketAddr,
    os::unix::fs::{FileTypeExt, PermissionsExt},
    path::{Path, PathBuf},
    str::FromStr,
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpSocket, TcpStream, UnixListener, UnixStream},
};

/// Where the packaged service listens.
pub const SERVICE_SOCKET: &str = "/run/mocad/telemetry.sock";
/// Before the path of a Unix socket.
const UNIX: &str = "unix:";
/// What the kernel may hold for one client, bytes: what a client that stops reading can fall behind before it is noticed.
const SEND_BUFFER: u32 = 128 * 1024;
/// What the kernel may hold from one client, bytes: left to itself it lets megabytes of requests grow old.
const RECEIVE_BUFFER: u32 = 64 * 1024;
/// Connections that wait to be accepted.
const BACKLOG: u32 = 128;

/// Where a daemon listens: `127.0.0.1:7611` or `unix:/run/mocad/telemetry.sock`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A port, reachable by every user of the machine.
    Tcp(SocketAddr),
    /// A socket file, reachable by who may write to it.
    Unix(PathBuf),
}

impl Address {
    /// Where a daemon on this machine most likely listens: the packaged service's socket if there is one, or else
    /// [`super::DEFAULT_ADDRESS`].
    pub fn of_this_machine() -> Self {
        let service = Path::new(SERVICE_SOCKET);
        if service.exists() {
            return Self::Unix(service.into());
        }
        Self::Tcp(super::DEFAULT_ADDRESS)
    }

    /// The port, if it is one.
    pub const fn tcp(&self) -> Option<SocketAddr> {
        match self {
            Self::Tcp(address) => Some(*address),
            Self::Unix(_) => None,
        }
    }

    /// Whether only this machine reaches it.
    pub const fn is_local(&self) -> bool {
        match self {
            Self::Tcp(address) => address.ip().is_loopback(),
            Self::Unix(_) => true,
        }
    }
}

impl From<SocketAddr> for Address {
    fn from(address: SocketAddr) -> Self {
        Self::Tcp(address)
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
        }
    }
}

/// A text that is no [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no address; allowed: HOST:PORT such as 127.0.0.1:7611, or unix:/ABSOLUTE/PATH")]
pub struct AddressError(String);

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let wrong = || AddressError(text.into());
        match text.strip_prefix(UNIX) {
            Some(path) if path.starts_with('/') && !path.ends_with('/') => Ok(Self::Unix(path.into())),
            Some(_) => Err(wrong()),
            None => text.parse().map(Self::Tcp).map_err(|_| wrong()),
        }
    }
}

/// Reading half of a connection.
pub(super) type Reader = Box<dyn AsyncRead + Send + Unpin>;
/// Writing half of a connection.
pub(super) type Writer = Box<dyn AsyncWrite + Send + Unpin>;

/// Connects to a daemon.
pub(super) async fn connect(address: &Address) -> io::Result<(Reader, Writer)> {
    match address {
        Address::Tcp(address) => tcp_halves(TcpStream::connect(address).await?),
        Address::Unix(path) => Ok(unix_halves(UnixStream::connect(path).await?)),
    }
}

/// Without `TCP_NODELAY` Nagle's algorithm holds small messages back for tens of milliseconds: late, but served.
fn tcp_halves(stream: TcpStream) -> io::Result<(Reader, Writer)> {
    let _ = stream.set_nodelay(true);
    let (reader, writer) = stream.into_split();
    Ok((Box::new(reader), Box::new(writer)))
}

fn unix_halves(stream: UnixStream) -> (Reader, Writer) {
    let (reader, writer) = stream.into_split();
    (Box::new(reader), Box::new(writer))
}

/// What a server listens on. Dropping it removes its socket file.
pub(super) enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener, PathBuf),
}

impl Listener {
    /// Binds; a socket file gets `mode` before anybody can find it. Needs a runtime's context.
    pub(super) fn bind(address: &Address, mode: u32) -> Result<Self, NetError> {
        let bound = match address {
            Address::Tcp(address) => bind_tcp(*address).map(Self::Tcp),
            Address::Unix(path) => bind_unix(path, mode).map(|listener| Self::Unix(listener, path.clone())),
        };
        bound.map_err(|cause| NetError::Bind { address: address.clone(), cause })
    }

    /// Where it listens, with the port that the system chose.
    pub(super) fn address(&self) -> io::Result<Address> {
        match self {
            Self::Tcp(listener) => listener.local_addr().map(Address::Tcp),
            Self::Unix(_, path) => Ok(Address::Unix(path.clone())),
        }
    }

    pub(super) async fn accept(&self) -> io::Result<(Reader, Writer)> {
        match self {
            Self::Tcp(listener) => tcp_halves(listener.accept().await?.0),
            Self::Unix(listener, _) => Ok(unix_halves(listener.accept().await?.0)),
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        if let Self::Unix(_, path) = self {
            // Somebody else may have tidied up; the next daemon replaces a socket that nobody answers.
            let _ = std::fs::remove_file(path);
        }
    }
}

fn bind_tcp(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    socket.set_reuseaddr(true)?;
    // Accepted connections inherit both.
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.set_recv_buffer_size(RECEIVE_BUFFER)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Under another name first: at no moment can the socket be reached with a mode that is not its own.
fn bind_unix(path: &Path, mode: u32) -> io::Result<UnixListener> {
    if let Ok(there) = std::fs::symlink_metadata(path) {
        if !there.file_type().is_socket() {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, "there is a file that is no socket"));
        }
        if std::os::unix::net::UnixStream::connect(path).is_ok() {
            return Err(io::Error::new(io::ErrorKind::AddrInUse, "another daemon listens there"));
        }
    }
    let mut hidden = path.as_os_str().to_owned();
    hidden.push(format!(".{}", std::process::id()));
    let hidden = PathBuf::from(hidden);
    let bound = UnixListener::bind(&hidden).and_then(|listener| {
        std::fs::set_permissions(&hidden, std::fs::Permissions::from_mode(mode))?;
        std::fs::rename(&hidden, path)?;
        Ok(listener)
    });
    if bound.is_err() {
        // Whatever went wrong is told; the half-made socket need not stay.
        let _ = std::fs::remove_file(&hidden);
    }
    bound
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_shown() {
        for text in ["127.0.0.1:7611", "[::1]:0", "unix:/run/mocad/telemetry.sock"] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        for wrong in ["", "unix:", "unix:relative.sock", "unix:/run/", "localhost", "127.0.0.1"] {
            assert!(wrong.parse::<Address>().unwrap_err().to_string().contains("allowed"), "{wrong}");
        }
    }
}
