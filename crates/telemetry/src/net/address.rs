//! Address of a daemon: a Unix socket whose file mode decides who may connect, or a port on loopback.
//!
//! ```
//! use moca_telemetry::net::Address;
//! let port: Address = "127.0.0.1:7611".parse()?;
//! let socket: Address = "unix:/run/mocad/telemetry.sock".parse()?;
//! assert!(port.is_local() && socket.is_local());
//! assert!("localhost".parse::<Address>().is_err(), "a port is missing");
//! # Ok::<(), moca_telemetry::net::address::AddressError>(())
//! ```

use super::{
    NetError, Token,
    halves::{Reader, Writer},
    token::named_path,
    wire::Role,
};
use std::{
    env, fmt,
    fs::DirBuilder,
    io,
    net::SocketAddr,
    os::unix::fs::{DirBuilderExt, FileTypeExt, MetadataExt, PermissionsExt},
    path::{Path, PathBuf},
    str::FromStr,
    time::Duration,
};
use tokio::net::{TcpListener, TcpSocket, TcpStream, UnixListener, UnixSocket, UnixStream};

/// Folder of the packaged service's sockets.
const SERVICE_FOLDER: &str = "/run/mocad";
/// Name of the socket of operators.
pub const SOCKET_NAME: &str = "telemetry.sock";
/// Name of the socket that only shows, beside the other one.
pub const WATCH_SOCKET_NAME: &str = "watch.sock";
/// Before the path of a Unix socket.
const UNIX: &str = "unix:";
/// Before the host of a daemon over TLS.
const TLS: &str = "tls://";
/// Environment variable with the path of a client's certificate file.
pub const ACCESS_VARIABLE: &str = "MOCA_ACCESS_FILE";
/// Kernel's send buffer for one client, bytes: how far a client that stops reading falls behind before it is noticed.
const SEND_BUFFER: u32 = 128 * 1024;
/// Kernel's receive buffer for one client, bytes: with its default, megabytes of requests would grow old.
const RECEIVE_BUFFER: u32 = 64 * 1024;
/// Connections that wait to be accepted: a stop behind them must not find the queue full.
const BACKLOG: u32 = 1024;
/// Period and number of a client's attempts at a socket whose queue is full.
const QUEUE_FULL: (Duration, u32) = (Duration::from_millis(1), 500);

/// Address of a daemon: `127.0.0.1:7611`, `unix:/run/mocad/telemetry.sock` or `tls://robot:7612`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A port, reachable by every user of the machine.
    Tcp(SocketAddr),
    /// A socket file, reachable by who may write to it.
    Unix(PathBuf),
    /// A port of another machine, over TLS.
    Tls {
        /// Name or address of the machine.
        host: String,
        /// Port.
        port: u16,
    },
}

impl Address {
    /// Returns the most likely address of a daemon on this machine: the packaged service's socket if there is one, or else that of
    /// this user's own daemon.
    pub fn of_this_machine() -> Self {
        Self::in_folder_of_this_machine(SOCKET_NAME)
    }

    /// Returns the most likely address at which a daemon on this machine shows its robot and takes no request but a stop.
    pub fn of_this_machine_to_watch() -> Self {
        Self::in_folder_of_this_machine(WATCH_SOCKET_NAME)
    }

    fn in_folder_of_this_machine(name: &str) -> Self {
        let service = Path::new(SERVICE_FOLDER).join(name);
        Self::Unix(if service.exists() { service } else { user_folder().join(name) })
    }

    /// Returns the default address of a daemon that is not a service.
    pub fn of_this_user() -> Self {
        Self::Unix(user_folder().join(SOCKET_NAME))
    }

    /// The socket file that only shows, beside the one of operators; a port has none.
    pub fn watch_socket(&self) -> Option<PathBuf> {
        match self {
            Self::Tcp(_) | Self::Tls { .. } => None,
            Self::Unix(path) => Some(path.with_file_name(WATCH_SOCKET_NAME)),
        }
    }

    /// The port, if it is one of this machine.
    pub const fn tcp(&self) -> Option<SocketAddr> {
        match self {
            Self::Tcp(address) => Some(*address),
            Self::Unix(_) | Self::Tls { .. } => None,
        }
    }

    /// Returns true if only this machine reaches it.
    pub const fn is_local(&self) -> bool {
        match self {
            Self::Tcp(address) => address.ip().is_loopback(),
            Self::Unix(_) => true,
            Self::Tls { .. } => false,
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
            Self::Tls { host, port } => write!(f, "{TLS}{host}:{port}"),
        }
    }
}

/// A daemon as a client reaches it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Address of the daemon.
    pub address: Address,
    /// Role that the client asks for.
    pub role: Role,
    /// The file with the token, if the daemon asks for one; over TLS that with the certificate.
    pub token: Option<PathBuf>,
}

impl Endpoint {
    /// For a client that only reads.
    #[must_use]
    pub fn to_watch(self) -> Self {
        Self { role: Role::Observer, ..self }
    }
}

/// For an operator, with the token of [`Token::default_path`], or over TLS with the certificate of this user for that host.
impl From<Address> for Endpoint {
    fn from(address: Address) -> Self {
        let token = match &address {
            Address::Tls { host, .. } => access_file(host),
            Address::Tcp(_) | Address::Unix(_) => Token::default_path(),
        };
        Self { address, role: Role::Operator, token }
    }
}

impl From<&Address> for Endpoint {
    fn from(address: &Address) -> Self {
        address.clone().into()
    }
}

impl From<SocketAddr> for Endpoint {
    fn from(address: SocketAddr) -> Self {
        Address::Tcp(address).into()
    }
}

/// Returns the file with this user's certificate for a robot: `$MOCA_ACCESS_FILE`, or `mocad/access/HOST.pem` in
/// `$XDG_CONFIG_HOME` (`~/.config`).
pub fn access_file(host: &str) -> Option<PathBuf> {
    named_path(ACCESS_VARIABLE, &format!("access/{host}.pem"))
}

/// `$XDG_RUNTIME_DIR/mocad`, `/run/user/UID/mocad` where that variable is missing, or `mocad-UID` in the folder of
/// temporary files.
fn user_folder() -> PathBuf {
    let told = env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|folder| folder.is_absolute());
    let user = user();
    let usual = || Some(PathBuf::from(format!("/run/user/{user}"))).filter(|folder| folder.is_dir());
    told.or_else(usual)
        .map_or_else(|| env::temp_dir().join(format!("mocad-{user}")), |folder| folder.join("mocad"))
}

/// Number of the user that runs this program.
fn user() -> u32 {
    // Without /proc nobody is anybody's owner, and the folder is refused.
    std::fs::metadata("/proc/self").map_or(u32::MAX, |metadata| metadata.uid())
}

/// Makes this user's folder, and refuses one that another user could have prepared.
fn prepare_user_folder(folder: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    let there = std::fs::symlink_metadata(folder)?;
    let mode = there.mode() & 0o777;
    if there.is_dir() && there.uid() == user() && mode & 0o022 == 0 {
        return Ok(());
    }
    let why = format!("{} has mode {mode:04o} or another owner; allowed: 0700, yours", folder.display());
    Err(io::Error::new(io::ErrorKind::PermissionDenied, why))
}

/// A text that is no [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no address; allowed: HOST:PORT such as 127.0.0.1:7611, unix:/ABSOLUTE/PATH, or tls://HOST:PORT"
)]
pub struct AddressError(String);

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let wrong = || AddressError(text.into());
        if let Some(rest) = text.strip_prefix(TLS) {
            let (host, port) = rest.rsplit_once(':').ok_or_else(wrong)?;
            let named =
                host.starts_with('[') || host.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
            let port = port.parse().ok().filter(|_| named && !host.is_empty()).ok_or_else(wrong)?;
            return Ok(Self::Tls { host: host.into(), port });
        }
        match text.strip_prefix(UNIX) {
            Some(path) if path.starts_with('/') && !path.ends_with('/') => Ok(Self::Unix(path.into())),
            Some(_) => Err(wrong()),
            None => text.parse().map(Self::Tcp).map_err(|_| wrong()),
        }
    }
}

/// Connects to a daemon, over TLS with the certificate in `file`.
pub(super) async fn connect(address: &Address, file: Option<&Path>) -> io::Result<(Reader, Writer)> {
    match address {
        Address::Tcp(address) => tcp_halves(TcpStream::connect(address).await?),
        #[cfg(feature = "tls")]
        Address::Tls { host, port } => super::tls::connect(host, *port, file).await,
        #[cfg(not(feature = "tls"))]
        Address::Tls { .. } => {
            let _ = file;
            Err(io::Error::other(NetError::NoTls))
        }
        Address::Unix(path) => {
            let mut tries = 1..QUEUE_FULL.1;
            loop {
                match UnixStream::connect(path).await {
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock && tries.next().is_some() => {
                        tokio::time::sleep(QUEUE_FULL.0).await;
                    }
                    connected => return Ok(unix_halves(connected?)),
                }
            }
        }
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

/// Listener of a server. Dropping it removes its socket file.
pub(super) enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener, PathBuf),
    #[cfg(feature = "tls")]
    Tls(TcpListener),
}

/// A connection that has just been accepted.
pub(super) enum Arrived {
    /// Its halves, and its identity as far as the system knows it.
    Halves(Reader, Writer, String),
    /// It has to prove who it is first.
    #[cfg(feature = "tls")]
    Tls(TcpStream, std::net::IpAddr),
}

impl Arrived {
    /// Returns its identity as far as the system knows it.
    pub(super) fn who(&self) -> String {
        match self {
            Self::Halves(_, _, who) => who.clone(),
            #[cfg(feature = "tls")]
            Self::Tls(_, address) => format!("machine {address}"),
        }
    }
}

impl Listener {
    /// Binds; a socket file gets `mode` before anybody can find it. Needs a runtime's context.
    pub(super) fn bind(address: &Address, mode: u32) -> Result<Self, NetError> {
        let bound = match address {
            Address::Tcp(address) => bind_tcp(*address).map(Self::Tcp),
            Address::Unix(path) => bind_unix(path, mode).map(|listener| Self::Unix(listener, path.clone())),
            Address::Tls { .. } => Err(io::Error::other("a server listens on an address of its own machine")),
        };
        bound.map_err(|cause| NetError::Bind { address: address.clone(), cause })
    }

    /// Binds a port for TLS. Needs a runtime's context.
    #[cfg(feature = "tls")]
    pub(super) fn bind_tls(address: SocketAddr) -> Result<Self, NetError> {
        bind_tcp(address).map(Self::Tls).map_err(|cause| NetError::Bind { address: address.into(), cause })
    }

    /// Returns its address, with the port that the system chose.
    pub(super) fn address(&self) -> io::Result<Address> {
        match self {
            Self::Tcp(listener) => listener.local_addr().map(Address::Tcp),
            Self::Unix(_, path) => Ok(Address::Unix(path.clone())),
            #[cfg(feature = "tls")]
            Self::Tls(listener) => {
                let address = listener.local_addr()?;
                let host =
                    if address.is_ipv6() { format!("[{}]", address.ip()) } else { address.ip().to_string() };
                Ok(Address::Tls { host, port: address.port() })
            }
        }
    }

    pub(super) async fn accept(&self) -> io::Result<Arrived> {
        let ((reader, writer), who) = match self {
            Self::Tcp(listener) => (tcp_halves(listener.accept().await?.0)?, "port".to_owned()),
            Self::Unix(listener, _) => {
                let stream = listener.accept().await?.0;
                let who = stream.peer_cred().map_or("a user".to_owned(), |who| format!("user {}", who.uid()));
                (unix_halves(stream), who)
            }
            #[cfg(feature = "tls")]
            Self::Tls(listener) => {
                let (stream, from) = listener.accept().await?;
                return Ok(Arrived::Tls(stream, from.ip()));
            }
        };
        Ok(Arrived::Halves(reader, writer, who))
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
    if let Some(folder) = path.parent().filter(|folder| *folder == user_folder()) {
        prepare_user_folder(folder)?;
    }
    let mut hidden = path.as_os_str().to_owned();
    hidden.push(format!(".{}", std::process::id()));
    let hidden = PathBuf::from(hidden);
    let bound = UnixSocket::new_stream().and_then(|socket| {
        socket.bind(&hidden)?;
        // Nobody gets in before the mode is set: it listens only afterwards.
        std::fs::set_permissions(&hidden, std::fs::Permissions::from_mode(mode))?;
        let listener = socket.listen(BACKLOG)?;
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
        for text in [
            "127.0.0.1:7611",
            "[::1]:0",
            "unix:/run/mocad/telemetry.sock",
            "tls://robot-2.local:7612",
            "tls://[::1]:1",
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
        for wrong in [
            "",
            "unix:",
            "unix:relative.sock",
            "unix:/run/",
            "localhost",
            "127.0.0.1",
            "tls://robot",
            "tls://:1",
            "tls://a/b:1",
        ] {
            assert!(wrong.parse::<Address>().unwrap_err().to_string().contains("allowed"), "{wrong}");
        }
    }
}
