//! `mocad access`: certificates for programs of other machines. It changes files that a running daemon reads again.

use crate::record::flight_recorder::access_folder;
use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};
use moca_telemetry::net::{access::Role, tls::Access};
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;

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
    /// List names and roles.
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
                writeln!(text, "{:12}{}", person.role.name(), person.name)?;
            }
            Ok(text)
        }
        Command::Revoke { name } => {
            ensure!(access.revoke(name)? > 0, "nobody is called {name:?}: see mocad access list");
            Ok(format!("{name} is no longer let in\n"))
        }
    }
}
