//! Certificates of those who take part beyond one machine: an authority of one's own, and a certificate for each person or
//! site that it signs. The name in a certificate is what rights are given to.
//!
//! The authority's key stays where certificates are made; nodes need `authority.pem`, and their own two files.

use std::fs;
use std::path::{Path, PathBuf};

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer,
    KeyPair, KeyUsagePurpose,
};
use thiserror::Error;
use trocar_network::ticket::private_file;

use crate::keys::check_name;

/// The authority's own name.
const AUTHORITY: &str = "trocar-zenoh-authority";
/// Most addresses of a certificate.
const ADDRESSES_MAX: usize = 16;

/// Why there is no certificate.
#[derive(Debug, Error)]
pub enum CertificateError {
    /// A name or an address.
    #[error("{0}")]
    Usage(String),
    /// A file.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: String,
    },
    /// The library.
    #[error("no certificate can be made: {0}")]
    Make(#[from] rcgen::Error),
}

/// Files of a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CertificateFiles {
    /// The authority's certificate.
    pub authority: PathBuf,
    /// The certificate.
    pub certificate: PathBuf,
    /// Its key, which only its owner can read.
    pub key: PathBuf,
}

/// Makes a certificate for a name in a folder, and the authority if the folder has none. `addresses` are the names and IP
/// addresses under which others call it, besides this machine.
///
/// # Errors
/// [`CertificateError`]; a certificate of this name that is there is never overwritten.
pub fn make(folder: &Path, name: &str, addresses: &[String]) -> Result<CertificateFiles, CertificateError> {
    check_name(name).map_err(CertificateError::Usage)?;
    if name.starts_with("authority") {
        return Err(CertificateError::Usage("'authority' is the name of who signs".to_owned()));
    }
    if addresses.len() > ADDRESSES_MAX {
        return Err(CertificateError::Usage(format!("at most {ADDRESSES_MAX} addresses")));
    }
    let files = CertificateFiles {
        authority: folder.join("authority.pem"),
        certificate: folder.join(format!("{name}.pem")),
        key: folder.join(format!("{name}.key")),
    };
    fs::create_dir_all(folder).map_err(|error| at(folder, error))?;
    for file in [&files.certificate, &files.key] {
        if file.exists() {
            return Err(at(file, "it is there already; choose another name, or move it away"));
        }
    }
    let issuer = authority(folder, &files.authority)?;
    let mut subject = vec![name.to_owned(), "localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
    subject.extend(addresses.iter().cloned());
    let mut wanted = CertificateParams::new(subject)?;
    wanted.distinguished_name = called(name);
    wanted.use_authority_key_identifier_extension = true;
    wanted.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    wanted.extended_key_usages =
        vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
    let key = KeyPair::generate()?;
    let certificate = wanted.signed_by(&key, &issuer)?;
    private_file::write(&files.key, key.serialize_pem().as_bytes()).map_err(|error| at(&files.key, error))?;
    fs::write(&files.certificate, certificate.pem()).map_err(|error| at(&files.certificate, error))?;
    Ok(files)
}

/// The authority of a folder; made if there is none.
fn authority(folder: &Path, certificate: &Path) -> Result<Issuer<'static, KeyPair>, CertificateError> {
    let key_file = folder.join("authority.key");
    let wanted = authority_params();
    match (certificate.exists(), key_file.exists()) {
        (true, true) => {
            let pem = fs::read_to_string(&key_file).map_err(|error| at(&key_file, error))?;
            let key = KeyPair::from_pem(&pem).map_err(|error| at(&key_file, error))?;
            Ok(Issuer::new(wanted, key))
        }
        (false, false) => {
            let key = KeyPair::generate()?;
            let made = wanted.self_signed(&key)?;
            private_file::write(&key_file, key.serialize_pem().as_bytes())
                .map_err(|error| at(&key_file, error))?;
            fs::write(certificate, made.pem()).map_err(|error| at(certificate, error))?;
            Ok(Issuer::new(wanted, key))
        }
        (true, false) => Err(at(&key_file, "the authority's key is not here; make certificates where it is")),
        (false, true) => Err(at(certificate, "the authority's certificate is not here, and its key is")),
    }
}

/// What is signed in the authority's name is found by this name and its key.
fn authority_params() -> CertificateParams {
    let mut wanted = CertificateParams::default();
    wanted.distinguished_name = called(AUTHORITY);
    wanted.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    wanted.key_usages =
        vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign, KeyUsagePurpose::DigitalSignature];
    wanted
}

fn called(name: &str) -> DistinguishedName {
    let mut called = DistinguishedName::new();
    called.push(DnType::CommonName, name);
    called
}

fn at(file: &Path, reason: impl ToString) -> CertificateError {
    CertificateError::File { file: file.to_owned(), reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_authority_and_no_certificate_is_overwritten() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path().join("new");
        let host = make(&folder, "host", &["192.0.2.7".into(), "site-a.example".into()]).expect("made");
        let first = fs::read(&host.authority).expect("the authority");
        make(&folder, "ana", &[]).expect("made");
        assert_eq!(fs::read(&host.authority).expect("the authority"), first);
        let again = make(&folder, "host", &[]).expect_err("refused").to_string();
        assert!(again.contains("host.pem") && again.contains("already"), "{again}");
        for name in ["", "a/b", "../up", "authority"] {
            assert!(make(&folder, name, &[]).is_err(), "{name}");
        }
        fs::remove_file(folder.join("authority.key")).expect("removed");
        assert!(make(&folder, "bo", &[]).expect_err("refused").to_string().contains("where it is"));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = host.key.metadata().expect("a file").permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
    }
}
