//! `mocad access`: certificates for programs of other machines. It changes files that a running daemon reads again.

use crate::record::flight_recorder::access_folder;
use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};
use moca_telemetry::net::{
    access::Role,
    tls::{Access, Person},
};
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Certificates for programs of other machines.
#[derive(Args)]
pub struct Arguments {
    /// Folder of the certificates; without it that of this user, or of the service in its unit. The packaged service's is
    /// /var/lib/mocad/access.
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Make a certificate: NAME.pem in this folder, to copy to the other machine as ~/.config/mocad/access/HOST.pem.
    New {
        /// Name of the program or machine: 1 to 40 letters, digits, dots, dashes or underscores.
        name: String,
        /// Rights: viewer, operator or maintainer.
        #[arg(long)]
        role: Role,
    },
    /// List names, roles and the days on which certificates end.
    List,
    /// Take the rights of a name away: its connections end at once.
    Revoke {
        /// Its name, as mocad access list shows it.
        name: String,
    },
}

/// Carries a command out; returns what to print.
///
/// # Errors
/// A name that is taken, unknown or not allowed; files that cannot be read or written.
pub fn run(arguments: &Arguments) -> Result<String> {
    let access = Access::open(&arguments.folder.clone().unwrap_or_else(access_folder))?;
    match &arguments.command {
        Command::New { name, role } => {
            let path = format!("{name}.pem");
            let pem = access.new_certificate(name, *role)?;
            let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path);
            if let Err(error) = file.and_then(|mut file| file.write_all(pem.as_bytes())) {
                // Nobody has it, so nobody is let in with it.
                access.revoke(name)?;
                return Err(error).context(path);
            }
            Ok(format!("{path}: role {}; copy it as ~/.config/mocad/access/HOST.pem\n", role.name()))
        }
        Command::List => {
            let mut text = String::new();
            for person in access.people()?.values() {
                writeln!(text, "{:12}{:41}{}", person.role.name(), person.name, ends(person))?;
            }
            Ok(text)
        }
        Command::Revoke { name } => {
            ensure!(access.revoke(name)? > 0, "nobody is called {name:?}: see mocad access list");
            Ok(format!("{name} is no longer let in\n"))
        }
    }
}

/// End of a person's certificate in words.
fn ends(person: &Person) -> String {
    let end = UNIX_EPOCH + Duration::from_secs(person.ends_unix_s);
    let day = humantime::format_rfc3339_seconds(end).to_string();
    match day.split_once('T') {
        Some((day, _)) if end > SystemTime::now() => format!("until {day}"),
        Some((day, _)) if person.ends_unix_s > 0 => format!("ended {day}: revoke it, then make a new one"),
        _ => "end not noted".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ended_certificate_is_listed_with_the_remedy() {
        let person = |ends_unix_s| Person { name: "lab-pc".into(), role: Role::Viewer, ends_unix_s };
        assert_eq!(ends(&person(4_102_444_800)), "until 2100-01-01");
        assert_eq!(ends(&person(1_764_072_184)), "ended 2025-11-25: revoke it, then make a new one");
        assert_eq!(ends(&person(0)), "end not noted");
    }
}
