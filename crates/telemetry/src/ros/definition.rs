//! Name of a message, and the text that describes its layout.

use std::fmt::Write;

/// Name of a type as ROS writes it: `geometry_msgs/msg/Twist`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TypeName(pub &'static str);

impl TypeName {
    /// As DDS and zenoh see it: `geometry_msgs::msg::dds_::Twist_`.
    pub fn dds(self) -> String {
        let mut parts = self.0.split('/');
        let mut next = || parts.next().unwrap_or_default();
        format!("{}::{}::dds_::{}_", next(), next(), next())
    }

    /// As definitions have it: `geometry_msgs/Twist`.
    pub(crate) fn short(self) -> String {
        self.0.replace("/msg/", "/")
    }
}

/// Messages and the lines of their fields, the outermost first.
#[derive(Debug, Default)]
pub struct Definitions(Vec<(TypeName, String)>);

impl Definitions {
    /// Returns the place for the fields of a message; `None` if they are there already.
    pub(crate) fn begin(&mut self, name: TypeName) -> Option<usize> {
        if self.0.iter().any(|(known, _)| *known == name) {
            return None;
        }
        self.0.push((name, String::new()));
        Some(self.0.len() - 1)
    }

    /// Adds a field of the type `of`.
    pub(crate) fn line(&mut self, message: usize, name: &str, of: &str) {
        let name = name.trim_start_matches("r#");
        // a String takes everything
        let _ = writeln!(self.0[message].1, "{of} {name}");
    }

    /// Them all, one below the other.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        for (i, (name, fields)) in self.0.iter().enumerate() {
            if i > 0 {
                // a String takes everything
                let _ = write!(text, "{:=<80}\nMSG: {}\n", "", name.short());
            }
            text.push_str(fields);
        }
        text
    }
}
