//! TLS 1.3 with a pinned certificate: the host has one that it signed itself, and the ticket has its SHA-256.
//!
//! No certificate authority and no name take part: whoever holds a ticket knows exactly one certificate. Sessions are not
//! resumed and no early data is taken, so that nothing of one connection counts in another. The keys of datagrams come
//! from the exporter of this connection (RFC 8446, section 7.5).

use std::sync::Arc;

use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, WebPkiSupportedAlgorithms, ring as provider, verify_tls13_signature};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use rustls::version::TLS13;
use rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, Error, PeerMisbehaved, ServerConfig,
    SignatureScheme,
};

use crate::ticket::{Fingerprint, SERVER_NAME};

/// Application protocol that both ends ask for (RFC 7301).
const PROTOCOL: &[u8] = b"trocar/1";

/// The host's side.
///
/// # Errors
/// When the key does not fit the certificate.
pub fn host(
    certificate: CertificateDer<'static>,
    key: PrivateKeyDer<'static>,
) -> Result<Arc<ServerConfig>, Error> {
    let mut config = ServerConfig::builder_with_provider(Arc::new(provider::default_provider()))
        .with_protocol_versions(&[&TLS13])?
        .with_no_client_auth()
        .with_single_cert(vec![certificate], key)?;
    config.alpn_protocols = vec![PROTOCOL.to_vec()];
    config.send_tls13_tickets = 0;
    Ok(Arc::new(config))
}

/// The side of a client that accepts the certificate of this fingerprint, and no other.
///
/// # Errors
/// Never in practice: the provider knows TLS 1.3.
pub fn client(fingerprint: Fingerprint) -> Result<Arc<ClientConfig>, Error> {
    let provider = Arc::new(provider::default_provider());
    let verifier = Pinned { fingerprint, algorithms: algorithms(&provider) };
    let mut config = ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&TLS13])?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(verifier))
        .with_no_client_auth();
    config.alpn_protocols = vec![PROTOCOL.to_vec()];
    config.resumption = rustls::client::Resumption::disabled();
    config.enable_sni = false;
    Ok(Arc::new(config))
}

/// The name that a client passes to its connection. It is not sent, and means nothing: the certificate is pinned.
pub fn name() -> ServerName<'static> {
    ServerName::try_from(SERVER_NAME).expect("a valid name")
}

fn algorithms(provider: &CryptoProvider) -> WebPkiSupportedAlgorithms {
    provider.signature_verification_algorithms
}

/// Accepts one certificate.
#[derive(Debug)]
struct Pinned {
    fingerprint: Fingerprint,
    algorithms: WebPkiSupportedAlgorithms,
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        // The fingerprint is no secret, so the comparison need not be in constant time.
        if Fingerprint::of_certificate(certificate) == self.fingerprint {
            Ok(ServerCertVerified::assertion())
        } else {
            Err(Error::InvalidCertificate(CertificateError::ApplicationVerificationFailure))
        }
    }

    fn verify_tls12_signature(
        &self,
        _: &[u8],
        _: &CertificateDer<'_>,
        _: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Err(Error::PeerMisbehaved(PeerMisbehaved::SignedHandshakeWithUnadvertisedSigScheme))
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, certificate, signature, &self.algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ticket::Identity;
    use rustls::{ClientConnection, Connection, ServerConnection};

    /// Carries bytes between both ends until neither has any.
    fn handshake(client: &mut Connection, host: &mut Connection) -> Result<(), Error> {
        fn carry(from: &mut Connection, to: &mut Connection) -> Result<bool, Error> {
            let mut bytes = Vec::new();
            while from.wants_write() {
                from.write_tls(&mut bytes).expect("memory");
            }
            let mut rest = bytes.as_slice();
            while !rest.is_empty() {
                to.read_tls(&mut rest).expect("memory");
                to.process_new_packets()?;
            }
            Ok(!bytes.is_empty())
        }
        while carry(client, host)? | carry(host, client)? {}
        Ok(())
    }

    /// A host with a new identity, and a client that pins it, or something else.
    fn connect(pinned: Option<Fingerprint>) -> Result<(Connection, Connection), Error> {
        let identity = Identity::create(&"theatre 2".parse().expect("a name")).expect("an identity");
        let pinned = pinned.unwrap_or(identity.fingerprint());
        let mut client = Connection::from(ClientConnection::new(client(pinned)?, name())?);
        let key = identity.private_key().expect("a key");
        let mut host = Connection::from(ServerConnection::new(host(identity.certificate().clone(), key)?)?);
        handshake(&mut client, &mut host)?;
        Ok((client, host))
    }

    #[test]
    fn the_certificate_of_the_ticket_is_accepted_and_both_ends_export_the_same_keys() {
        let (client, host) = connect(None).expect("they meet");
        assert!(!client.is_handshaking() && !host.is_handshaking());
        let keys = |connection: &Connection, context: &[u8]| match connection {
            Connection::Client(client) => {
                client.export_keying_material([0; 88], b"EXPORTER-test", Some(context))
            }
            Connection::Server(server) => {
                server.export_keying_material([0; 88], b"EXPORTER-test", Some(context))
            }
        };
        let (ours, theirs) = (keys(&client, b"1").expect("exports"), keys(&host, b"1").expect("exports"));
        assert_eq!(ours, theirs);
        assert_ne!(ours, keys(&host, b"2").expect("exports"));
        let (_, another) = connect(None).expect("they meet");
        assert_ne!(ours, keys(&another, b"1").expect("exports"), "each connection has keys of its own");
    }

    #[test]
    fn another_certificate_is_refused_by_the_client() {
        let refused = connect(Some(Fingerprint::from_bytes([7; 32]))).map(drop).expect_err("it is refused");
        assert!(matches!(refused, Error::InvalidCertificate(_)), "{refused}");
    }
}
