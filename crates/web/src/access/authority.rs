//! The robot's own certificate authority, constrained to the robot's names, and the server's certificate.
//!
//! A tablet trusts the authority once. Its key stays on the robot, readable by its owner only, so that the server's
//! certificate is renewed without touching a tablet. Whoever steals the folder can impersonate this robot, and only this
//! one: the name constraint binds every certificate that the authority signs.

use super::{
    devices::{now_unix_s, write_private},
    secret,
};
use anyhow::{Context, bail, ensure};
use rcgen::{
    BasicConstraints, CertificateParams, CidrSubnet, DnType, ExtendedKeyUsagePurpose, GeneralSubtree, IsCa,
    Issuer, KeyPair, KeyUsagePurpose, NameConstraints,
};
use rustls::{
    ServerConfig,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
};
use serde::{Deserialize, Serialize};
use std::{
    fs,
    net::IpAddr,
    path::{Path, PathBuf},
    sync::Arc,
};
use time::{Duration, OffsetDateTime};

/// Life of the authority, days.
const AUTHORITY_DAYS: i64 = 3650;
/// Life of the server's certificate, days: Safari takes at most 398.
const SERVER_DAYS: i64 = 397;
/// The server's certificate is renewed so long before its end, s.
const RENEW_BEFORE_S: u64 = 60 * 86_400;

/// A certificate of the site's own instead of the robot's.
#[derive(Clone, Debug)]
pub struct SiteCertificate {
    /// Chain in PEM, the server's certificate first.
    pub chain: PathBuf,
    /// Key in PEM.
    pub key: PathBuf,
}

/// The folder's record of its certificates.
#[derive(Serialize, Deserialize)]
struct Record {
    /// Names and addresses that the authority may vouch for.
    permitted: Vec<String>,
    /// Names and addresses of the server's certificate.
    names: Vec<String>,
    /// End of the server's certificate, s since the Unix epoch.
    until_unix_s: u64,
}

/// Certificates that a server shows.
pub(crate) struct Identity {
    /// Certificate of the authority in PEM, for tablets to trust; none with a site's own certificate.
    pub(crate) authority_pem: Option<String>,
    /// SHA-256 of the authority's certificate, for people to compare.
    pub(crate) fingerprint: Option<String>,
    /// For the acceptor.
    pub(crate) config: Arc<ServerConfig>,
}

/// Loads the certificates of a folder. The first call makes them, a later one renews the server's if it is due.
pub(crate) fn load(
    folder: &Path,
    names: &[String],
    site: Option<&SiteCertificate>,
) -> anyhow::Result<Identity> {
    if let Some(site) = site {
        let config = config(&site.chain, &site.key)?;
        return Ok(Identity { authority_pem: None, fingerprint: None, config });
    }
    let authority = folder.join("authority.pem");
    renew(folder, names)?;
    let authority_pem = fs::read_to_string(&authority).with_context(|| authority.display().to_string())?;
    let der = CertificateDer::from_pem_slice(authority_pem.as_bytes())?;
    let digits = secret::sha256(&der).to_uppercase();
    let pairs: Vec<&str> = digits.as_bytes().chunks(2).filter_map(|pair| str::from_utf8(pair).ok()).collect();
    let config = config(&folder.join("server.pem"), &folder.join("server-key.pem"))?;
    Ok(Identity { authority_pem: Some(authority_pem), fingerprint: Some(pairs.join(":")), config })
}

fn config(chain: &Path, key: &Path) -> anyhow::Result<Arc<ServerConfig>> {
    let certificates = CertificateDer::pem_file_iter(chain)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .with_context(|| format!("{} holds no certificates in PEM", chain.display()))?;
    let private = PrivateKeyDer::from_pem_file(key).with_context(|| key.display().to_string())?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])?
        .with_no_client_auth()
        .with_single_cert(certificates, private)
        .with_context(|| format!("{} and {} do not belong together", chain.display(), key.display()))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Arc::new(config))
}

/// Makes what is missing, and renews the server's certificate before its end or for other names.
fn renew(folder: &Path, names: &[String]) -> anyhow::Result<()> {
    ensure!(!names.is_empty(), "a certificate needs a name: give --name");
    let (record_file, key_file) = (folder.join("certificates.json"), folder.join("authority-key.pem"));
    let old: Option<Record> = match fs::read_to_string(&record_file) {
        Ok(text) => Some(serde_json::from_str(&text).with_context(|| record_file.display().to_string())?),
        Err(_) => None,
    };
    let permitted = match &old {
        Some(old) if old.names == names && old.until_unix_s > now_unix_s() + RENEW_BEFORE_S => return Ok(()),
        Some(old) => {
            if let Some(new) = names.iter().find(|name| !old.permitted.contains(name)) {
                bail!(
                    "the robot's authority may not vouch for {new:?}, only for {}: remove {} and start again, then let each \
                     tablet trust the new authority",
                    old.permitted.join(", "),
                    folder.join("certificates.json").display()
                );
            }
            old.permitted.clone()
        }
        None => names.to_vec(),
    };
    let key = if old.is_some() {
        let pem = fs::read_to_string(&key_file).with_context(|| key_file.display().to_string())?;
        KeyPair::from_pem(&pem)?
    } else {
        let key = KeyPair::generate()?;
        write_private(&key_file, &key.serialize_pem())?;
        let certificate = authority(&permitted).self_signed(&key)?;
        write_private(&folder.join("authority.pem"), &certificate.pem())?;
        key
    };
    let until = OffsetDateTime::now_utc() + Duration::days(SERVER_DAYS);
    let server_key = KeyPair::generate()?;
    let server = server(names, until)?.signed_by(&server_key, &Issuer::new(authority(&permitted), key))?;
    write_private(&folder.join("server-key.pem"), &server_key.serialize_pem())?;
    write_private(&folder.join("server.pem"), &server.pem())?;
    let until_unix_s = u64::try_from(until.unix_timestamp()).unwrap_or(0);
    let record = Record { permitted, names: names.to_vec(), until_unix_s };
    write_private(&record_file, &serde_json::to_string_pretty(&record)?)
}

fn authority(permitted: &[String]) -> CertificateParams {
    let mut params = CertificateParams::default();
    let robot = permitted.first().map_or("", String::as_str);
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, format!("MOCA-S robot {robot}"));
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    let permitted_subtrees = permitted.iter().map(|name| subtree(name)).collect();
    params.name_constraints = Some(NameConstraints { permitted_subtrees, excluded_subtrees: vec![] });
    params.not_before = OffsetDateTime::now_utc() - Duration::days(1);
    params.not_after = OffsetDateTime::now_utc() + Duration::days(AUTHORITY_DAYS);
    params
}

fn server(names: &[String], until: OffsetDateTime) -> anyhow::Result<CertificateParams> {
    let mut params = CertificateParams::new(names).context("a name is no host name or address")?;
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, names[0].clone());
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.use_authority_key_identifier_extension = true;
    params.not_before = OffsetDateTime::now_utc() - Duration::days(1);
    params.not_after = until;
    Ok(params)
}

fn subtree(name: &str) -> GeneralSubtree {
    match name.parse() {
        Ok(IpAddr::V4(ip)) => GeneralSubtree::IpAddress(CidrSubnet::V4(ip.octets(), [255; 4])),
        Ok(IpAddr::V6(ip)) => GeneralSubtree::IpAddress(CidrSubnet::V6(ip.octets(), [255; 16])),
        Err(_) => GeneralSubtree::DnsName(name.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustls::{
        RootCertStore,
        client::{WebPkiServerVerifier, danger::ServerCertVerifier},
        pki_types::{ServerName, UnixTime},
    };

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("moca-web-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    fn text(folder: &Path, file: &str) -> String {
        fs::read_to_string(folder.join(file)).unwrap()
    }

    #[test]
    fn key_of_another_certificate_is_refused_by_both_names() {
        let (one, other, own) = (folder("one"), folder("other"), names(&["robot.local"]));
        load(&one, &own, None).unwrap();
        load(&other, &own, None).unwrap();
        let site = SiteCertificate { chain: one.join("server.pem"), key: other.join("server-key.pem") };
        let error = format!("{:#}", load(&one, &own, Some(&site)).err().unwrap());
        assert!(error.contains("one/server.pem") && error.contains("other/server-key.pem"), "{error}");
        let site = SiteCertificate { key: one.join("server-key.pem"), ..site };
        assert!(load(&one, &own, Some(&site)).unwrap().authority_pem.is_none());
    }

    #[test]
    fn authority_vouches_for_the_names_of_its_robot_only() {
        let (folder, own) = (folder("names"), names(&["robot.local", "192.0.2.1"]));
        let pem = load(&folder, &own, None).unwrap().authority_pem.unwrap();
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from_pem_slice(pem.as_bytes()).unwrap()).unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let verifier =
            WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider).build().unwrap();
        let until = OffsetDateTime::now_utc() + Duration::days(SERVER_DAYS);
        for (name, vouches) in
            [("robot.local", true), ("192.0.2.1", true), ("evil.example", false), ("192.0.2.2", false)]
        {
            let key = KeyPair::from_pem(&text(&folder, "authority-key.pem")).unwrap();
            let (own_key, issuer) = (KeyPair::generate().unwrap(), Issuer::new(authority(&own), key));
            let signed = server(&names(&[name]), until).unwrap().signed_by(&own_key, &issuer).unwrap();
            let server_name = ServerName::try_from(name).unwrap();
            let verified = verifier.verify_server_cert(signed.der(), &[], &server_name, &[], UnixTime::now());
            assert_eq!(verified.is_ok(), vouches, "{name}: {verified:?}");
        }
    }

    #[test]
    fn certificate_near_its_end_is_renewed_by_the_same_authority() {
        let (folder, own) = (folder("renewal"), names(&["robot.local"]));
        load(&folder, &own, None).unwrap();
        let (authority, server) = (text(&folder, "authority.pem"), text(&folder, "server.pem"));
        load(&folder, &own, None).unwrap();
        assert_eq!(text(&folder, "server.pem"), server, "not due yet");
        let mut record: Record = serde_json::from_str(&text(&folder, "certificates.json")).unwrap();
        record.until_unix_s = now_unix_s() + RENEW_BEFORE_S - 1;
        write_private(&folder.join("certificates.json"), &serde_json::to_string(&record).unwrap()).unwrap();
        load(&folder, &own, None).unwrap();
        assert_ne!(text(&folder, "server.pem"), server);
        assert_eq!(text(&folder, "authority.pem"), authority);
    }

    #[test]
    fn name_beyond_the_authority_is_refused_with_what_to_do() {
        let folder = folder("beyond");
        load(&folder, &names(&["robot.local", "localhost"]), None).unwrap();
        load(&folder, &names(&["localhost"]), None).unwrap();
        let refused = load(&folder, &names(&["robot-2.local"]), None).err().unwrap().to_string();
        assert!(
            refused.contains("may not vouch for \"robot-2.local\"") && refused.contains("remove"),
            "{refused}"
        );
    }

    #[test]
    fn secrets_are_readable_by_their_owner_only() {
        use std::os::unix::fs::PermissionsExt;
        let folder = folder("secrets");
        load(&folder, &names(&["robot.local"]), None).unwrap();
        for file in ["authority-key.pem", "server-key.pem"] {
            let mode = fs::metadata(folder.join(file)).unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600, "{file}");
        }
    }
}
