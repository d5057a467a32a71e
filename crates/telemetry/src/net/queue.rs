//! Messages that wait for one client: bounded, oldest samples dropped first.

use super::wire::{Commander, Status};
use std::{collections::VecDeque, rc::Rc};

/// Most batches that wait for one client: 0.64 s at 10 ms a batch.
pub(super) const MAX_BATCHES: usize = 64;
/// With so many answers waiting a client is asked for nothing more until it has read some: it may ask as fast as it likes,
/// and is heard as fast as it reads.
const MAX_REPLIES: usize = 64;

/// One encoded batch, shared by all clients.
pub(super) struct EncodedBatch {
    pub(super) frame: Vec<u8>,
    pub(super) samples: u64,
}

/// Next message to write.
pub(super) enum Outgoing {
    Batch(Rc<EncodedBatch>),
    Frame(Rc<Vec<u8>>),
    Status(Status),
    /// The last frame.
    Goodbye(Rc<Vec<u8>>),
}

/// Queue of one client.
#[derive(Default)]
pub(super) struct Queue {
    batches: VecDeque<Rc<EncodedBatch>>,
    replies: VecDeque<Rc<Vec<u8>>>,
    status: Status,
    status_sent: Option<Status>,
    /// Only the newest values matter.
    parameters: Option<Rc<Vec<u8>>>,
    /// Only the newest progress matters.
    calibration: Option<Rc<Vec<u8>>>,
    goodbye: Option<Rc<Vec<u8>>>,
}

impl Queue {
    /// Takes a batch, dropping the oldest one when full.
    pub(super) fn push_batch(&mut self, batch: Rc<EncodedBatch>) {
        if self.batches.len() >= MAX_BATCHES
            && let Some(dropped) = self.batches.pop_front()
        {
            self.status.client_dropped += dropped.samples;
        }
        self.batches.push_back(batch);
    }

    /// Takes an answer. No more of them wait than [`MAX_REPLIES`] and those to what the loop has on its way.
    pub(super) fn push_reply(&mut self, frame: Rc<Vec<u8>>) {
        self.replies.push_back(frame);
    }

    /// The next answer, for a client that is sent nothing else.
    pub(super) fn pop_reply(&mut self) -> Option<Rc<Vec<u8>>> {
        self.replies.pop_front()
    }

    /// Returns true if there is room for the answers to the client's next requests.
    pub(super) fn has_room(&self) -> bool {
        self.replies.len() < MAX_REPLIES
    }

    /// Takes the parameters' values, encoded.
    pub(super) fn set_parameters(&mut self, frame: Rc<Vec<u8>>) {
        self.parameters = Some(frame);
    }

    /// Takes the calibration's progress, encoded.
    pub(super) fn set_calibration(&mut self, frame: Rc<Vec<u8>>) {
        self.calibration = Some(frame);
    }

    /// Takes the last frame of this client.
    pub(super) fn set_goodbye(&mut self, frame: Vec<u8>) {
        self.goodbye = Some(Rc::new(frame));
    }

    /// Notes what the client should know besides its own drops.
    pub(super) fn set_status(&mut self, ring_dropped: u64, commander: Commander) {
        self.status.ring_dropped = ring_dropped;
        self.status.commander = commander;
    }

    /// Samples dropped so far.
    pub(super) fn dropped(&self) -> u64 {
        self.status.client_dropped
    }

    /// Batches waiting.
    pub(super) fn waiting(&self) -> usize {
        self.batches.len()
    }

    /// Returns the next message: parameters and answers first, then news, then samples.
    pub(super) fn pop(&mut self) -> Option<Outgoing> {
        if let Some(frame) = self.goodbye.take() {
            return Some(Outgoing::Goodbye(frame));
        }
        // Before the answer to the change, so that whoever reads it knows the value.
        if let Some(frame) = self.parameters.take().or_else(|| self.replies.pop_front()) {
            return Some(Outgoing::Frame(frame));
        }
        if self.status_sent != Some(self.status) {
            self.status_sent = Some(self.status);
            return Some(Outgoing::Status(self.status));
        }
        if let Some(frame) = self.calibration.take() {
            return Some(Outgoing::Frame(frame));
        }
        self.batches.pop_front().map(Outgoing::Batch)
    }
}
