//! What the controller of the network and the hands link tell each other, over two bounded rings.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rtrb::{Consumer, Producer, RingBuffer};
use trocar_devices::Pedals;
use trocar_scene::SimTime;

use super::connection::Connection;
use crate::control::EchoCounts;
use crate::datagram::{DATAGRAM_MAX, HANDS_MAX, Header, Kind, PAYLOAD_MAX, ReceiveKey, SendKey};
use crate::diagnosis::EchoEnd;
use crate::haptic::{LinkPoint, Rate};

/// Most orders that wait for the hands link.
pub const ORDERS_MAX: usize = 256;
/// Most news that wait for the controller. A controller that is restarted finds the oldest; what does not fit is lost, as
/// on a path.
pub const NEWS_MAX: usize = 512;

/// The payload of a datagram, in place.
#[derive(Clone, Debug)]
pub struct Parcel {
    kind: Kind,
    length: u16,
    bytes: [u8; PAYLOAD_MAX],
}

impl Parcel {
    /// A copy of a payload; `None` if it is longer than one can be.
    pub fn new(kind: Kind, payload: &[u8]) -> Option<Self> {
        let mut bytes = [0; PAYLOAD_MAX];
        bytes.get_mut(..payload.len())?.copy_from_slice(payload);
        Some(Self { kind, length: payload.len() as u16, bytes })
    }

    /// What it is.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The payload.
    pub fn payload(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}

/// A sealed datagram that the control channel carries, in place.
#[derive(Clone, Debug)]
pub struct Sealed {
    length: u16,
    bytes: [u8; DATAGRAM_MAX],
}

impl Sealed {
    /// A copy of a datagram; `None` if it is longer than one can be.
    pub fn new(datagram: &[u8]) -> Option<Self> {
        let mut bytes = [0; DATAGRAM_MAX];
        bytes.get_mut(..datagram.len())?.copy_from_slice(datagram);
        Some(Self { length: datagram.len() as u16, bytes })
    }

    /// The datagram.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    /// The datagram, to be decrypted in place.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.bytes[..usize::from(self.length)]
    }

    /// Whether it says that it has hands, of which only the newest count.
    pub fn has_hands(&self) -> bool {
        Header::decode(self.bytes()).is_ok_and(|header| header.kind == Kind::Hands)
    }
}

/// Numbers of hands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HandNumbers {
    count: u8,
    numbers: [u8; HANDS_MAX],
}

impl HandNumbers {
    /// These, the first [`HANDS_MAX`] of them.
    pub fn new(hands: impl IntoIterator<Item = u8>) -> Self {
        let mut numbers = Self::default();
        for hand in hands.into_iter().take(HANDS_MAX) {
            numbers.numbers[usize::from(numbers.count)] = hand;
            numbers.count += 1;
        }
        numbers
    }

    /// The numbers.
    pub fn as_slice(&self) -> &[u8] {
        &self.numbers[..usize::from(self.count)]
    }
}

/// From the controller. What owns memory is made there, and comes back there to be freed; payloads lie in the ring.
pub enum HandsOrder<A> {
    /// A connection begins; one of the same station ends. A host has the station's number.
    Open {
        /// The station at the other end, for a host.
        station: u16,
        /// Its end here.
        connection: Box<Connection<A>>,
        /// Where the other end takes datagrams, if that is known before one has come from there.
        peer: Option<A>,
    },
    /// The station serves these hands from now on.
    Serve {
        /// The connection.
        connection: u32,
        /// The hands.
        hands: HandNumbers,
    },
    /// What the person at the station does with the pedals of a hand; to be said again and again.
    Press {
        /// The hand.
        hand: u8,
        /// Its pedals.
        pedals: Pedals,
    },
    /// The session goes on after a pause: a station brings its hands to where the host has them.
    Place,
    /// A connection to another station begins, at a station; one to the same ends.
    OpenPair {
        /// The other station.
        station: u16,
        /// Its end here.
        connection: Box<Connection<A>>,
        /// Where the other end takes datagrams, if that is known before one has come from there.
        peer: Option<A>,
    },
    /// The other station of a pair serves these hands from now on.
    ServePair {
        /// The other station.
        station: u16,
        /// The hands.
        hands: HandNumbers,
    },
    /// A pair is over.
    ClosePair {
        /// The other station.
        station: u16,
    },
    /// A datagram is to go.
    Send {
        /// The connection.
        connection: u32,
        /// Its payload.
        parcel: Parcel,
    },
    /// The control channel brought a datagram.
    Carried {
        /// The connection.
        connection: u32,
        /// The datagram.
        datagram: Sealed,
    },
    /// Whether the other end hears this one's datagrams by themselves.
    Heard {
        /// The connection.
        connection: u32,
        /// Whether it does.
        is_heard: bool,
    },
    /// The next phase's key of the other side.
    RekeyOpener {
        /// The connection.
        connection: u32,
        /// The key.
        key: ReceiveKey,
    },
    /// The next phase's own key.
    RekeySealer {
        /// The connection.
        connection: u32,
        /// The key.
        key: SendKey,
    },
    /// A connection is over, or a diagnosis.
    Close {
        /// The connection.
        connection: u32,
    },
    /// Somebody diagnoses the path, and his datagrams are echoed; at a host alone.
    Echo(Box<EchoEnd>),
    /// All connections are over: whoever gave the earlier orders is gone.
    CloseAll,
}

/// From the hands link. Payloads lie in the ring, since the link allocates nothing.
pub enum HandsNews<A> {
    /// A datagram came.
    Arrived {
        /// The connection.
        connection: u32,
        /// Its payload.
        parcel: Parcel,
        /// When it was sent, by this side's clock; `None` as long as the other clock is unknown.
        sent_at: Option<SimTime>,
    },
    /// The control channel is to carry a datagram, since the other end does not hear them by themselves.
    Carry {
        /// The connection.
        connection: u32,
        /// The datagram.
        datagram: Sealed,
    },
    /// Whether this end hears the other one's datagrams by themselves, which the other end is to be told.
    Hears {
        /// The connection.
        connection: u32,
        /// Whether it does.
        hears: bool,
    },
    /// A second of a connection is over.
    Second {
        /// The connection.
        connection: u32,
        /// What was counted.
        point: LinkPoint,
        /// The rate at which hands are sent at most.
        rate: Rate,
    },
    /// The keys of a connection should be replaced.
    Worn {
        /// The connection.
        connection: u32,
    },
    /// A connection that is over, to be freed.
    Closed(Box<Connection<A>>),
    /// What has come of a diagnosis's datagrams.
    Echoed {
        /// Its connection.
        connection: u32,
        /// The counts.
        counts: EchoCounts,
    },
    /// A diagnosis that is over, to be freed.
    EchoEnded(Box<EchoEnd>),
}

/// The controller's end. Clones share it, so that a machine which is made anew finds it where the last one has left it; no
/// two of them work at the same time.
pub struct ControllerEnd<A>(Arc<Mutex<Ends<A>>>);

struct Ends<A> {
    orders: Producer<HandsOrder<A>>,
    news: Consumer<HandsNews<A>>,
}

impl<A> Clone for ControllerEnd<A> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<A> ControllerEnd<A> {
    fn ends(&self) -> MutexGuard<'_, Ends<A>> {
        // Whoever panicked has left both rings whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives an order; false if there is no room for it.
    pub fn order(&self, order: HandsOrder<A>) -> bool {
        self.ends().orders.push(order).is_ok()
    }

    /// For how many orders there is room.
    pub fn room(&self) -> usize {
        self.ends().orders.slots()
    }

    /// The next news.
    pub fn next_news(&self) -> Option<HandsNews<A>> {
        self.ends().news.pop().ok()
    }
}

/// The end of the hands link.
pub struct LinkEnd<A> {
    /// Where orders come from.
    pub orders: Consumer<HandsOrder<A>>,
    /// Where news go.
    pub news: Producer<HandsNews<A>>,
}

impl<A> LinkEnd<A> {
    /// Tells something; what does not fit is lost, and freed here.
    pub fn tell(&mut self, news: HandsNews<A>) -> bool {
        self.news.push(news).is_ok()
    }
}

/// Both ends of the rings between a controller and its hands link.
pub fn hands_channel<A>() -> (ControllerEnd<A>, LinkEnd<A>) {
    let (order_in, order_out) = RingBuffer::new(ORDERS_MAX);
    let (news_in, news_out) = RingBuffer::new(NEWS_MAX);
    (
        ControllerEnd(Arc::new(Mutex::new(Ends { orders: order_in, news: news_out }))),
        LinkEnd { orders: order_out, news: news_in },
    )
}
