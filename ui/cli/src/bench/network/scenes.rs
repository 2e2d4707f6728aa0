//! Joining a session over TLS on the loopback, and coming back to it after a break, by the number of entities.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use trocar::network::datagram::Seal;
use trocar::network::live::tls;
use trocar::network::live::tls_host_streams::TlsHostStreams;
use trocar::network::live::tls_station_stream::TlsStationStream;
use trocar::network::ticket::HostAddress;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_scene::{Entity, Name, Pose, SimTime};

use super::Rows;
use super::pair::{Book, Pair};
use super::veth::Place;
use crate::failure::Failure;

const ENTITIES: [usize; 3] = [100, 1_000, 10_000];
const BLOCKS: usize = 3;
/// Time between two steps of a machine: that of its actor.
const STEP: Duration = Duration::from_millis(4);
/// Longest wait.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bar on coming back \[ms\].
const REJOIN_MAX_MS: f64 = 1_000.0;
/// One of so many entities has moved during the break.
const MOVED_SHARE: usize = 100;
/// Bytes of datagrams a second, as a session has them by default.
const BYTES_PER_SEC: f64 = 1e6;

/// What one block has shown.
pub(super) struct Block {
    pub join_ms: f64,
    pub join_bytes: f64,
    pub rejoin_ms: f64,
    pub rejoin_bytes: f64,
}

struct Live {
    pair: Pair<SocketAddr>,
    begun: Instant,
    /// The host's tickets, which it looks at again and again.
    _book: Book,
}

impl Live {
    fn now(&self) -> SimTime {
        SimTime::from(self.begun.elapsed())
    }

    /// Steps until something is so, and returns how long that took \[ms\].
    fn until(&mut self, what: &str, is_done: impl Fn(&Pair<SocketAddr>) -> bool) -> Result<f64, Failure> {
        let begun = Instant::now();
        while !is_done(&self.pair) {
            if begun.elapsed() > PATIENCE {
                return Err(Failure::internal(format!("{what}: it never happened")));
            }
            let stepped = Instant::now();
            let now = self.now();
            self.pair.step(now)?;
            std::thread::sleep(STEP.saturating_sub(stepped.elapsed()));
        }
        Ok(begun.elapsed().as_secs_f64() * 1e3)
    }
}

fn open(place: &Place, entities: usize) -> Result<(Live, Vec<Entity>), Failure> {
    let book = Book::new()?;
    let (sockets, socket) = place.host()?;
    let address = HostAddress::of_socket(socket).map_err(Failure::internal)?;
    let identity = book.identity();
    let key = identity.private_key().map_err(Failure::internal)?;
    let config = tls::host(identity.certificate().clone(), key).map_err(Failure::internal)?;
    let streams = TlsHostStreams::new(sockets.tcp, config, Seal::Aead).map_err(Failure::internal)?;
    let stream = TlsStationStream::new(vec![address.clone()], identity.fingerprint(), Seal::Aead)
        .map_err(Failure::internal)?;
    let credential = book.credential(address)?;
    let begun = Instant::now();
    let at = (socket, BYTES_PER_SEC);
    let mut pair = Pair::new(&book, Box::new(streams), Box::new(stream), credential, at, SimTime::ZERO)?;
    let scene = &mut pair.host;
    let all: Vec<Entity> = (0..entities).map(|_| scene.commands.spawn()).collect();
    for (number, entity) in all.iter().enumerate() {
        scene.commands.put(*entity, Name(format!("peg {number}")));
        scene.commands.put(*entity, Pose::at(1e-3 * number as f64, 0.0, 0.0));
    }
    scene.apply(SimTime::ZERO)?;
    Ok((Live { pair, begun, _book: book }, all))
}

pub(super) fn block(place: &Place, entities: usize) -> Result<Block, Failure> {
    let (mut live, all) = open(place, entities)?;
    let join_ms = live.until("a join", Pair::is_running)?;
    if live.pair.station.store.view().iter::<Pose>().count() != entities {
        return Err(Failure::internal("the scene that was joined is not whole"));
    }
    let join_bytes = live.pair.bytes() as f64;
    live.pair.cutter.cut();
    live.until("a break", |pair| !pair.is_running())?;
    // What happens while the station is away.
    let last = all[all.len() - 1];
    for entity in all.iter().step_by(MOVED_SHARE) {
        live.pair.host.commands.put(*entity, Pose::at(0.5, 0.25, 0.0));
    }
    live.pair.host.commands.despawn(last);
    let now = live.now();
    live.pair.host.apply(now)?;
    let before = live.pair.bytes();
    let rejoin_ms = live.until("a return", |pair| {
        let view = pair.station.store.view();
        let has_moved = view.get::<Pose>(all[0]).is_some_and(|pose| (pose.translation.x - 0.5).abs() < 1e-3);
        pair.is_running() && has_moved && !view.contains(last)
    })?;
    Ok(Block { join_ms, join_bytes, rejoin_ms, rejoin_bytes: (live.pair.bytes() - before) as f64 })
}

/// Joins and returns at each number of entities.
pub fn joins() -> Rows {
    let mut rows = Vec::new();
    for entities in ENTITIES {
        let blocks = (0..BLOCKS)
            .map(|_| block(&Place::Loopback, entities))
            .collect::<Result<Vec<Block>, Failure>>()?;
        let mut row = |what: &str, unit: &str, value: fn(&Block) -> f64, bar| {
            let values: Vec<f64> = blocks.iter().map(value).collect();
            let name = format!("network_{what}_{entities}_entities");
            rows.push(BenchResult::on_value(name, unit, median_and_spread(&values), bar, Better::Lower));
        };
        row("join", "ms", |block| block.join_ms, None);
        row("join_bytes", "B", |block| block.join_bytes, None);
        row("rejoin", "ms", |block| block.rejoin_ms, Some(REJOIN_MAX_MS));
        row("rejoin_bytes", "B", |block| block.rejoin_bytes, None);
    }
    Ok(rows)
}
