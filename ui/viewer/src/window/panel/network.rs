//! The links of a session over a network: who is there, and how far and how sure each station is.

use egui::{Color32, RichText, Ui};
use trocar_scene::{DeviceInfo, LinkState, SlaveState, Snapshot, Station, Teleoperation};

use super::{BAD, GOOD, POOR};

/// From this round trip on a link is poor for surgery, and from the next one bad \[s\] (Xu et al., 2014).
const POOR_FROM: f64 = 0.2;
const BAD_FROM: f64 = 0.5;
/// Share of lost datagrams from which a link is poor.
const LOSSY_FROM: f64 = 0.05;

/// What is said of a link whose datagrams are blocked.
const OVER_TCP: &str = "over TCP, since datagrams do not arrive: hands move at 100 Hz";

/// Draws the section, if others share the session.
pub(super) fn show(ui: &mut Ui, scene: &Snapshot) {
    let mut stations = stations(scene);
    stations.sort_by_key(|station| station.number);
    let (slaves, open) = (slaves(scene), open_devices(scene));
    if stations.is_empty() && slaves.is_empty() && open.is_empty() {
        return;
    }
    ui.separator();
    ui.label(RichText::new("network").strong());
    for (slave, colour) in slaves {
        ui.label(RichText::new(slave).color(colour));
    }
    for device in open {
        ui.label(RichText::new(device).color(BAD));
    }
    for station in stations {
        let link = &station.link;
        let colour = match link {
            _ if !station.here => BAD,
            LinkState { round_trip, .. } if *round_trip >= BAD_FROM => BAD,
            LinkState { over_tcp: true, .. } => POOR,
            LinkState { round_trip, loss, .. } if *round_trip >= POOR_FROM || *loss >= LOSSY_FROM => POOR,
            _ => GOOD,
        };
        ui.label(RichText::new(title(station)).color(colour));
        if station.here {
            ui.label(RichText::new(figures(link)).weak());
        }
        if station.here && link.over_tcp {
            ui.label(RichText::new(OVER_TCP).color(POOR));
        }
        if !station.protected {
            ui.label(
                RichText::new("unprotected: everybody on this machine can read and forge it").color(BAD),
            );
        }
    }
}

/// What the slaves of a tele-operation do, and how good that is.
fn slaves(scene: &Snapshot) -> Vec<(String, Color32)> {
    let line = |(hand, row): (_, &Teleoperation)| {
        let text = format!("slave of {}: {}", scene.name(hand), row.words());
        let colour = match row.state {
            SlaveState::Stopped | SlaveState::Unplugged => BAD,
            SlaveState::Following if row.protected => GOOD,
            _ => POOR,
        };
        (text, colour)
    };
    scene.iter::<Teleoperation>().map(line).collect()
}

/// Hands that strangers may move.
fn open_devices(scene: &Snapshot) -> Vec<String> {
    let open = scene.iter::<DeviceInfo>().filter(|(_, device)| device.is_unprotected());
    open.map(|(hand, device)| format!("{}: {}", scene.name(hand), device.model)).collect()
}

/// The stations as this one sees them: the host sees all, another one its own link.
fn stations(scene: &Snapshot) -> Vec<&Station> {
    let own = scene.iter::<Station>().map(|(entity, _)| entity.station()).max().unwrap_or(0);
    scene.iter::<Station>().filter(|(entity, _)| entity.station() == own).map(|(_, row)| row).collect()
}

fn title(station: &Station) -> String {
    let hands = station.hands.join(", ");
    let away = if station.here { "" } else { ", away" };
    if hands.is_empty() {
        format!("{}{away}", station.name)
    } else {
        format!("{}: {hands}{away}", station.name)
    }
}

fn figures(link: &LinkState) -> String {
    format!(
        "{:.0} ± {:.0} ms, {:.1} % lost, {:.0} ms old, {:.0} Hz, {:.0} kB/s in, {:.0} out",
        link.round_trip * 1e3,
        link.jitter * 1e3,
        link.loss * 100.0,
        link.age * 1e3,
        link.rate,
        link.bytes_received * 1e-3,
        link.bytes_sent * 1e-3,
    )
}

#[cfg(test)]
mod tests {
    use trocar_scene::{
        Commands, EnergyPedal, EntityAllocator, Name, Registry, SimTime, StationRole, Store, TeleoperationEnd,
    };

    use super::*;

    fn station(number: u16, hands: &[&str], here: bool) -> Station {
        Station {
            number,
            name: format!("station {number}"),
            role: StationRole::Operate,
            here,
            hands: hands.iter().map(|hand| (*hand).to_owned()).collect(),
            protected: true,
            link: LinkState {
                round_trip: 0.15,
                jitter: 0.002,
                loss: 0.01,
                age: 0.08,
                ..LinkState::default()
            },
        }
    }

    #[test]
    fn a_host_lists_all_stations_and_a_station_its_own_link() {
        let registry = Registry::standard();
        let mut store = Store::new(registry.clone());
        let mut put = |of: u16, row: Station| {
            let mut out = Commands::new(registry.clone(), EntityAllocator::new(of, 9));
            let entity = out.spawn();
            out.put(entity, row);
            out.seal();
            store.apply(&mut out, SimTime::ZERO);
        };
        put(0, station(1, &["left"], true));
        let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, 8));
        let entity = out.spawn();
        out.put(entity, station(2, &[], false));
        out.seal();
        store.apply(&mut out, SimTime::ZERO);
        let titles: Vec<String> = stations(&store.snapshot()).into_iter().map(title).collect();
        assert_eq!(titles.len(), 2);
        assert!(titles.contains(&"station 1: left".to_owned()), "{titles:?}");
        assert!(titles.contains(&"station 2, away".to_owned()), "{titles:?}");
        let mut out = Commands::new(registry, EntityAllocator::new(2, 1));
        let entity = out.spawn();
        out.put(entity, station(2, &[], true));
        out.seal();
        store.apply(&mut out, SimTime::ZERO);
        let titles: Vec<String> = stations(&store.snapshot()).into_iter().map(title).collect();
        assert_eq!(titles, ["station 2"]);
        let text = figures(&station(1, &[], true).link);
        assert!(text.starts_with("150 ± 2 ms, 1.0 % lost, 80 ms old"), "{text}");
    }

    #[test]
    fn a_slave_says_whether_it_follows_with_its_current_its_delay_and_who_else_may_move_it() {
        let registry = Registry::standard();
        let told = |row: Teleoperation| {
            let mut store = Store::new(registry.clone());
            let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, 9));
            let hand = out.spawn();
            out.put(hand, Name("hand.right".to_owned()));
            out.put(hand, row);
            out.seal();
            store.apply(&mut out, SimTime::ZERO);
            slaves(&store.snapshot()).remove(0)
        };
        let follows = Teleoperation {
            state: SlaveState::Following,
            pedals: EnergyPedal::Coagulate,
            round_trip: 0.1506,
            protected: true,
            ..Teleoperation::default()
        };
        let text = "slave of hand.right: following, coagulating, 150.6 ms behind, 0.00 N";
        assert_eq!(told(follows.clone()), (text.to_owned(), GOOD));
        let stopped = Teleoperation {
            end: TeleoperationEnd::Console,
            state: SlaveState::Stopped,
            pedals: EnergyPedal::Released,
            protected: false,
            ..follows
        };
        let text = "slave of hand.right: stopped, current off, 150.6 ms behind, 0.00 N, unprotected";
        assert_eq!(told(stopped), (text.to_owned(), BAD));
    }
}
