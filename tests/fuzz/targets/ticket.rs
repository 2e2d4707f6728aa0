//! What people paste and type, and the file that a host keeps: tickets, addresses, names, traces of delays; the ticket book.
#![no_main]

use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::{Bound, first, first_chunk};
use trocar_network::impairments::{DELAY_MAX, DelayTrace, Impairments};
use trocar_network::reflector::Reflector;
use trocar_network::ticket::{
    HostAddress, Identity, NAME_MAX, PlainName, ResumeSecret, Role, Ticket, TicketId, TicketListing,
    TicketState, TicketStore, Token, Whom,
};
use trocar_scene::SimTime;

/// A character is four bytes when it is looked at, and a list of them doubles.
const TEXT: Bound = Bound { per_byte: 32, always: 16 << 10 };
/// A delay takes two bytes ("1\n") and is held as eight, in a vector that doubles.
const TRACE: Bound = Bound { per_byte: 16, always: 16 << 10 };
/// An entry takes at least 38 bytes and is held as 200; the certificate's parts are there several times.
const BOOK: Bound = Bound { per_byte: 64, always: 128 << 10 };

/// One file per process, in memory where the system offers that.
static FILE: LazyLock<PathBuf> = LazyLock::new(|| {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
    folder.join(format!("trocar-fuzz-{}.book", std::process::id()))
});
static HOST: LazyLock<PlainName> = LazyLock::new(|| "host".parse().expect("a name"));
/// Certificate and key, as the content of a book begins.
static IDENTITY: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let identity = Identity::create(&HOST).expect("the system gives random numbers");
    postcard::to_stdvec(&(identity.certificate_pem(), identity.key_pem())).expect("it encodes")
});

fuzz_target!(|bytes: &[u8]| {
    let (what, rest) = first(bytes);
    match what % 6 {
        0 => texts(rest),
        1 => line(rest),
        2 => trace(rest),
        3 => book(rest, 0),
        // The same with a right checksum, or with certificate and key before the input, at a time that it says.
        kind => {
            let (now, content) = first_chunk(rest);
            let before: &[u8] = if kind == 4 { &[] } else { &IDENTITY };
            book(&stored(&[before, content].concat()), u16::from_le_bytes(now).into());
        }
    }
});

fn texts(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(ticket) = TEXT.holds(text.len(), || text.parse::<Ticket>()) {
        assert_eq!(ticket.to_string().parse(), Ok(ticket));
    }
    if let Ok(address) = TEXT.holds(text.len(), || text.parse::<HostAddress>()) {
        assert_eq!(address.to_string().parse(), Ok(address));
    }
    if let Ok(name) = TEXT.holds(text.len(), || text.parse::<PlainName>()) {
        assert!((1..=NAME_MAX).contains(&name.as_str().len()) && name.as_str().trim() == name.as_str());
        assert_eq!(name.as_str().parse(), Ok(name.clone()));
    }
    // Words and numbers.
    let _ = (text.parse::<Role>(), text.parse::<TicketId>());
}

/// A ticket of any content with the right length and checksum. It is written in one way only.
fn line(content: &[u8]) {
    let mut summed = (content.len() as u16).to_le_bytes().to_vec();
    summed.extend_from_slice(content);
    let sum = crc32fast::hash(&summed);
    summed.extend(sum.to_le_bytes());
    let line = format!("trocar1{}", data_encoding::BASE32_NOPAD.encode(&summed).to_ascii_lowercase());
    if let Ok(ticket) = TEXT.holds(line.len(), || line.parse::<Ticket>()) {
        assert_eq!(ticket.to_string(), line);
    }
}

/// A trace of delays, and some datagrams along it.
fn trace(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Ok(trace) = TRACE.holds(text.len(), || DelayTrace::parse(text)) else { return };
    assert!(!trace.delays.is_empty() && trace.every > SimTime::ZERO);
    assert!(trace.delays.iter().all(|delay| *delay <= DELAY_MAX) && trace.mean() <= DELAY_MAX);
    let every = trace.every;
    let mut reflector = Reflector::new(&Impairments { trace, ..Impairments::default() }, 1);
    let mut now = SimTime::ZERO;
    for k in 0..8_u8 {
        reflector.receive(&[k], k, now);
        now += every;
        while let Some(parcel) = reflector.due(now) {
            assert_eq!(parcel.bytes, [parcel.to]);
        }
    }
    let left = std::iter::from_fn(|| reflector.due(now + DELAY_MAX)).count();
    assert!(left <= 8 && reflector.counts() == (8, 8, 0) && reflector.next_due().is_none());
}

/// The content of a book, as a file.
fn stored(content: &[u8]) -> Vec<u8> {
    let mut bytes = b"trcrbook".to_vec();
    bytes.extend(1_u32.to_le_bytes());
    bytes.extend((content.len() as u32).to_le_bytes());
    bytes.extend(7_u64.to_le_bytes());
    bytes.extend_from_slice(content);
    let sum = blake3::hash(&bytes);
    bytes.extend(sum.as_bytes());
    bytes
}

/// A book is opened or refused, and stays on the disk as it was; what is opened works and comes back.
fn book(bytes: &[u8], now: u64) {
    let file = &*FILE;
    let mut options = std::fs::File::options();
    let written = options.write(true).create(true).truncate(true).mode(0o600).open(file);
    let written = written.and_then(|mut file| std::io::Write::write_all(&mut file, bytes));
    written.expect("a file for the input");
    let opened = BOOK.holds(bytes.len(), || TicketStore::open(file, &HOST, |_| false));
    let mut store = match opened {
        Ok(store) => store,
        Err(error) => {
            assert!(error.to_string().contains("trocar-fuzz"), "{error}");
            assert!(std::fs::read(file).is_ok_and(|left| left == bytes), "a refused book stays as it is");
            return;
        }
    };
    let listed = store.book().list(now);
    assert!(listed.is_sorted_by_key(|ticket| ticket.id));
    let (token, resume) = (Token::from_bytes([1; 16]), ResumeSecret::from_bytes([2; 32]));
    let redeemed = store.redeem(&token, 3, &resume, now).expect("the file is there");
    if let Ok(admission) = redeemed {
        assert!(
            store.redeem(&token, 4, &resume, now).expect("the file is there").is_err(),
            "it lets in once"
        );
        assert_eq!(store.resume(&resume, now).expect("the file is there"), Ok(admission));
    }
    if let Some(TicketListing { id, .. }) = listed.first() {
        store.revoke(&Whom::Ticket(*id), now).expect("the file is there").expect("it is listed");
        assert!(store.book().is_revoked(*id) && store.book().list(now)[0].state == TicketState::Revoked);
    }
    let again = TicketStore::open(file, &HOST, |_| false).expect("it was just written");
    assert_eq!(again.book(), store.book());
}
