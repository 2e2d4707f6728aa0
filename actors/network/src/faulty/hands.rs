//! Faults of the datagrams of a hands link, in both directions.

use std::sync::Arc;

use trocar_kernel::faults::LinkFaults;
use trocar_kernel::spec::FaultOrder;
use trocar_scene::SimTime;

use super::board::LinkBoard;
use crate::datagram::Header;
use crate::hands_link::HandsLink;
use crate::reflector::Parcel;

/// The paths of one connection's datagrams.
struct Paths<A> {
    connection: Option<u32>,
    /// Orders that were looked at.
    looked_at: usize,
    inbound: LinkFaults<Parcel<A>>,
    outbound: LinkFaults<Parcel<A>>,
}

impl<A> Paths<A> {
    fn is_of(&self, connection: Option<u32>) -> bool {
        self.connection.is_none() || self.connection == connection
    }
}

/// A hands link whose datagrams meet the faults of a board on their way. What is under way is bounded
/// ([`LINK_WAITING_MAX`](trocar_kernel::faults::LINK_WAITING_MAX)). It allocates while a fault lasts.
pub struct FaultyHands<A> {
    inner: Box<dyn HandsLink<A>>,
    board: Arc<LinkBoard>,
    version: Option<u64>,
    paths: Vec<Paths<A>>,
    heard: Vec<Option<u32>>,
}

impl<A: Copy + Send + 'static> FaultyHands<A> {
    /// This link under these faults.
    pub fn new(inner: Box<dyn HandsLink<A>>, board: Arc<LinkBoard>) -> Self {
        Self { inner, board, version: None, paths: Vec::new(), heard: Vec::new() }
    }

    /// Takes in what has changed on the board.
    fn look(&mut self) {
        let version = self.board.version();
        if self.version == Some(version) {
            return;
        }
        let mut before = std::mem::take(&mut self.paths);
        let paths = &mut self.paths;
        let is_seen = self.board.look(|connection, orders| {
            let known = before.iter().position(|paths| paths.connection == connection);
            let mut own = known.map_or_else(|| Paths::new(connection), |at| before.swap_remove(at));
            let from = own.looked_at;
            for (index, order) in orders.skip_while(|(index, _)| *index < from) {
                own.looked_at = index + 1;
                own.inbound.apply(order);
                let other = FaultOrder { seed: order.seed.wrapping_add(1), ..order.clone() };
                own.outbound.apply(&other);
            }
            paths.push(own);
        });
        if is_seen {
            self.version = Some(version);
        } else {
            self.paths = before;
        }
    }

    fn deliver(
        &mut self,
        now: SimTime,
        connection: Option<u32>,
        from: A,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let Self { inner, paths, heard, .. } = self;
        if let Some(path) = paths.iter().find(|paths| paths.is_of(connection)) {
            heard.push(path.connection);
        }
        inner.receive(now, from, datagram, &mut |to, bytes| send_over(paths, now, to, bytes, send));
    }
}

impl<A> Paths<A> {
    fn new(connection: Option<u32>) -> Self {
        Self { connection, looked_at: 0, inbound: LinkFaults::default(), outbound: LinkFaults::default() }
    }
}

fn connection_of(datagram: &[u8]) -> Option<u32> {
    Header::decode(datagram).ok().map(|header| header.connection)
}

/// Sends a datagram, or gives it to the faults of its connection.
fn send_over<A: Copy>(
    paths: &mut [Paths<A>],
    now: SimTime,
    to: A,
    bytes: &[u8],
    send: &mut dyn FnMut(A, &[u8]) -> bool,
) -> bool {
    let connection = connection_of(bytes);
    match paths.iter_mut().find(|paths| paths.is_of(connection)) {
        Some(path) if !path.outbound.is_idle() => {
            path.outbound.send(now, Parcel { to, bytes: bytes.to_vec() });
            true
        }
        _ => send(to, bytes),
    }
}

impl<A: Copy + Send + 'static> HandsLink<A> for FaultyHands<A> {
    fn receive(
        &mut self,
        now: SimTime,
        from: A,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let connection = connection_of(datagram);
        let path = self.paths.iter_mut().find(|paths| paths.is_of(connection));
        match path.filter(|path| !path.inbound.is_idle()) {
            Some(path) => path.inbound.send(now, Parcel { to: from, bytes: datagram.to_vec() }),
            None => self.deliver(now, connection, from, datagram, send),
        }
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        self.look();
        for at in 0..self.paths.len() {
            while let Some(Parcel { to: from, mut bytes }) = self.paths[at].inbound.due(now) {
                let connection = self.paths[at].connection;
                self.deliver(now, connection, from, &mut bytes, send);
            }
        }
        let Self { inner, paths, board, heard, .. } = self;
        inner.tick(now, &mut |to, bytes| send_over(paths, now, to, bytes, send));
        for path in paths.iter_mut() {
            while let Some(Parcel { to, bytes }) = path.outbound.due(now) {
                send(to, &bytes);
            }
        }
        board.heard(now, heard);
    }

    fn is_idle(&self) -> bool {
        self.inner.is_idle()
    }
}
