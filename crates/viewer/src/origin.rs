//! Which web pages may connect. A browser lets any page open a socket to this machine and says in `Origin` which page it is;
//! programs say nothing, or that they are no page.
//!
//! ```
//! use moca_viewer::origin::Origins;
//! let origins = Origins::new(["https://lab.example.org".into()]);
//! assert!(origins.allow(None), "a program");
//! assert!(origins.allow(Some("http://localhost:8080")) && origins.allow(Some("https://lab.example.org")));
//! assert!(!origins.allow(Some("https://example.com")) && !origins.allow(Some("http://localhost.example.com")));
//! ```

/// Viewers that are web pages of others, and desktop programs that are pages in a window.
const VIEWERS: [&str; 2] = ["https://app.foxglove.dev", "file://"];

/// The origins that are let in.
#[derive(Clone, Debug, Default)]
pub struct Origins {
    more: Vec<String>,
}

impl Origins {
    /// Those of this machine, the known viewers, and `more`, each as a browser says it: scheme, host and port.
    pub fn new(more: impl IntoIterator<Item = String>) -> Self {
        Self { more: more.into_iter().collect() }
    }

    /// Returns true if a connection may come from `origin`.
    pub fn allow(&self, origin: Option<&str>) -> bool {
        origin.is_none_or(|origin| {
            VIEWERS.contains(&origin)
                || self.more.iter().any(|more| more == origin)
                || is_of_this_machine(origin)
        })
    }
}

/// `http://localhost:8080`, `https://127.0.0.1`, `http://[::1]:3000`.
fn is_of_this_machine(origin: &str) -> bool {
    let Some(host) = origin.strip_prefix("http://").or(origin.strip_prefix("https://")) else { return false };
    ["localhost", "127.0.0.1", "[::1]"].iter().any(|name| {
        host.strip_prefix(name).is_some_and(|port| {
            port.is_empty() || port.strip_prefix(':').is_some_and(|port| port.parse::<u16>().is_ok())
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pages_of_this_machine_and_of_known_viewers_are_let_in() {
        let origins = Origins::default();
        for allowed in
            ["http://localhost", "http://127.0.0.1:8080", "https://[::1]:3000", "https://app.foxglove.dev"]
        {
            assert!(origins.allow(Some(allowed)), "{allowed}");
        }
        for refused in [
            "",
            "null",
            "https://evil.example",
            "http://localhost.evil.example",
            "http://localhost:80.evil.example",
            "http://127.0.0.1.evil.example",
            "https://app.foxglove.dev.evil.example",
            "https://evil.example/http://localhost",
            "ftp://localhost",
        ] {
            assert!(!origins.allow(Some(refused)), "{refused}");
        }
    }
}
