//! Paired devices and one-time codes, as files of a folder. `moca-web pair` and `moca-web revoke` change the files, a running
//! gateway reads them again, so no command needs a socket.

use super::{Role, secret};
use anyhow::{Context, bail, ensure};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::{
    collections::BTreeMap,
    fs::{self, File, OpenOptions},
    io::{ErrorKind, Write},
    os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, chown},
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

/// Life of a code, s.
pub const CODE_LIFE_S: u64 = 120;
/// Wrong codes after which every code is void.
pub const WRONG_CODES_MAX: u32 = 5;
/// Life of a pairing, s: 90 days.
pub const DEVICE_LIFE_S: u64 = 90 * 86_400;
/// Longest name of a device, letters.
const NAME_MAX: usize = 40;
const DEVICES: &str = "devices.json";
const CODES: &str = "codes.json";

/// A device that may come in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Device {
    /// Name that its owner gave it; unique.
    pub name: String,
    /// Its rights.
    pub role: Role,
    /// End of its rights, s since the Unix epoch.
    pub until_unix_s: u64,
}

/// Devices by the SHA-256 of their token: looking one up takes no time that tells anything of a token.
pub type Devices = BTreeMap<String, Device>;

#[derive(Serialize, Deserialize)]
struct Code {
    role: Role,
    until_unix_s: u64,
}

#[derive(Default, Serialize, Deserialize)]
struct Codes {
    codes: BTreeMap<String, Code>,
    wrong: u32,
}

/// The folder of devices and codes.
#[derive(Clone, Debug)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// Opens a folder, and creates it for its owner alone.
    ///
    /// # Errors
    /// A folder that cannot be created.
    pub fn open(folder: &Path) -> anyhow::Result<Self> {
        let mut builder = fs::DirBuilder::new();
        builder.recursive(true).mode(0o700).create(folder).with_context(|| folder.display().to_string())?;
        Ok(Self { folder: folder.into() })
    }

    /// A code for one device.
    ///
    /// # Errors
    /// Files that cannot be read or written.
    pub fn new_code(&self, role: Role) -> anyhow::Result<String> {
        let _locked = self.lock()?;
        let code = secret::code()?;
        let mut codes: Codes = self.read(CODES)?;
        codes.wrong = 0;
        codes.codes.retain(|_, code| code.until_unix_s > now_unix_s());
        let until_unix_s = now_unix_s() + CODE_LIFE_S;
        codes.codes.insert(secret::sha256(code.as_bytes()), Code { role, until_unix_s });
        self.write(CODES, &codes)?;
        Ok(code)
    }

    /// Exchanges a code for a token and uses the code up.
    ///
    /// # Errors
    /// A code that is unknown, used or too old; a name that is taken or not allowed.
    pub fn pair(&self, code: &str, name: &str) -> anyhow::Result<(String, Device)> {
        let name = name.trim();
        let allowed = |c: char| c.is_alphanumeric() || " -_.'".contains(c);
        ensure!(
            (1..=NAME_MAX).contains(&name.chars().count()) && name.chars().all(allowed),
            "a device's name has 1 to {NAME_MAX} letters, digits, spaces and any of - _ . '"
        );
        let _locked = self.lock()?;
        let mut devices = self.devices()?;
        ensure!(
            devices.values().all(|device| device.name != name),
            "a device is called {name:?} already: choose another name, or run moca-web revoke on the robot"
        );
        let role = self.use_up(code)?;
        let token = secret::token()?;
        let device = Device { name: name.into(), role, until_unix_s: now_unix_s() + DEVICE_LIFE_S };
        devices.insert(secret::sha256(token.as_bytes()), device.clone());
        self.write(DEVICES, &devices)?;
        Ok((token, device))
    }

    fn use_up(&self, code: &str) -> anyhow::Result<Role> {
        let code: String = code.chars().filter(char::is_ascii_alphanumeric).collect();
        let mut codes: Codes = self.read(CODES)?;
        codes.codes.retain(|_, code| code.until_unix_s > now_unix_s());
        let found = codes.codes.remove(&secret::sha256(code.to_uppercase().as_bytes()));
        if found.is_none() {
            codes.wrong += 1;
            if codes.wrong >= WRONG_CODES_MAX {
                codes.codes.clear();
            }
        }
        self.write(CODES, &codes)?;
        match found {
            Some(code) => Ok(code.role),
            None => {
                bail!("this code is unknown, used or too old: run moca-web pair on the robot for a new one")
            }
        }
    }

    /// Every device.
    ///
    /// # Errors
    /// A file that cannot be read: nobody is let in then.
    pub fn devices(&self) -> anyhow::Result<Devices> {
        self.read(DEVICES)
    }

    /// Takes the rights of a device away; how many devices that were.
    ///
    /// # Errors
    /// Files that cannot be read or written.
    pub fn revoke(&self, name: &str) -> anyhow::Result<usize> {
        let _locked = self.lock()?;
        let mut devices = self.devices()?;
        let before = devices.len();
        devices.retain(|_, device| device.name != name);
        self.write(DEVICES, &devices)?;
        Ok(before - devices.len())
    }

    /// Two programs that change a file at once would lose a change. Dropping the file unlocks it.
    fn lock(&self) -> anyhow::Result<File> {
        let path = self.folder.join("lock");
        let file = OpenOptions::new().create(true).truncate(false).write(true).mode(0o600).open(&path);
        let file = file.with_context(|| path.display().to_string())?;
        adopt(&path)?;
        file.lock().with_context(|| path.display().to_string())?;
        Ok(file)
    }

    fn read<T: Default + DeserializeOwned>(&self, name: &str) -> anyhow::Result<T> {
        let path = self.folder.join(name);
        match fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text).with_context(|| path.display().to_string()),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(T::default()),
            Err(error) => Err(error).with_context(|| path.display().to_string()),
        }
    }

    fn write(&self, name: &str, value: &impl Serialize) -> anyhow::Result<()> {
        write_private(&self.folder.join(name), &serde_json::to_string_pretty(value)?)
    }
}

/// The device that a token belongs to, with its key.
pub fn device_of<'a>(devices: &'a Devices, token: &str) -> Option<(&'a String, &'a Device)> {
    devices.get_key_value(&secret::sha256(token.as_bytes())).filter(|(_, d)| d.until_unix_s > now_unix_s())
}

/// Replaces a file that only its owner may read, at once or not at all.
pub(crate) fn write_private(path: &Path, text: &str) -> anyhow::Result<()> {
    let new = path.with_extension("new");
    let write = || {
        let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&new)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        adopt(&new)?;
        fs::rename(&new, path)
    };
    write().with_context(|| path.display().to_string())
}

/// Gives a file that root has made to the owner of its folder, who could not read it otherwise.
fn adopt(file: &Path) -> std::io::Result<()> {
    let (made, folder) = (fs::metadata(file)?, fs::metadata(file.parent().unwrap_or(Path::new("/")))?);
    if made.uid() == 0 && folder.uid() != 0 {
        chown(file, Some(folder.uid()), Some(folder.gid()))?;
    }
    Ok(())
}

/// Now, s since the Unix epoch.
pub(crate) fn now_unix_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs()
}
