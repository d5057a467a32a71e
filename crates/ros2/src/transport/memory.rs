//! A transport in memory, for tests.

use super::{Caller, Endpoint, Qos, ReaderId, ServiceId, Transport, TransportError, WriterId};
use crate::TypeName;
use std::collections::VecDeque;
use std::sync::mpsc::Sender;
use std::time::Duration;

/// A transport in memory: what was written to each writer, and what is to be read.
#[derive(Debug, Default)]
pub struct Memory {
    /// Each writer's topic, and what was written to it.
    pub written: Vec<(String, Vec<Vec<u8>>)>,
    /// Each reader's topic, and what it has not taken yet.
    pub unread: Vec<(String, VecDeque<Vec<u8>>)>,
    /// Other ends on the topics.
    pub others: Vec<Endpoint>,
    /// Payloads that the first reader finds.
    pub waiting: Vec<Vec<u8>>,
    /// Topic, node and payload of what is to be read with the node that wrote it.
    pub from_nodes: Vec<(String, Vec<u8>, Vec<u8>)>,
    /// Receiver of a signal for each message taken.
    pub took: Option<Sender<()>>,
    /// Receiver of each written message, on another thread.
    pub heard: Option<Sender<Vec<u8>>>,
}

impl Transport for Memory {
    fn writer(&mut self, topic: &str, _: TypeName, _: Qos) -> Result<WriterId, TransportError> {
        self.written.push((topic.into(), Vec::new()));
        Ok(WriterId(self.written.len() - 1))
    }

    fn reader(&mut self, topic: &str, _: TypeName, _: Qos) -> Result<ReaderId, TransportError> {
        self.unread.push((topic.into(), std::mem::take(&mut self.waiting).into()));
        Ok(ReaderId(self.unread.len() - 1))
    }

    /// Nobody calls it.
    fn service(&mut self, _: &str, _: TypeName) -> Result<ServiceId, TransportError> {
        Ok(ServiceId(0))
    }

    fn write(&mut self, to: WriterId, payload: &[u8]) -> Result<(), TransportError> {
        self.written[to.0].1.push(payload.to_vec());
        if let Some(heard) = &self.heard {
            heard.send(payload.to_vec()).map_err(|error| TransportError(error.to_string()))?;
        }
        Ok(())
    }

    fn take(&mut self, from: ReaderId) -> Option<Vec<u8>> {
        let payload = self.unread[from.0].1.pop_front();
        if let (Some(took), true) = (&self.took, payload.is_some()) {
            // A test that has seen enough has ended.
            let _ = took.send(());
        }
        payload
    }

    fn take_from_node(&mut self, from: ReaderId) -> Option<(Vec<u8>, Vec<u8>)> {
        let topic = &self.unread[from.0].0;
        let oldest = self.from_nodes.iter().position(|(of, ..)| of == topic)?;
        let (_, node, payload) = self.from_nodes.remove(oldest);
        Some((node, payload))
    }

    fn take_call(&mut self, _: ServiceId) -> Option<(Caller, Vec<u8>)> {
        None
    }

    fn answer(&mut self, _: ServiceId, _: &Caller, _: &[u8]) -> Result<(), TransportError> {
        Ok(())
    }

    fn wait(&mut self, most: Duration) {
        std::thread::sleep(most);
    }

    fn endpoints(&self) -> Vec<Endpoint> {
        self.others.clone()
    }
}
