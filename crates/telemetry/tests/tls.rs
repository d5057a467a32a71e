//! Programs of other machines: certificates, the roles of their names, and those who have none.
#![cfg(all(feature = "testing", feature = "access"))]
#![allow(clippy::unwrap_used, clippy::panic, reason = "test helpers fail by panicking")]

use moca_msgs::{
    GripperRequest, Law, Mode, ParameterValues, Refusal, Request, Target, TimedTarget, TouchPolicy, Waypoint,
};
use moca_telemetry::{
    RobotDescription,
    net::{
        Address, Client, Connection, Endpoint, Link, NetError, Ports, Server, Serving, TlsPort,
        access::{Role, least_role},
        client::stop_blocking,
        request_channel, serve,
        tls::Access,
    },
};
use rtrb::RingBuffer;
use std::{
    io::{Read, Write},
    net::TcpStream,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpSocket,
};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
        version::TLS13,
    },
};

/// Only to end a test that would hang: nothing is asserted about times.
const HANG: Duration = Duration::from_secs(60);

/// A server with a port over TLS, and a loop that answers everything with yes.
struct Robot {
    server: Server,
    heard: Arc<Mutex<Vec<Request>>>,
    ended: Arc<AtomicBool>,
    ticks: Option<JoinHandle<()>>,
    folder: PathBuf,
    access: Access,
}

impl Robot {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("moca-tls-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let access = Access::open(&folder.join("access")).unwrap();
        let (mut samples, from_loop) = RingBuffer::new(4096);
        let (requests, mut asked) = request_channel();
        let ports = Ports {
            samples: from_loop,
            requests,
            ring_dropped: Arc::default(),
            recorder: None,
            calibration: None,
            judge: None,
        };
        let tls = Some(TlsPort { listen: ([127, 0, 0, 1], 0).into(), folder: folder.join("access") });
        let serving = Serving { mode: 0o600, tls, ..Serving::default() };
        let address = Address::Unix(folder.join("telemetry.sock"));
        let server = serve(&address, serving, RobotDescription::paper("test", true), ports).unwrap();
        let (heard, ended) = (Arc::<Mutex<Vec<Request>>>::default(), Arc::new(AtomicBool::new(false)));
        let (hears, ends) = (Arc::clone(&heard), Arc::clone(&ended));
        let ticks = std::thread::spawn(move || {
            let mut sample = moca_msgs::Sample { mode: Mode::Ready, ..Default::default() };
            while !ends.load(Ordering::Relaxed) {
                if let Some((ticket, request)) = asked.take() {
                    hears.lock().unwrap().push(request);
                    asked.answer(ticket, Ok(()));
                }
                sample.tick += 1;
                let _ = samples.push(sample.clone());
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self { server, heard, ended, ticks: Some(ticks), folder, access }
    }

    fn endpoint(&self, certificate: &Path) -> Endpoint {
        let address = self.server.tls_address().unwrap();
        Endpoint { token: Some(certificate.into()), ..address.into() }
    }

    fn port(&self) -> u16 {
        match self.server.tls_address() {
            Some(Address::Tls { port, .. }) => *port,
            other => panic!("{other:?}"),
        }
    }

    /// A file as a person has copied it to the other machine.
    fn certificate(&self, name: &str, role: Role) -> PathBuf {
        self.copied(name, &self.access.new_certificate(name, role).unwrap())
    }

    fn copied(&self, name: &str, pem: &str) -> PathBuf {
        let path = self.folder.join(format!("{name}.pem"));
        std::fs::write(&path, pem).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        path
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        let _ = self.ticks.take().unwrap().join();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn wait_for(mut done: impl FnMut() -> bool) {
    let until = Instant::now() + HANG;
    while !done() {
        assert!(Instant::now() < until, "this never happened");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn connect(endpoint: Endpoint) -> Connection {
    let connection = Connection::spawn(endpoint, || {}).unwrap();
    wait_for(|| matches!(connection.poll().link, Link::Up { .. }));
    connection
}

fn outcome(connection: &Connection, request: Request) -> moca_msgs::Outcome {
    connection.request(request);
    let mut outcome = None;
    wait_for(|| {
        outcome = connection.poll().replies.first().map(|reply| reply.outcome);
        outcome.is_some()
    });
    outcome.unwrap()
}

fn refused(endpoint: Endpoint) -> String {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let connected = runtime.block_on(async {
        let mut client = Client::connect(endpoint).await?;
        client.incoming.next().await?;
        Ok::<_, NetError>(())
    });
    connected.unwrap_err().to_string()
}

fn requests() -> Vec<Request> {
    let waypoint =
        Waypoint { time_s: 1.0, position_world: [0.5, 0.0, 0.5], quaternion_world: [0.0, 0.0, 0.0, 1.0] };
    let touch = TouchPolicy::default();
    vec![
        Request::Tare,
        Request::Arm,
        Request::Disarm,
        Request::SelectLaw(Law::FollowMe),
        Request::Stop,
        Request::OperatorLost,
        Request::Resume,
        Request::PressTaxel { taxel: 0, force_n: 0.0 },
        Request::MaskTaxel { taxel: 0, masked: false },
        Request::SetParameter { parameter: 0, values: ParameterValues::default() },
        Request::Target(TimedTarget {
            target: Target::Pose { position_world: [0.5, 0.0, 0.5], quaternion_world: [0.0, 0.0, 0.0, 1.0] },
            stamp_unix_ns: 0,
            age_s: 0.0,
            age_limit_s: 0.2,
            touch,
        }),
        Request::Waypoint { index: 0, count: 1, waypoint, touch },
        Request::EndTarget,
        Request::Recentre,
        Request::Gripper(GripperRequest::Stop),
    ]
}

#[test]
fn certificate_opens_what_its_role_may_and_nothing_else() {
    let robot = Robot::new("roles");
    for role in Role::ALL {
        let client = connect(robot.endpoint(&robot.certificate(role.name(), role)));
        wait_for(|| !client.poll().samples.is_empty());
        for request in requests() {
            let may = least_role(&request).is_some_and(|least| role >= least);
            let outcome = outcome(&client, request);
            assert_eq!(outcome == Err(Refusal::ReadOnly), !may, "{}: {request:?}: {outcome:?}", role.name());
        }
        client.release();
    }
    assert!(!robot.heard.lock().unwrap().contains(&Request::OperatorLost), "what no client may ask");
    // The operators' socket asks for no certificate, and may do all of it.
    let own = connect(robot.server.address().into());
    assert_eq!(outcome(&own, Request::MaskTaxel { taxel: 0, masked: false }), Ok(()));
}

#[test]
fn revoked_certificate_loses_its_connection_and_every_later_one() {
    let robot = Robot::new("revoked");
    let certificate = robot.certificate("lab-pc", Role::Operator);
    let client = connect(robot.endpoint(&certificate));
    assert_eq!(outcome(&client, Request::Arm), Ok(()));
    assert_eq!(robot.access.revoke("lab-pc").unwrap(), 1);
    wait_for(|| robot.heard.lock().unwrap().contains(&Request::OperatorLost));
    let said = refused(robot.endpoint(&certificate));
    assert!(said.contains("not on the robot's list"), "{said}");
    // A new one of the same name does not let the old one in.
    let new = robot.access.new_certificate("lab-pc", Role::Viewer).unwrap();
    assert!(refused(robot.endpoint(&certificate)).contains("not on the robot's list"));
    connect(robot.endpoint(&robot.copied("new", &new)));
    assert!(
        robot
            .access
            .new_certificate("lab-pc", Role::Viewer)
            .unwrap_err()
            .to_string()
            .contains("revoke that first")
    );
}

#[test]
fn foreign_expired_and_missing_certificates_are_refused() {
    let robot = Robot::new("foreign");
    let own = std::fs::read_to_string(robot.certificate("own", Role::Maintainer)).unwrap();
    let authority = std::fs::read_to_string(robot.folder.join("access/authority.pem")).unwrap();
    // Of another robot: neither side trusts the other.
    let other = Access::open(&robot.folder.join("other")).unwrap();
    let foreign = other.new_certificate("own", Role::Maintainer).unwrap();
    let said = refused(robot.endpoint(&robot.copied("foreign", &foreign)));
    assert!(said.contains("invalid peer certificate"), "{said}");
    let foreign = foreign
        .replace(&std::fs::read_to_string(robot.folder.join("other/authority.pem")).unwrap(), &authority);
    let said = refused(robot.endpoint(&robot.copied("posing", &foreign)));
    assert!(said.contains("UnknownCA") || said.contains("DecryptError"), "{said}");
    // By the robot's own authority, but its time is over.
    let issuer = std::fs::read_to_string(robot.folder.join("access/authority-key.pem")).unwrap();
    let (issuer, key) = (rcgen::KeyPair::from_pem(&issuer).unwrap(), rcgen::KeyPair::generate().unwrap());
    let mut by = rcgen::CertificateParams::default();
    by.distinguished_name = rcgen::DistinguishedName::new();
    by.distinguished_name.push(rcgen::DnType::CommonName, "MOCA-S programs");
    let issuer = rcgen::Issuer::new(by, issuer);
    let mut params = rcgen::CertificateParams::default();
    params.extended_key_usages = vec![rcgen::ExtendedKeyUsagePurpose::ClientAuth];
    params.not_before = time::OffsetDateTime::now_utc() - time::Duration::days(400);
    params.not_after = time::OffsetDateTime::now_utc() - time::Duration::days(1);
    let expired = params.signed_by(&key, &issuer).unwrap().pem() + &key.serialize_pem() + &authority;
    let said = refused(robot.endpoint(&robot.copied("expired", &expired)));
    assert!(said.contains("CertificateExpired"), "{said}");
    // Of the authority, but on no list.
    params.not_after = time::OffsetDateTime::now_utc() + time::Duration::days(1);
    let unlisted = params.signed_by(&key, &issuer).unwrap().pem() + &key.serialize_pem() + &authority;
    let said = refused(robot.endpoint(&robot.copied("unlisted", &unlisted)));
    assert!(said.contains("not on the robot's list"), "{said}");
    // Without TLS nothing is said.
    let mut plain = TcpStream::connect(("127.0.0.1", robot.port())).unwrap();
    plain.set_read_timeout(Some(HANG)).unwrap();
    plain.write_all(&[0, 0, 0, 2, 0, 0]).unwrap();
    let mut answer = Vec::new();
    let _ = plain.read_to_end(&mut answer);
    assert!(!answer.windows(4).any(|bytes| bytes == b"MOCA"), "{answer:?}");
    // A key that others can read is not used.
    let path = robot.copied("own", &own);
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    let said = refused(robot.endpoint(&path));
    assert!(said.contains("0644") && said.contains("chmod 600"), "{said}");
    assert!(robot.heard.lock().unwrap().is_empty());
}

#[test]
fn crowd_that_never_shakes_hands_keeps_nobody_from_stopping() {
    let robot = Robot::new("crowd");
    let crowd: Vec<_> = (0..500).map(|_| TcpStream::connect(("127.0.0.1", robot.port())).unwrap()).collect();
    assert_eq!(stop_blocking(robot.server.address()).unwrap(), Ok(()));
    drop(crowd);
    // Their second is over, and a certificate opens again.
    let client = connect(robot.endpoint(&robot.certificate("late", Role::Operator)));
    assert_eq!(outcome(&client, Request::Stop), Ok(()));
}

/// Handshakes of one machine, again and again as fast as they are ended, until this is dropped.
struct Flood {
    ended: Arc<AtomicBool>,
    tried: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

/// Handshakes of a flood at a time.
const AT_A_TIME: usize = 200;

impl Flood {
    /// Without a certificate each connection announces a handshake and sends no more of it.
    fn from(machine: [u8; 4], port: u16, certificate: Option<&ClientConfig>) -> Self {
        let (ended, tried) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
        let (ends, tries) = (Arc::clone(&ended), Arc::clone(&tried));
        let connector = certificate.map(|config| TlsConnector::from(Arc::new(config.clone())));
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async {
                let mut tasks = tokio::task::JoinSet::new();
                for _ in 0..AT_A_TIME {
                    let (tries, connector) = (Arc::clone(&tries), connector.clone());
                    tasks.spawn(async move {
                        loop {
                            let _ = stranger(machine, port, connector.as_ref()).await;
                            tries.fetch_add(1, Ordering::Relaxed);
                        }
                    });
                }
                while !ends.load(Ordering::Relaxed) {
                    tokio::time::sleep(Duration::from_millis(5)).await;
                }
            });
        });
        let flood = Self { ended, tried, thread: Some(thread) };
        flood.goes_on();
        flood
    }

    /// Waits until as many more have been ended as there are at a time.
    fn goes_on(&self) {
        let before = self.tried.load(Ordering::Relaxed);
        wait_for(|| self.tried.load(Ordering::Relaxed) >= before + AT_A_TIME);
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        let _ = self.thread.take().unwrap().join();
    }
}

/// One connection, until the robot ends it.
async fn stranger(machine: [u8; 4], port: u16, connector: Option<&TlsConnector>) -> std::io::Result<()> {
    let socket = TcpSocket::new_v4()?;
    socket.bind((machine, 0).into())?;
    let mut stream = socket.connect(([127, 0, 0, 1], port).into()).await?;
    let mut ignored = [0; 256];
    match connector {
        // The first bytes of a ClientHello of 512.
        None => {
            stream.write_all(&[0x16, 3, 1, 2, 0, 1]).await?;
            while stream.read(&mut ignored).await? > 0 {}
        }
        Some(connector) => {
            let mut stream = connector.connect("mocad".try_into().unwrap(), stream).await?;
            while stream.read(&mut ignored).await? > 0 {}
        }
    }
    Ok(())
}

/// A client that trusts the robot and shows a certificate that the robot's authority has not made.
fn unknown_certificate(robot: &Robot) -> ClientConfig {
    let key = rcgen::KeyPair::generate().unwrap();
    let certificate = rcgen::CertificateParams::default().self_signed(&key).unwrap();
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(robot.folder.join("access/authority.pem")).unwrap()).unwrap();
    let key = PrivateKeyDer::from_pem_slice(key.serialize_pem().as_bytes()).unwrap();
    ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_protocol_versions(&[&TLS13])
        .unwrap()
        .with_root_certificates(roots)
        .with_client_auth_cert(vec![certificate.der().clone()], key)
        .unwrap()
}

/// A client of another machine comes in and commands, it stops the robot, and so does anybody on the robot's own computer.
fn is_served_under(robot: &Robot, floods: &[Flood]) {
    for round in 0..5 {
        let client =
            connect(robot.endpoint(&robot.certificate(&format!("legitimate-{round}"), Role::Operator)));
        assert_eq!(outcome(&client, Request::Arm), Ok(()));
        assert_eq!(outcome(&client, Request::Stop), Ok(()));
        assert_eq!(stop_blocking(robot.server.address()).unwrap(), Ok(()));
        floods.iter().for_each(Flood::goes_on);
        assert_eq!(outcome(&client, Request::Arm), Ok(()), "it is still served");
    }
}

#[test]
fn flood_of_half_open_handshakes_locks_nobody_out() {
    let robot = Robot::new("half-open");
    let flood = |machine| Flood::from([127, 0, 0, machine], robot.port(), None);
    is_served_under(&robot, &[flood(2), flood(3)]);
}

#[test]
fn flood_of_unknown_certificates_locks_nobody_out() {
    let robot = Robot::new("unknown");
    let config = unknown_certificate(&robot);
    let flood = |machine| Flood::from([127, 0, 0, machine], robot.port(), Some(&config));
    is_served_under(&robot, &[flood(2), flood(3)]);
    wait_for(|| robot.server.stats().clients == 0);
}

#[test]
fn handshake_that_does_not_end_is_closed() {
    let robot = Robot::new("slow");
    let mut silent = TcpStream::connect(("127.0.0.1", robot.port())).unwrap();
    silent.set_read_timeout(Some(HANG)).unwrap();
    silent.write_all(&[0x16, 3, 1, 2, 0, 1]).unwrap();
    // Without a limit this read would time out, which is an error.
    assert_eq!(silent.read(&mut [0; 16]).unwrap(), 0);
}

#[test]
fn list_that_cannot_be_read_lets_nobody_in() {
    let robot = Robot::new("damaged");
    let certificate = robot.certificate("lab-pc", Role::Operator);
    let client = connect(robot.endpoint(&certificate));
    std::fs::write(robot.folder.join("access/access.json"), "{\"damaged").unwrap();
    wait_for(|| matches!(client.poll().link, Link::Down { .. }));
    assert!(refused(robot.endpoint(&certificate)).contains("not on the robot's list"));
}
