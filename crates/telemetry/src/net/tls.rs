//! Mutual TLS for programs of other machines, in the daemon's own protocol.
//!
//! The robot has an authority of its own. Every client has a certificate by it, and the robot a list that gives each certificate a
//! name and a [role](Role). A client trusts no other authority and asks for one fixed name, so host names and addresses of the
//! robot may change. A certificate that is not on the list opens nothing: taking a line off the list ends its connections.
//!
//! ```
//! # #[cfg(feature = "access")] {
//! use moca_telemetry::net::{access::Role, tls::Access};
//! let folder = std::env::temp_dir().join(format!("moca-access-{}", std::process::id()));
//! let access = Access::open(&folder)?;
//! let pem = access.new_certificate("lab-pc", Role::Operator)?;
//! assert!(pem.contains("PRIVATE KEY"), "copy it to the other machine");
//! assert_eq!(access.people()?.values().next().map(|person| person.role), Some(Role::Operator));
//! assert_eq!(access.revoke("lab-pc")?, 1);
//! # std::fs::remove_dir_all(folder)?;
//! # }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::{
    NetError,
    access::Role,
    halves::{Reader, Writer},
};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    fs, io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};
use tokio::net::TcpStream;
use tokio_rustls::{
    TlsAcceptor, TlsConnector,
    rustls::{
        ClientConfig, RootCertStore, ServerConfig,
        crypto::{CryptoProvider, ring},
        pki_types::{CertificateDer, PrivateKeyDer, ServerName, pem::PemObject},
        server::WebPkiClientVerifier,
        version::TLS13,
    },
};

#[cfg(feature = "access")]
mod issue;
#[cfg(feature = "access")]
pub use issue::Access;

/// Port of a daemon over TLS.
pub const DEFAULT_PORT: u16 = 7612;
/// Name in every robot's certificate: its authority is the robot's own, so nothing else has to be told apart.
const SERVER_NAME: &str = "mocad";
/// Files of the robot's folder.
const AUTHORITY: &str = "authority.pem";
const SERVER: &str = "server.pem";
const SERVER_KEY: &str = "server-key.pem";
const PEOPLE: &str = "access.json";
/// Pause before the list is read again for a connection.
const LIST_EVERY: Duration = Duration::from_millis(250);

/// A person or program that may come in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Person {
    /// Name; unique.
    pub name: String,
    /// Its rights.
    pub role: Role,
    /// End of its certificate, s since the Unix epoch; 0 in a list of an earlier version, which has none.
    #[serde(default)]
    pub ends_unix_s: u64,
}

/// People by the hash of their certificate.
pub type People = BTreeMap<String, Person>;

fn wrong(path: &Path) -> impl Fn(&dyn std::fmt::Display) -> NetError {
    move |why| NetError::Access { path: path.into(), why: why.to_string() }
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

fn read(path: &Path) -> Result<String, NetError> {
    fs::read_to_string(path).map_err(|error| wrong(path)(&error))
}

/// Reads a file with a key, which only its owner may open.
fn read_private(path: &Path) -> Result<String, NetError> {
    let mode = fs::metadata(path).map_err(|error| wrong(path)(&error))?.mode() & 0o777;
    if mode & 0o077 != 0 {
        let why = format!("mode {mode:04o}; allowed: 0600, so that only its owner reads it: chmod 600");
        return Err(wrong(path)(&why));
    }
    read(path)
}

fn people(folder: &Path) -> Result<People, NetError> {
    let path = folder.join(PEOPLE);
    match fs::read_to_string(&path) {
        Ok(text) => serde_json::from_str(&text).map_err(|error| wrong(&path)(&error)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(People::new()),
        Err(error) => Err(wrong(&path)(&error)),
    }
}

fn fingerprint(certificate: &CertificateDer<'_>) -> String {
    blake3::hash(certificate).to_hex().to_string()
}

/// The certificate of a client that has come in.
pub(super) struct Proof {
    fingerprint: String,
    folder: PathBuf,
    person: Option<Person>,
}

impl Proof {
    fn new(certificate: &CertificateDer<'_>, folder: &Path) -> Self {
        let mut proof = Self { fingerprint: fingerprint(certificate), folder: folder.into(), person: None };
        proof.person = proof.listed();
        proof
    }

    /// The person that the list gives it to now; none for one that is not on it, or without a list.
    fn listed(&self) -> Option<Person> {
        people(&self.folder).ok()?.remove(&self.fingerprint)
    }

    /// The role that the list gave it when it came in.
    pub(super) fn role(&self) -> Option<Role> {
        self.person.as_ref().map(|person| person.role)
    }

    /// The name that the list gave it when it came in.
    pub(super) fn name(&self) -> Option<&str> {
        self.person.as_ref().map(|person| person.name.as_str())
    }

    /// Ends once the list gives it another role, or none.
    pub(super) async fn is_over(&self) {
        while self.listed() == self.person {
            tokio::time::sleep(LIST_EVERY).await;
        }
    }
}

/// The robot's side of TLS.
pub(super) struct Gate {
    acceptor: TlsAcceptor,
    folder: PathBuf,
}

impl Gate {
    /// Reads the robot's folder.
    pub(super) fn open(folder: &Path) -> Result<Self, NetError> {
        let bad = |error: &dyn std::fmt::Display| wrong(folder)(error);
        let authority = read(&folder.join(AUTHORITY))?;
        let verifier =
            WebPkiClientVerifier::builder_with_provider(Arc::new(roots(&authority, folder)?), provider());
        let verifier = verifier.build().map_err(|error| bad(&error))?;
        let server = read(&folder.join(SERVER))?;
        let chain = CertificateDer::pem_slice_iter(server.as_bytes()).collect::<Result<Vec<_>, _>>();
        let key = read_private(&folder.join(SERVER_KEY))?;
        let key = PrivateKeyDer::from_pem_slice(key.as_bytes()).map_err(|error| bad(&error))?;
        let mut config = ServerConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&TLS13])
            .map_err(|error| bad(&error))?
            .with_client_cert_verifier(verifier)
            .with_single_cert(chain.map_err(|error| bad(&error))?, key)
            .map_err(|error| bad(&error))?;
        // No session goes on with a certificate that has ended meanwhile.
        config.send_tls13_tickets = 0;
        people(folder)?;
        Ok(Self { acceptor: TlsAcceptor::from(Arc::new(config)), folder: folder.into() })
    }

    /// Shakes hands with a client that has a certificate by the robot's authority.
    pub(super) async fn let_in(&self, stream: TcpStream) -> Result<(Reader, Writer, Proof), NetError> {
        let _ = stream.set_nodelay(true);
        let stream = self.acceptor.accept(stream).await?;
        let certificate = stream.get_ref().1.peer_certificates().and_then(|chain| chain.first());
        let proof = Proof::new(certificate.ok_or(NetError::Closed)?, &self.folder);
        let (reader, writer) = tokio::io::split(stream);
        Ok((Box::new(reader), Box::new(writer), proof))
    }
}

fn roots(pem: &str, path: &Path) -> Result<RootCertStore, NetError> {
    let mut roots = RootCertStore::empty();
    // A client's file begins with its own certificate, and the authority is the last one.
    let authority = CertificateDer::pem_slice_iter(pem.as_bytes()).last();
    let authority = authority.ok_or_else(|| wrong(path)(&"no certificate of a robot's authority in it"))?;
    let authority = authority.map_err(|error| wrong(path)(&error))?;
    roots.add(authority).map_err(|error| wrong(path)(&error))?;
    Ok(roots)
}

/// Connects to a daemon with the certificate in `file`.
pub(super) async fn connect(host: &str, port: u16, file: Option<&Path>) -> io::Result<(Reader, Writer)> {
    let file = file
        .ok_or_else(|| io::Error::other("no certificate: set MOCA_ACCESS_FILE, there is no home folder"))?;
    let config = client(file).map_err(io::Error::other)?;
    let stream = TcpStream::connect((host.trim_matches(['[', ']']), port)).await?;
    let _ = stream.set_nodelay(true);
    let name = ServerName::try_from(SERVER_NAME).map_err(io::Error::other)?;
    let stream = TlsConnector::from(Arc::new(config)).connect(name, stream).await?;
    let (reader, writer) = tokio::io::split(stream);
    Ok((Box::new(reader), Box::new(writer)))
}

fn client(path: &Path) -> Result<ClientConfig, NetError> {
    let bad = |error: &dyn std::fmt::Display| wrong(path)(error);
    let pem = read_private(path)?;
    let own = CertificateDer::from_pem_slice(pem.as_bytes()).map_err(|error| bad(&error))?;
    let key = PrivateKeyDer::from_pem_slice(pem.as_bytes()).map_err(|error| bad(&error))?;
    ClientConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&TLS13])
        .map_err(|error| bad(&error))?
        .with_root_certificates(roots(&pem, path)?)
        .with_client_auth_cert(vec![own], key)
        .map_err(|error| bad(&error))
}
