//! The path to the host of a ticket: each step is tried, and what was found is told.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use trocar::network::control::Credential;
use trocar::network::credential_of;
use trocar::network::datagram::Seal;
use trocar::network::live::reach::{examine, reach};
use trocar::network::live::store_admissions::unix_secs;

use super::Check;
use super::path_findings::{Examination, checks};
use crate::failure::Failure;
use crate::join::ticket_in;

/// Steps of the bar.
const STEPS: u64 = 100;

/// Looks at the path to the host of the ticket in a file. The ticket's token is not spent.
pub fn path(file: &Path, insecure: bool, is_silent: bool) -> Result<Vec<Check>, Failure> {
    let ticket = ticket_in(file)?;
    let bar = if is_silent { ProgressBar::hidden() } else { ProgressBar::new(STEPS) };
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg} {wide_bar}") {
        bar.set_style(style);
    }
    bar.set_message("looking for the host");
    bar.tick();
    let reached = reach(ticket.addresses(), *ticket.fingerprint()).map_err(Failure::internal)?;
    let host = reached.iter().find_map(|reached| reached.host);
    let seal = if insecure { Seal::Checksum } else { Seal::Aead };
    let examined = host.map(|(address, _)| {
        bar.set_message("sending datagrams");
        let credential: Credential = credential_of(&ticket)?;
        let version = env!("CARGO_PKG_VERSION");
        let mut show = |share: f64| bar.set_position((share * STEPS as f64) as u64);
        let (found, is_refused) =
            examine(address, *ticket.fingerprint(), seal, credential, version, &mut show)
                .map_err(Failure::usage)?;
        Ok::<_, Failure>(Examination { found, is_refused, unix_secs: unix_secs() })
    });
    bar.finish_and_clear();
    Ok(checks(&ticket, &reached, examined.transpose()?.as_ref()))
}
