//! The certificate by which stations know a host, and its key.

use std::fmt;

use rcgen::{CertificateParams, DistinguishedName, DnType, KeyPair};
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::sign::CertifiedKey;
use thiserror::Error;

use super::fingerprint::Fingerprint;
use super::plain_name::PlainName;

/// The name that every host's certificate is for, and that stations ask for in the TLS handshake. It tells nothing: the
/// fingerprint alone says which host it is.
pub const SERVER_NAME: &str = "trocar-host";

/// A self-signed certificate and its key. It has no end: the tickets that carry its fingerprint have one.
#[derive(Clone)]
pub struct Identity {
    certificate: CertificateDer<'static>,
    certificate_pem: String,
    key_pem: String,
}

/// Why there is no identity.
#[derive(Debug, Error)]
pub enum IdentityError {
    /// The system gives no random numbers, or the library fails.
    #[error("no certificate can be made: {0}")]
    Make(#[from] rcgen::Error),
    /// A certificate or key that is no PEM.
    #[error("the {0} is not in PEM format")]
    Pem(&'static str),
    /// A key that TLS cannot use, or that of another certificate.
    #[error("the key does not fit the certificate: {0}")]
    Key(#[from] rustls::Error),
}

impl Identity {
    /// A new one, with a key of its own (ECDSA over P-256). The name is shown to whoever looks into the certificate.
    ///
    /// # Errors
    /// [`IdentityError::Make`].
    pub fn create(name: &PlainName) -> Result<Self, IdentityError> {
        let mut wanted = CertificateParams::new([SERVER_NAME.to_owned()])?;
        wanted.distinguished_name = DistinguishedName::new();
        wanted.distinguished_name.push(DnType::CommonName, name.as_str());
        let key = KeyPair::generate()?;
        let certificate = wanted.self_signed(&key)?;
        Self::from_pem(certificate.pem(), key.serialize_pem())
    }

    /// One that was kept.
    ///
    /// # Errors
    /// [`IdentityError::Pem`], and [`IdentityError::Key`] when key and certificate do not belong together.
    pub fn from_pem(certificate_pem: String, key_pem: String) -> Result<Self, IdentityError> {
        let certificate = CertificateDer::from_pem_slice(certificate_pem.as_bytes())
            .map_err(|_| IdentityError::Pem("certificate"))?
            .into_owned();
        let identity = Self { certificate, certificate_pem, key_pem };
        identity.certified_key()?;
        Ok(identity)
    }

    /// SHA-256 of the certificate, as in tickets.
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of_certificate(&self.certificate)
    }

    /// The certificate.
    pub fn certificate(&self) -> &CertificateDer<'static> {
        &self.certificate
    }

    /// The certificate as it is kept. It is public.
    pub fn certificate_pem(&self) -> &str {
        &self.certificate_pem
    }

    /// The key as it is kept. Whoever has it can stand in for the host.
    pub fn key_pem(&self) -> &str {
        &self.key_pem
    }

    /// The key for a TLS server.
    ///
    /// # Errors
    /// [`IdentityError::Pem`].
    pub fn private_key(&self) -> Result<PrivateKeyDer<'static>, IdentityError> {
        PrivateKeyDer::from_pem_slice(self.key_pem.as_bytes()).map_err(|_| IdentityError::Pem("key"))
    }

    /// Certificate and key for a TLS server, checked to belong together.
    ///
    /// # Errors
    /// [`IdentityError::Pem`] and [`IdentityError::Key`].
    pub fn certified_key(&self) -> Result<CertifiedKey, IdentityError> {
        let chain = vec![self.certificate.clone()];
        Ok(CertifiedKey::from_der(chain, self.private_key()?, &default_provider())?)
    }
}

/// By the certificate, which stands for its key.
impl PartialEq for Identity {
    fn eq(&self, other: &Self) -> bool {
        self.certificate == other.certificate
    }
}

impl Eq for Identity {}

impl fmt::Debug for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Identity").field("fingerprint", &self.fingerprint()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn created(name: &str) -> Identity {
        Identity::create(&name.parse().expect("a name")).expect("an identity")
    }

    #[test]
    fn an_identity_comes_back_from_its_pem_with_the_same_fingerprint() {
        let identity = created("Saal 3");
        let again = Identity::from_pem(identity.certificate_pem().into(), identity.key_pem().into());
        assert_eq!(again.expect("it is valid").fingerprint(), identity.fingerprint());
        assert_eq!(identity.fingerprint(), Fingerprint::of_certificate(identity.certificate()));
        assert_ne!(created("Saal 3").fingerprint(), identity.fingerprint(), "two hosts with one name");
    }

    #[test]
    fn the_key_of_another_certificate_is_refused() {
        let (one, other) = (created("one"), created("other"));
        let mixed = Identity::from_pem(one.certificate_pem().into(), other.key_pem().into());
        assert!(matches!(mixed, Err(IdentityError::Key(_))), "{mixed:?}");
        let none = Identity::from_pem("none".into(), other.key_pem().into());
        assert!(matches!(none, Err(IdentityError::Pem("certificate"))));
        let none = Identity::from_pem(one.certificate_pem().into(), "none".into());
        assert!(matches!(none, Err(IdentityError::Pem("key"))));
    }

    #[test]
    fn nothing_of_the_key_is_in_the_debug_text() {
        let identity = created("one");
        let shown = format!("{identity:?}");
        assert!(shown.contains(&identity.fingerprint().to_string()) && !shown.contains("PRIVATE"), "{shown}");
        assert!(!identity.key_pem().lines().any(|line| shown.contains(line)));
    }
}
