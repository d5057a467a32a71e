//! Connections: bounded before TLS begins, in number, for each address and in time.

use crate::guard::Peer;
use anyhow::Context;
use axum::{Router, body::Body};
use hyper::{body::Incoming, server::conn::http1, service::service_fn};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use rustls::ServerConfig;
use std::{
    collections::HashMap,
    net::{IpAddr, SocketAddr},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use tokio::{
    net::{TcpListener, TcpSocket, TcpStream},
    sync::watch,
    time::timeout,
};
use tokio_rustls::TlsAcceptor;

/// Connections at the same time.
const CONNECTIONS_MAX: usize = 128;
/// Connections of one address: a page needs two to four.
const OF_ADDRESS_MAX: usize = 32;
/// Room of the kernel for one page, bytes: more would be seconds of old pictures.
const SEND_BUFFER: u32 = 16 * 1024;
/// Connections that wait to be accepted.
const BACKLOG: u32 = 64;
/// Most time for TLS, and for the head of a request.
const PATIENCE: Duration = Duration::from_secs(5);
/// Bytes that are read ahead.
const READ_MAX: usize = 16 * 1024;

/// Listens on an address.
pub(crate) fn bind(address: SocketAddr) -> anyhow::Result<TcpListener> {
    let bound = || {
        let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
        socket.set_reuseaddr(true)?;
        // Accepted connections inherit both.
        socket.set_send_buffer_size(SEND_BUFFER)?;
        socket.set_nodelay(true)?;
        socket.bind(address)?;
        socket.listen(BACKLOG)
    };
    bound().with_context(|| format!("cannot listen on {address}: choose another address with --listen"))
}

/// Serves for ever; each connection takes the newest `config`.
pub(crate) async fn serve(listener: TcpListener, config: watch::Receiver<Arc<ServerConfig>>, app: Router) {
    let present = Arc::new(Mutex::new(HashMap::new()));
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            // No more file descriptors: pages that leave give some back.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Some(place) = Place::take(&present, peer.ip()) else { continue };
        let acceptor = TlsAcceptor::from(Arc::clone(&config.borrow()));
        let app = app.clone();
        tokio::spawn(async move {
            let _place = place;
            // One that breaks off has nobody to be told.
            let _ = attend(stream, peer.ip(), acceptor, app).await;
        });
    }
}

async fn attend(stream: TcpStream, peer: IpAddr, acceptor: TlsAcceptor, app: Router) -> anyhow::Result<()> {
    let stream = timeout(PATIENCE, acceptor.accept(stream)).await??;
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(Peer(peer));
        hyper::service::Service::call(&TowerToHyperService::new(app.clone()), request.map(Body::new))
    });
    http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(PATIENCE)
        .max_buf_size(READ_MAX)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades()
        .await?;
    Ok(())
}

type Present = Mutex<HashMap<IpAddr, usize>>;

/// The place of one connection. Dropping it gives it back.
struct Place {
    present: Arc<Present>,
    address: IpAddr,
}

impl Place {
    fn take(present: &Arc<Present>, address: IpAddr) -> Option<Self> {
        let mut places = present.lock().unwrap_or_else(PoisonError::into_inner);
        let all: usize = places.values().sum();
        let own = places.get(&address).copied().unwrap_or(0);
        if all >= CONNECTIONS_MAX || own >= OF_ADDRESS_MAX {
            return None;
        }
        places.insert(address, own + 1);
        drop(places);
        Some(Self { present: Arc::clone(present), address })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut places = self.present.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(own) = places.get_mut(&self.address) {
            *own -= 1;
            if *own == 0 {
                places.remove(&self.address);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_one_address_and_of_all_are_bounded() {
        let present = Arc::default();
        let address = |last: u8| IpAddr::from([192, 0, 2, last]);
        let mut taken: Vec<Place> = (0..100).filter_map(|_| Place::take(&present, address(1))).collect();
        assert_eq!(taken.len(), OF_ADDRESS_MAX);
        taken.extend((2..200).filter_map(|last| Place::take(&present, address(last))));
        assert_eq!(taken.len(), CONNECTIONS_MAX);
        drop(taken);
        assert!(present.lock().unwrap().is_empty());
    }
}
