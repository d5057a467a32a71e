//! Channels of the present session, its viewers, and the messages that wait for each viewer.

use crate::protocol::{self, FromViewer, Level};
use moca_telemetry::RobotDescription;
use serde_json::Value;
use std::{
    cell::{Cell, RefCell},
    collections::{BTreeMap, VecDeque},
    rc::Rc,
    time::{Duration, Instant},
};
use tokio::sync::Notify;

/// Data that is older than this when it could be sent is not: a viewer that did not read for a while goes on with the
/// present.
const MAX_AGE: Duration = Duration::from_millis(500);
/// Most bytes of data that wait for one viewer.
const MAX_WAITING_BYTES: usize = 1 << 20;
/// Most texts that wait for one viewer; who asks for more without reading is hung up on.
const MAX_TEXTS: usize = 64;
/// Most subscriptions of one viewer.
const MAX_SUBSCRIPTIONS: usize = 256;

/// Message to a viewer.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Outgoing {
    Text(String),
    Data(Vec<u8>),
}

/// One viewer.
#[derive(Default)]
pub(crate) struct Viewer {
    texts: RefCell<VecDeque<String>>,
    data: RefCell<VecDeque<(Instant, Vec<u8>)>>,
    waiting_bytes: Cell<usize>,
    /// Messages that it was too slow for and has not been told of.
    missed: Cell<u64>,
    /// Channel → number of the subscription.
    subscriptions: RefCell<BTreeMap<u32, u32>>,
    watches_parameters: Cell<bool>,
    /// Asked more than it read.
    pub(crate) flooded: Cell<bool>,
    pub(crate) filled: Notify,
}

impl Viewer {
    fn text(&self, text: String) {
        let mut texts = self.texts.borrow_mut();
        if texts.len() < MAX_TEXTS {
            texts.push_back(text);
        } else {
            self.flooded.set(true);
        }
        self.filled.notify_one();
    }

    fn data(&self, frame: Vec<u8>) {
        let mut data = self.data.borrow_mut();
        self.waiting_bytes.set(self.waiting_bytes.get() + frame.len());
        data.push_back((Instant::now(), frame));
        while self.waiting_bytes.get() > MAX_WAITING_BYTES {
            let Some((_, frame)) = data.pop_front() else { break };
            self.waiting_bytes.set(self.waiting_bytes.get() - frame.len());
            self.missed.set(self.missed.get() + 1);
        }
        self.filled.notify_one();
    }

    fn forget_data(&self) {
        self.data.borrow_mut().clear();
        self.waiting_bytes.set(0);
        self.subscriptions.borrow_mut().clear();
    }

    /// Returns the next message to send at `now`: texts first, data only while it is fresh.
    pub(crate) fn next(&self, now: Instant) -> Option<Outgoing> {
        if let Some(text) = self.texts.borrow_mut().pop_front() {
            return Some(Outgoing::Text(text));
        }
        loop {
            let (queued, frame) = self.data.borrow_mut().pop_front()?;
            self.waiting_bytes.set(self.waiting_bytes.get() - frame.len());
            if now.saturating_duration_since(queued) <= MAX_AGE {
                let missed = self.missed.replace(0);
                if missed > 0 {
                    let text = format!("{missed} messages were left out: this viewer reads too slowly");
                    self.text(protocol::status(Level::Warning, &text));
                }
                return Some(Outgoing::Data(frame));
            }
            self.missed.set(self.missed.get() + 1);
        }
    }
}

/// A channel of the present session.
struct Channel {
    topic: String,
    advertised: Value,
    /// Message sent once at the beginning and again to each later viewer.
    first: Option<(u64, Vec<u8>)>,
}

/// The present session and its viewers.
#[derive(Default)]
pub(crate) struct Hub {
    viewers: RefCell<BTreeMap<u64, Rc<Viewer>>>,
    next_viewer: Cell<u64>,
    channels: RefCell<Vec<Channel>>,
    robot: RefCell<RobotDescription>,
    session: Cell<u64>,
    /// Why there is no session.
    down: RefCell<String>,
}

impl Hub {
    /// A viewer has come.
    pub(crate) fn enter(&self) -> (u64, Rc<Viewer>) {
        let id = self.next_viewer.get();
        self.next_viewer.set(id + 1);
        let viewer = Rc::new(Viewer::default());
        viewer.text(self.server_info());
        viewer.text(self.advertisement());
        if !self.down.borrow().is_empty() {
            viewer.text(protocol::status(Level::Error, &self.down.borrow()));
        }
        self.viewers.borrow_mut().insert(id, Rc::clone(&viewer));
        (id, viewer)
    }

    /// A viewer has gone.
    pub(crate) fn leave(&self, id: u64) {
        self.viewers.borrow_mut().remove(&id);
    }

    fn server_info(&self) -> String {
        let robot = self.robot.borrow();
        let name = if robot.name.is_empty() { "MOCA-S" } else { &robot.name };
        protocol::server_info(name, &format!("{}-{}", std::process::id(), self.session.get()))
    }

    fn advertisement(&self) -> String {
        let channels = self.channels.borrow();
        protocol::advertise(&channels.iter().map(|channel| channel.advertised.clone()).collect::<Vec<_>>())
    }

    /// A new session with a daemon, without channels yet.
    pub(crate) fn begin(&self, robot: &RobotDescription) {
        self.session.set(self.session.get() + 1);
        self.robot.replace(robot.clone());
        self.channels.borrow_mut().clear();
    }

    /// Every channel is there: viewers hear of them.
    pub(crate) fn announce(&self) {
        self.down.borrow_mut().clear();
        let (info, channels) = (self.server_info(), self.advertisement());
        for viewer in self.viewers.borrow().values() {
            viewer.text(info.clone());
            viewer.text(channels.clone());
        }
    }

    /// One more channel in a session that was announced: viewers hear of it alone.
    pub(crate) fn announce_last(&self) {
        let Some(advertised) = self.channels.borrow().last().map(|channel| channel.advertised.clone()) else {
            return;
        };
        let text = protocol::advertise(&[advertised]);
        for viewer in self.viewers.borrow().values() {
            viewer.text(text.clone());
        }
    }

    /// The session has ended: nothing that it showed is shown as if it were the present.
    pub(crate) fn end(&self, reason: &str) {
        let ids: Vec<u32> = (0..).zip(self.channels.borrow().iter()).map(|(id, _)| id).collect();
        self.channels.borrow_mut().clear();
        let news = self.down.replace(reason.into()) != reason;
        for viewer in self.viewers.borrow().values() {
            viewer.forget_data();
            if !ids.is_empty() {
                viewer.text(protocol::unadvertise(&ids));
            }
            if news {
                viewer.text(protocol::status(Level::Error, reason));
            }
        }
    }

    /// Adds a channel.
    pub(crate) fn add(&self, topic: &str, schema_name: &str, schema: &str) {
        let mut channels = self.channels.borrow_mut();
        let id = u32::try_from(channels.len()).unwrap_or(u32::MAX);
        let advertised = protocol::channel(id, topic, schema_name, schema);
        channels.push(Channel { topic: topic.into(), advertised, first: None });
    }

    fn number(&self, topic: &str) -> Option<u32> {
        let channels = self.channels.borrow();
        (0..).zip(channels.iter()).find(|(_, channel)| channel.topic == topic).map(|(id, _)| id)
    }

    /// Returns true if a viewer subscribes to `topic`.
    pub(crate) fn is_watched(&self, topic: &str) -> bool {
        let Some(id) = self.number(topic) else { return false };
        self.viewers.borrow().values().any(|viewer| viewer.subscriptions.borrow().contains_key(&id))
    }

    /// Keeps a message for whoever comes.
    pub(crate) fn keep(&self, topic: &str, unix_ns: u64, content: &[u8]) {
        if let Some(channel) = self.channels.borrow_mut().iter_mut().find(|channel| channel.topic == topic) {
            channel.first = Some((unix_ns, content.into()));
        }
    }

    /// Sends a message to those who watch its topic.
    pub(crate) fn publish(&self, topic: &str, unix_ns: u64, content: &[u8]) {
        let Some(id) = self.number(topic) else { return };
        for viewer in self.viewers.borrow().values() {
            let subscription = viewer.subscriptions.borrow().get(&id).copied();
            if let Some(subscription) = subscription {
                viewer.data(protocol::data(subscription, unix_ns, content));
            }
        }
    }

    /// Notes changed parameters and tells who wants to know.
    pub(crate) fn note_parameters(&self, note: impl FnOnce(&mut RobotDescription) -> Vec<String>) {
        let names = note(&mut self.robot.borrow_mut());
        if names.is_empty() {
            return;
        }
        let values = protocol::parameter_values(&self.robot.borrow(), &names, None);
        for viewer in self.viewers.borrow().values().filter(|viewer| viewer.watches_parameters.get()) {
            viewer.text(values.clone());
        }
    }

    /// Answers what a viewer said.
    pub(crate) fn hear(&self, viewer: &Viewer, text: &str) {
        match protocol::parse(text) {
            Ok(FromViewer::Subscribe(pairs)) => {
                pairs.into_iter().for_each(|(subscription, id)| self.subscribe(viewer, subscription, id));
            }
            Ok(FromViewer::Unsubscribe(ids)) => {
                viewer.subscriptions.borrow_mut().retain(|_, subscription| !ids.contains(subscription));
            }
            Ok(FromViewer::Parameters { names, id, set }) => {
                if set {
                    let text = "parameters can only be read here; the values in force are sent back";
                    complain(viewer, text);
                }
                viewer.text(protocol::parameter_values(&self.robot.borrow(), &names, id.as_deref()));
            }
            Ok(FromViewer::WatchParameters(watch)) => viewer.watches_parameters.set(watch),
            Err(why) => complain(viewer, &why),
        }
    }

    fn subscribe(&self, viewer: &Viewer, subscription: u32, id: u32) {
        let channels = self.channels.borrow();
        let Some(channel) = usize::try_from(id).ok().and_then(|id| channels.get(id)) else {
            return complain(viewer, &format!("there is no channel {id}"));
        };
        let mut subscriptions = viewer.subscriptions.borrow_mut();
        if subscriptions.len() >= MAX_SUBSCRIPTIONS
            || subscriptions.values().any(|used| *used == subscription)
        {
            return complain(viewer, &format!("subscription {subscription} is in use, or one too many"));
        }
        subscriptions.insert(id, subscription);
        if let Some((unix_ns, content)) = &channel.first {
            viewer.data(protocol::data(subscription, *unix_ns, content));
        }
    }
}

/// Tells a viewer what it did wrong, unless it does not even read what it was told before.
pub(crate) fn complain(viewer: &Viewer, why: &str) {
    if viewer.texts.borrow().len() < MAX_TEXTS / 2 {
        viewer.text(protocol::status(Level::Warning, why));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slept_viewer_resumes_and_hears_what_it_missed() {
        let hub = Hub::default();
        hub.add("/tf", "tf2_msgs/msg/TFMessage", "");
        let (_, viewer) = hub.enter();
        hub.hear(&viewer, r#"{"op": "subscribe", "subscriptions": [{"id": 5, "channelId": 0}]}"#);
        let now = Instant::now();
        while viewer.next(now).is_some() {}
        (0..3).for_each(|time| hub.publish("/tf", time, b"old"));
        viewer.data.borrow_mut().iter_mut().for_each(|(queued, _)| *queued = now);
        hub.publish("/tf", 3, b"new");
        let awake = now + Duration::from_secs(1);
        viewer.data.borrow_mut().back_mut().into_iter().for_each(|(queued, _)| *queued = awake);
        assert_eq!(viewer.next(awake), Some(Outgoing::Data(protocol::data(5, 3, b"new"))));
        let Some(Outgoing::Text(told)) = viewer.next(awake) else { panic!("it is not told") };
        assert!(told.contains("3 messages were left out"), "{told}");
        assert_eq!((viewer.next(awake), viewer.waiting_bytes.get()), (None, 0));
    }

    #[test]
    fn what_waits_for_a_viewer_is_bounded() {
        let hub = Hub::default();
        hub.add("/tf", "tf2_msgs/msg/TFMessage", "");
        let (_, viewer) = hub.enter();
        hub.hear(&viewer, r#"{"op": "subscribe", "subscriptions": [{"id": 5, "channelId": 0}]}"#);
        (0..100_000).for_each(|time| hub.publish("/tf", time, &[0; 100]));
        assert!(viewer.waiting_bytes.get() <= MAX_WAITING_BYTES);
        (0..1000).for_each(|_| hub.hear(&viewer, "garbage"));
        assert!(viewer.texts.borrow().len() <= MAX_TEXTS && !viewer.flooded.get());
        (0..1000).for_each(|_| hub.hear(&viewer, r#"{"op": "getParameters", "parameterNames": []}"#));
        assert!(viewer.texts.borrow().len() <= MAX_TEXTS && viewer.flooded.get());
    }
}
