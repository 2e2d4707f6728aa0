//! A session that is reached by Zenoh.

use std::sync::LazyLock;

use trocar::app::App;
use trocar::network::Network;
use trocar::run::Progress;
use trocar::summary::Exit;
use trocar_scene::{Access, Name};
use trocar_zenoh::hand::{self, HandBoard};
use trocar_zenoh::live::{Bridge, NodeError, SessionFacts, SessionGuests};
use trocar_zenoh::remote_controller::RemoteController;
use trocar_zenoh::rights::Rights;
use trocar_zenoh::settings::NodeSettings;

use super::wish::Wish;
use crate::escape::printable;
use crate::failure::Failure;
use crate::output;

/// Name of the session's guest.
const GUEST: &str = "zenoh";
/// Looks of the session from one word on its actors' health to the next.
const HEALTH_EVERY: u32 = 12;

/// The hands of this program that may be commanded: devices are made where no node is known.
static BOARD: LazyLock<HandBoard> = LazyLock::new(HandBoard::default);

/// Adds hands that are commanded from elsewhere.
pub fn with_devices(app: App) -> App {
    app.device_with(hand::USAGE, hand::ABOUT, |text| BOARD.device(text))
}

/// Settings and rights of a text.
pub(super) fn settings(option: &str, text: &str) -> Result<(NodeSettings, Rights), Failure> {
    let settings: NodeSettings = text.parse().map_err(|error| Failure::usage(format!("{option}{error}")))?;
    let rights = match &settings.config {
        Some(file) => Rights::read(file).map_err(|error| Failure::invalid(format!("{option}{error}")))?,
        None => Rights::default(),
    };
    Ok((settings, rights))
}

/// The class of a failure.
pub(super) fn failure(error: &NodeError) -> Failure {
    let exit = match error {
        NodeError::Settings(_) | NodeError::NameTaken(_) => Exit::Usage,
        NodeError::Open { .. } => Exit::Unavailable,
        NodeError::Controller(_) => Exit::Invalid,
        NodeError::System(_) => Exit::Internal,
    };
    Failure { exit, message: printable(&error.to_string()) }
}

/// A session's node.
pub struct Beyond {
    bridge: Bridge,
    /// Until the session runs.
    controllers: Option<Vec<RemoteController>>,
    looks: u32,
    failed: Option<Failure>,
}

impl Beyond {
    /// Opens the node that `--zenoh` asks for, before the session and its devices.
    pub fn open(wish: &Wish<'_>) -> Result<Option<Self>, Failure> {
        let Some(text) = wish.text else { return Ok(None) };
        let (settings, rights) = settings("--zenoh: ", text)?;
        let name = settings.name.clone().unwrap_or_else(|| wish.scenario.name.clone());
        let is_protected = settings.is_protected();
        // A station tells that it is there; the host has the scene, and those who command.
        let station = wish.network.station().map(|station| station.number);
        let of_session = rights.controllers.iter().filter(|_| station.is_none());
        let controllers: Vec<RemoteController> = of_session.cloned().map(RemoteController::new).collect();
        for controller in &controllers {
            controller.access(wish.first).map_err(|reason| Failure::invalid(format!("--zenoh: {reason}")))?;
        }
        match station {
            Some(_) => BOARD.close(),
            None => BOARD.open(is_protected),
        }
        let facts = SessionFacts {
            name: name.clone(),
            scenario: wish.scenario.name.clone(),
            is_hosted: matches!(wish.network, Network::Host(_)),
            station,
        };
        let bridge = Bridge::open(&settings, &rights, &facts, &BOARD).map_err(|error| {
            BOARD.close();
            failure(&error)
        })?;
        if !wish.is_silent {
            let places: Vec<String> =
                settings.listen.iter().chain(&settings.connect).map(ToString::to_string).collect();
            let who = if is_protected {
                "for those who have a right to it"
            } else if station.is_some() {
                "unprotected: whoever is on this machine sees that it is there"
            } else {
                "unprotected: whoever is on this machine reads it, and commands what it lets be commanded"
            };
            output::tell(&format!("on Zenoh as '{}', {} ({who})", printable(&name), places.join(", ")));
        }
        let controllers = station.is_none().then_some(controllers);
        Ok(Some(Self { bridge, controllers, looks: 0, failed: None }))
    }

    /// Joins the session when it runs, and tells how its actors do.
    pub fn serve(&mut self, progress: &mut Progress<'_>) {
        if let Some(controllers) = self.controllers.take() {
            match guests(progress, controllers) {
                Ok(guests) => self.bridge.start(guests),
                Err(failure) => {
                    self.failed = Some(failure);
                    progress.end = true;
                }
            }
        }
        if self.looks.is_multiple_of(HEALTH_EVERY) {
            let health = progress.session.health();
            self.bridge.tell_health(health.into_iter().map(|(name, how)| (name, how.to_owned())).collect());
        }
        self.looks = self.looks.wrapping_add(1);
    }

    /// Ends it; says why it never began, if it did not.
    pub fn close(self) -> Result<(), Failure> {
        let counts = self.bridge.counts();
        drop(self.bridge);
        BOARD.close();
        if counts.failed + counts.refused > 0 {
            tracing::warn!(
                "Zenoh: {} messages were told, {} not, and {} requests found no room",
                counts.told,
                counts.failed,
                counts.refused
            );
        }
        self.failed.map_or(Ok(()), Err)
    }
}

/// The session's guests: who reads, and a writer for each controller elsewhere, which the Model checks.
fn guests(progress: &mut Progress<'_>, controllers: Vec<RemoteController>) -> Result<SessionGuests, Failure> {
    let wrong = |error: &dyn std::fmt::Display| Failure::invalid(format!("--zenoh: {error}"));
    let reader =
        progress.session.guest(GUEST, &Access::new().reads::<Name>()).map_err(|error| wrong(&error))?;
    let mut joined = Vec::with_capacity(controllers.len());
    for controller in controllers {
        let access = controller.access(progress.scene).map_err(|error| wrong(&error))?;
        let name = format!("{GUEST}.{}", controller.right().name);
        let guest = progress.session.guest_with_answers(&name, &access).map_err(|error| wrong(&error))?;
        joined.push((controller, guest));
    }
    Ok(SessionGuests { reader, controllers: joined })
}
