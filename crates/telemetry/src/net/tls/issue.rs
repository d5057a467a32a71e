//! The robot's authority and its certificates, as files of a folder. A running daemon reads the list again, so no command needs a
//! socket.

use super::{
    AUTHORITY, NetError, PEOPLE, People, Person, Role, SERVER, SERVER_KEY, SERVER_NAME, fingerprint, people,
    read_private, wrong,
};
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer,
    KeyPair, KeyUsagePurpose,
};
use std::{
    fs::{self, File, OpenOptions},
    io::Write,
    os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, chown},
    path::{Path, PathBuf},
};
use time::{Duration, OffsetDateTime};

const AUTHORITY_KEY: &str = "authority-key.pem";
/// Life of the authority and of the robot's own certificate, days: clients meet no other.
const ROBOT_DAYS: i64 = 3650;
/// Life of a client's certificate, days.
const CLIENT_DAYS: i64 = 397;
/// Longest name, letters.
const NAME_MAX: usize = 40;

/// The robot's folder of certificates and of those who may come in.
#[derive(Clone, Debug)]
pub struct Access {
    folder: PathBuf,
}

impl Access {
    /// Opens a folder. The first call makes it, for its owner alone, with an authority and the robot's certificate.
    ///
    /// # Errors
    /// A folder that cannot be made or written.
    pub fn open(folder: &Path) -> Result<Self, NetError> {
        let access = Self { folder: folder.into() };
        let made = fs::DirBuilder::new().recursive(true).mode(0o700).create(folder);
        made.map_err(|error| wrong(folder)(&error))?;
        let _locked = access.lock()?;
        if !folder.join(SERVER).exists() {
            access.make_robot()?;
        }
        Ok(access)
    }

    fn make_robot(&self) -> Result<(), NetError> {
        let bad = |error: rcgen::Error| wrong(&self.folder)(&error);
        let (key, own_key) = (KeyPair::generate().map_err(bad)?, KeyPair::generate().map_err(bad)?);
        let authority = authority().self_signed(&key).map_err(bad)?;
        let mut own = leaf(SERVER_NAME, ROBOT_DAYS, ExtendedKeyUsagePurpose::ServerAuth);
        own.subject_alt_names =
            CertificateParams::new([SERVER_NAME.to_owned()]).map_err(bad)?.subject_alt_names;
        self.write(AUTHORITY_KEY, &key.serialize_pem())?;
        let own = own.signed_by(&own_key, &Issuer::new(self::authority(), key)).map_err(bad)?;
        self.write(AUTHORITY, &authority.pem())?;
        self.write(SERVER_KEY, &own_key.serialize_pem())?;
        // The last one: with it the folder is complete.
        self.write(SERVER, &own.pem())
    }

    /// Makes a certificate and puts it on the list. Returns the file for the client: certificate, key, and the robot's authority.
    ///
    /// # Errors
    /// A name that is taken or not allowed; files that cannot be read or written.
    pub fn new_certificate(&self, name: &str, role: Role) -> Result<String, NetError> {
        let list = self.folder.join(PEOPLE);
        let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if name.is_empty() || name.len() > NAME_MAX || !name.chars().all(allowed) {
            let why =
                format!("{name:?} is no name; allowed: 1 to {NAME_MAX} letters, digits and any of - _ .");
            return Err(wrong(&list)(&why));
        }
        let _locked = self.lock()?;
        let mut people = self.people()?;
        if people.values().any(|person| person.name == name) {
            return Err(wrong(&list)(&format!("{name:?} has a certificate: revoke that first")));
        }
        let bad = |error: rcgen::Error| wrong(&self.folder)(&error);
        let issuer = KeyPair::from_pem(&read_private(&self.folder.join(AUTHORITY_KEY))?).map_err(bad)?;
        let key = KeyPair::generate().map_err(bad)?;
        let params = leaf(name, CLIENT_DAYS, ExtendedKeyUsagePurpose::ClientAuth);
        let certificate = params.signed_by(&key, &Issuer::new(authority(), issuer)).map_err(bad)?;
        let ends_unix_s = u64::try_from(params.not_after.unix_timestamp()).unwrap_or_default();
        people.insert(fingerprint(certificate.der()), Person { name: name.into(), role, ends_unix_s });
        self.write_people(&people)?;
        Ok(certificate.pem() + &key.serialize_pem() + &super::read(&self.folder.join(AUTHORITY))?)
    }

    /// Everybody who may come in.
    ///
    /// # Errors
    /// A list that cannot be read: nobody is let in then.
    pub fn people(&self) -> Result<People, NetError> {
        people(&self.folder)
    }

    /// Takes the rights of a name away; returns how many certificates that were.
    ///
    /// # Errors
    /// Files that cannot be read or written.
    pub fn revoke(&self, name: &str) -> Result<usize, NetError> {
        let _locked = self.lock()?;
        let mut people = self.people()?;
        let before = people.len();
        people.retain(|_, person| person.name != name);
        self.write_people(&people)?;
        Ok(before - people.len())
    }

    fn write_people(&self, people: &People) -> Result<(), NetError> {
        let text = serde_json::to_string_pretty(people).map_err(|error| wrong(&self.folder)(&error))?;
        self.write(PEOPLE, &text)
    }

    /// Two programs that change the list at once would lose a change. Dropping the file unlocks it.
    fn lock(&self) -> Result<File, NetError> {
        let path = self.folder.join("lock");
        let locked = || {
            let file = OpenOptions::new().create(true).truncate(false).write(true).mode(0o600).open(&path)?;
            adopt(&path)?;
            file.lock()?;
            Ok(file)
        };
        locked().map_err(|error: std::io::Error| wrong(&path)(&error))
    }

    /// Replaces a file that only its owner may read, at once or not at all.
    fn write(&self, name: &str, text: &str) -> Result<(), NetError> {
        let (path, new) = (self.folder.join(name), self.folder.join(format!("{name}.new")));
        let write = || {
            let mut file =
                OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&new)?;
            file.write_all(text.as_bytes())?;
            file.sync_all()?;
            adopt(&new)?;
            fs::rename(&new, &path)
        };
        write().map_err(|error| wrong(&path)(&error))
    }
}

/// Gives a file that root has made to the owner of its folder, who could not read it otherwise.
fn adopt(file: &Path) -> std::io::Result<()> {
    let (made, folder) = (fs::metadata(file)?, fs::metadata(file.parent().unwrap_or(Path::new("/")))?);
    if made.uid() == 0 && folder.uid() != 0 {
        chown(file, Some(folder.uid()), Some(folder.gid()))?;
    }
    Ok(())
}

fn named(name: &str, days: i64) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params.not_before = OffsetDateTime::now_utc() - Duration::days(1);
    params.not_after = OffsetDateTime::now_utc() + Duration::days(days);
    params
}

fn authority() -> CertificateParams {
    let mut params = named("MOCA-S programs", ROBOT_DAYS);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    params
}

fn leaf(name: &str, days: i64, usage: ExtendedKeyUsagePurpose) -> CertificateParams {
    let mut params = named(name, days);
    params.extended_key_usages = vec![usage];
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params
}
