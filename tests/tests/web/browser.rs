//! A browser for tests: requests and a page's socket, as a friendly or hostile program would write them.

use futures_util::{SinkExt, StreamExt};
use moca_web::access::{Role, devices::Store};
use rustls::{
    ClientConfig, RootCertStore,
    pki_types::{CertificateDer, ServerName, pem::PemObject},
};
use serde_json::{Value, json};
use std::{net::SocketAddr, path::Path, sync::Arc, time::Duration};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpSocket, TcpStream},
    time::timeout,
};
use tokio_rustls::{TlsConnector, client::TlsStream};
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{Error, Message, http},
};

/// Ends a test that would hang; no test passes or fails by how long something took before this.
pub(crate) const HANGS_AFTER: Duration = Duration::from_secs(60);
/// Name under which the gateway of a test is reached.
pub(crate) const HOST: &str = "localhost";

/// A browser that trusts the robot's authority.
#[derive(Clone)]
pub(crate) struct Browser {
    pub(crate) address: SocketAddr,
    connector: TlsConnector,
    /// Address that it comes from, on loopback.
    pub(crate) from: [u8; 4],
    pub(crate) token: String,
    pub(crate) host: String,
    pub(crate) origin: Option<String>,
}

impl Browser {
    pub(crate) fn new(address: SocketAddr, state: &Path) -> Self {
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from_pem_file(state.join("authority.pem")).unwrap()).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config =
            ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
        let config = config.with_root_certificates(roots).with_no_client_auth();
        let host = format!("{HOST}:{}", address.port());
        let (connector, origin) = (TlsConnector::from(Arc::new(config)), Some(format!("https://{host}")));
        Self { address, connector, from: [127, 0, 0, 1], token: String::new(), host, origin }
    }

    /// One that has paired itself with a code from the robot.
    pub(crate) async fn paired(address: SocketAddr, state: &Path, role: Role, name: &str) -> Self {
        let code = Store::open(state).unwrap().new_code(role).unwrap();
        let mut browser = Self::new(address, state);
        let answer = browser.pair(&code, name).await;
        assert_eq!(answer.status, 200, "{}", answer.text);
        browser.token = answer.cookie().expect("a cookie");
        browser
    }

    pub(crate) async fn connect(&self) -> TlsStream<TcpStream> {
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(16 * 1024).unwrap();
        socket.bind((self.from, 0).into()).unwrap();
        let stream = socket.connect(self.address).await.unwrap();
        self.connector.connect(ServerName::try_from(HOST).unwrap(), stream).await.unwrap()
    }

    pub(crate) async fn pair(&self, code: &str, name: &str) -> Answer {
        self.send("POST", "/pair", &json!({"code": code, "name": name}).to_string()).await
    }

    pub(crate) async fn get(&self, path: &str) -> Answer {
        self.send("GET", path, "").await
    }

    pub(crate) async fn send(&self, method: &str, path: &str, body: &str) -> Answer {
        let origin = self.origin.as_ref().map_or_else(String::new, |origin| format!("Origin: {origin}\r\n"));
        let request = format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nCookie: __Host-moca={}\r\n{origin}Content-Type: application/json\r\n\
             Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
            self.host,
            self.token,
            body.len()
        );
        let exchange = async {
            let mut stream = self.connect().await;
            stream.write_all(request.as_bytes()).await.unwrap();
            let mut bytes = Vec::new();
            // A server that closes without saying so has answered all the same.
            let _ = stream.read_to_end(&mut bytes).await;
            String::from_utf8_lossy(&bytes).into_owned()
        };
        Answer::new(timeout(HANGS_AFTER, exchange).await.expect("an answer"))
    }

    /// A page, or the status with which it is refused.
    pub(crate) async fn page(&self) -> Result<Page, u16> {
        let mut request = http::Request::get(format!("wss://{}/socket", self.host))
            .header("Host", &self.host)
            .header("Cookie", format!("__Host-moca={}", self.token))
            .header("Connection", "Upgrade")
            .header("Upgrade", "websocket")
            .header("Sec-WebSocket-Version", "13")
            .header("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ==");
        if let Some(origin) = &self.origin {
            request = request.header("Origin", origin);
        }
        match client_async(request.body(()).unwrap(), self.connect().await).await {
            Ok((socket, _)) => Ok(Page {
                socket,
                n: 0,
                press: 0,
                drawn: 0,
                picture: Vec::new(),
                state: json!({}),
                replies: vec![],
            }),
            Err(Error::Http(refused)) => Err(refused.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }
}

/// An answer to a request.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) text: String,
}

impl Answer {
    fn new(text: String) -> Self {
        let status = text.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Self { status, text }
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let head = self.text.split("\r\n\r\n").next()?;
        head.lines().find_map(|line| {
            let (found, value) = line.split_once(": ")?;
            found.eq_ignore_ascii_case(name).then_some(value)
        })
    }

    fn cookie(&self) -> Option<String> {
        let cookie = self.header("set-cookie")?;
        assert!(cookie.contains("; Secure; HttpOnly; SameSite=Strict;"), "{cookie}");
        Some(cookie.split(';').next()?.strip_prefix("__Host-moca=")?.to_owned())
    }
}

/// A page's socket.
pub(crate) struct Page {
    socket: WebSocketStream<TlsStream<TcpStream>>,
    pub(crate) n: u32,
    pub(crate) press: u32,
    /// Newest picture that the page says it has drawn.
    pub(crate) drawn: u32,
    picture: Vec<u8>,
    pub(crate) state: Value,
    pub(crate) replies: Vec<Value>,
}

impl Page {
    /// Says something, true or not.
    pub(crate) async fn say(&mut self, text: &str) {
        // A gateway that has hung up is met by the next read.
        let _ = self.socket.send(Message::text(text)).await;
    }

    pub(crate) async fn beat(&mut self) {
        self.n += 1;
        let text = json!({"t": "beat", "n": self.n, "drawn": self.drawn, "press": self.press}).to_string();
        self.say(&text).await;
    }

    pub(crate) async fn ask(&mut self, what: Value) {
        self.n += 1;
        let text = json!({"t": "ask", "n": self.n, "drawn": self.drawn, "what": what}).to_string();
        self.say(&text).await;
    }

    pub(crate) async fn stop(&mut self, stop: u32) {
        self.say(&json!({"t": "stop", "stop": stop}).to_string()).await;
    }

    fn number(&self, at: usize) -> u32 {
        self.picture.get(at..at + 4).map_or(0, |bytes| u32::from_le_bytes(bytes.try_into().unwrap()))
    }

    pub(crate) fn mode(&self) -> &str {
        self.state["mode"].as_str().unwrap_or_default()
    }

    /// Distance between the gripper's fingers, mm, mass of the object, kg, and number of the phase.
    pub(crate) fn gripper(&self) -> Option<(f32, f32, u8)> {
        let shown = self.picture.get(3).is_some_and(|flags| flags & 8 != 0);
        let [.., w0, w1, w2, w3, m0, m1, m2, m3, phase] = *self.picture.as_slice() else { return None };
        let [width_m, object_kg] = [[w0, w1, w2, w3], [m0, m1, m2, m3]].map(f32::from_le_bytes);
        shown.then_some(((1e3 * width_m).round(), object_kg, phase))
    }

    pub(crate) fn stop_confirmed(&self) -> u32 {
        self.number(16)
    }

    /// Takes one message without any sign of life; `Err` with code and reason once the gateway has hung up.
    pub(crate) async fn take(&mut self) -> Result<(), (u16, String)> {
        match timeout(HANGS_AFTER, self.socket.next()).await.expect("a message or the end") {
            Some(Ok(Message::Binary(picture))) => self.picture = picture.to_vec(),
            Some(Ok(Message::Text(text))) => {
                let value: Value = serde_json::from_str(&text).unwrap();
                match value["t"].as_str() {
                    Some("state") => self.state = value,
                    _ => self.replies.push(value),
                }
            }
            Some(Ok(Message::Close(Some(frame)))) => {
                return Err((frame.code.into(), frame.reason.as_str().to_owned()));
            }
            Some(Ok(_)) => {}
            None | Some(Err(_)) => return Err((1006, String::new())),
        }
        Ok(())
    }

    /// Draws pictures and gives signs of life until `done`; `Err` once the gateway has hung up.
    pub(crate) async fn until(&mut self, mut done: impl FnMut(&Self) -> bool) -> Result<(), (u16, String)> {
        let pictures = async {
            while !done(self) {
                self.take().await?;
                let newest = self.number(4);
                if newest > self.drawn {
                    self.drawn = newest;
                    self.beat().await;
                }
            }
            Ok(())
        };
        timeout(HANGS_AFTER, pictures).await.expect("what was waited for")
    }

    /// Draws two more pictures: they show what happened before.
    pub(crate) async fn newer(&mut self) {
        let seen = self.drawn;
        self.until(|page| page.drawn > seen + 1).await.unwrap();
    }

    /// As `until`, with pictures that come but are never drawn: signs of life go on naming an old one.
    pub(crate) async fn until_without_drawing(
        &mut self,
        mut done: impl FnMut(&Self) -> bool,
    ) -> Result<(), (u16, String)> {
        let beats = async {
            while !done(self) {
                self.take().await?;
                self.beat().await;
            }
            Ok(())
        };
        timeout(HANGS_AFTER, beats).await.expect("what was waited for")
    }

    /// The answer to the next request that is answered.
    pub(crate) async fn reply(&mut self) -> Value {
        self.replies.clear();
        self.until(|page| !page.replies.is_empty()).await.unwrap();
        self.replies.remove(0)
    }

    /// Presses hold to run and waits until the robot runs.
    pub(crate) async fn run(&mut self) {
        self.until(|page| page.mode() == "ready").await.unwrap();
        self.press += 1;
        self.beat().await;
        self.until(|page| page.mode() == "impedance").await.unwrap();
    }
}
