//! The command line of sessions beyond one machine: `trocar zenoh`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueHint};

use super::values::positive;

/// `trocar zenoh`.
#[derive(Debug, Args)]
pub struct ZenohArgs {
    /// What to do
    #[command(subcommand)]
    pub command: ZenohCommand,
}

/// What to do with Zenoh.
#[derive(Debug, Subcommand)]
pub enum ZenohCommand {
    /// List the sessions that are there, who takes part in them, and who is alive
    List(ZenohListArgs),
    /// Route between sites: sessions call it, and everybody who may sees all of them
    Router(ZenohRouterArgs),
    /// Make a certificate for a person or a site, and the authority that signs it if there is none
    Certificate(ZenohCertificateArgs),
}

/// `trocar zenoh list`.
#[derive(Debug, Args)]
pub struct ZenohListArgs {
    /// Whom to call, such as tcp/127.0.0.1:7447 or `connect=tls/router.example:7447,config=zenoh.toml`
    #[arg(default_value = "")]
    pub endpoint: String,
    /// Look on for this much time, in seconds, and tell who comes and goes
    #[arg(long, value_parser = positive)]
    pub seconds: Option<f64>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// `trocar zenoh router`.
#[derive(Debug, Args)]
pub struct ZenohRouterArgs {
    /// Where to listen, and which routers to call, such as
    /// `listen=tls/0.0.0.0:7447,connect=tls/site-b.example:7447,config=router.toml`
    #[arg(default_value = "")]
    pub endpoint: String,
    /// End after this much time, in seconds; otherwise when a signal comes
    #[arg(long, value_parser = positive)]
    pub seconds: Option<f64>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// `trocar zenoh certificate`.
#[derive(Debug, Args)]
pub struct ZenohCertificateArgs {
    /// The folder of the authority, and of what it signs
    #[arg(value_hint = ValueHint::DirPath)]
    pub folder: PathBuf,
    /// The name, to which rights are given
    pub name: String,
    /// A name or IP address by which others call it; may be given several times
    #[arg(long = "address", value_name = "ADDRESS")]
    pub addresses: Vec<String>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}
