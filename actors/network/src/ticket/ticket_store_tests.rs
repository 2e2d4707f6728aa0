//! Tests of the book on disk: restarts, several processes, damage.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use proptest::prelude::*;
use ring::rand::SystemRandom;
use tempfile::TempDir;

use super::ticket_book_tests::{HOUR, NOW, name, offer, resume_secret};
use super::*;

struct Kept {
    _folder: TempDir,
    file: PathBuf,
}

/// Gives up at once.
fn never(_: u32) -> bool {
    false
}

fn patiently(tries: u32) -> bool {
    thread::sleep(Duration::from_millis(1));
    tries < 20_000
}

impl Kept {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        Self { file: folder.path().join("state/host.book"), _folder: folder }
    }

    fn host(&self) -> TicketStore {
        TicketStore::open_host(&self.file, &name("Saal 3"), never).expect("it opens")
    }

    fn command(&self) -> TicketStore {
        TicketStore::open(&self.file, &name("Saal 3"), patiently).expect("it opens")
    }

    fn refused(&self) -> StoreError {
        TicketStore::open_host(&self.file, &name("Saal 3"), never).expect_err("it is refused")
    }
}

fn issue(store: &mut TicketStore, person: &str) -> (TicketId, Token) {
    let issued = store.issue(offer(Role::Operate, person), NOW, &SystemRandom::new());
    let (id, ticket) = issued.expect("the file").expect("a ticket");
    (id, ticket.token().clone())
}

fn redeem(store: &mut TicketStore, token: &Token, now: u64) -> Result<Admission, Refused> {
    store.redeem(token, 1, &resume_secret(1), now).expect("the file")
}

#[test]
fn certificate_spent_tokens_and_withdrawals_survive_a_restart() {
    let kept = Kept::new();
    let mut host = kept.host();
    let fingerprint = host.book().identity().fingerprint();
    let (_, spent) = issue(&mut host, "Ana");
    let (withdrawn, withdrawn_token) = issue(&mut host, "Bo");
    let (_, open) = issue(&mut host, "Cy");
    let admission = redeem(&mut host, &spent, NOW).expect("it lets in");
    host.revoke(&Whom::Ticket(withdrawn), NOW).expect("the file").expect("it is known");
    let listed = host.book().list(NOW);
    drop(host);

    let mut host = kept.host();
    assert_eq!(host.book().identity().fingerprint(), fingerprint);
    assert_eq!(host.book().list(NOW), listed);
    assert_eq!(redeem(&mut host, &spent, NOW + 1), Err(Refused::Spent { at: NOW }));
    assert_eq!(redeem(&mut host, &withdrawn_token, NOW + 1), Err(Refused::Revoked { at: NOW }));
    assert_eq!(host.resume(&resume_secret(1), NOW + 1).expect("the file"), Ok(admission));
    let expired = redeem(&mut host, &open, NOW + 2 * HOUR);
    assert_eq!(expired, Err(Refused::Expired { expired_at: NOW + HOUR, now: NOW + 2 * HOUR }));
}

#[test]
fn a_token_is_spent_on_the_disk_when_the_station_hears_of_it() {
    let kept = Kept::new();
    let mut host = kept.host();
    let (_, token) = issue(&mut host, "Ana");
    redeem(&mut host, &token, NOW).expect("it lets in");
    // The host is killed now: what another process reads is all that there is.
    let mut other = kept.command();
    assert_eq!(redeem(&mut other, &token, NOW + 1), Err(Refused::Spent { at: NOW }));
    drop(host);
}

#[test]
fn a_book_that_cannot_be_written_lets_nobody_in_and_spends_nothing() {
    let kept = Kept::new();
    let mut host = kept.host();
    let (_, token) = issue(&mut host, "Ana");
    // Something that no writer can remove is where the new file would be made.
    let part = kept.file.with_file_name("host.book.part");
    fs::create_dir_all(part.join("in the way")).expect("a folder");
    let failed = host.redeem(&token, 1, &resume_secret(1), NOW);
    assert!(matches!(failed, Err(StoreError::File(_))), "{failed:?}");
    fs::remove_dir_all(&part).expect("it is removed");
    assert!(redeem(&mut host, &token, NOW).is_ok(), "the ticket is as good as before");
}

#[test]
fn a_second_host_is_refused_until_the_first_one_ends() {
    let kept = Kept::new();
    let host = kept.host();
    let refused = kept.refused();
    assert!(matches!(&refused, StoreError::HostRuns(_)), "{refused}");
    assert!(refused.to_string().contains("host.book: another host runs with this file"), "{refused}");
    drop(host);
    kept.host();
}

#[cfg(unix)]
#[test]
fn a_link_to_the_book_of_a_running_host_is_no_way_around_its_lock() {
    let kept = Kept::new();
    let _host = kept.host();
    let link = kept.file.with_file_name("link");
    std::os::unix::fs::symlink(&kept.file, &link).expect("a link");
    let refused = TicketStore::open_host(&link, &name("x"), never);
    assert!(matches!(refused, Err(StoreError::HostRuns(_))), "{refused:?}");
}

#[test]
fn tickets_are_given_out_and_withdrawn_beside_a_running_host() {
    let kept = Kept::new();
    let mut host = kept.host();
    let (id, token) = issue(&mut kept.command(), "Ana");
    let admission = redeem(&mut host, &token, NOW).expect("the host knows of it");
    assert_eq!(admission.ticket, id);
    assert!(!host.refresh().expect("the file"), "nothing has changed");
    let whom = Whom::Person(name("Ana"));
    let revoked = kept.command().revoke(&whom, NOW + 1).expect("the file").expect("she is known");
    assert_eq!(revoked.stations, [1]);
    assert!(!host.book().is_revoked(id));
    assert!(host.refresh().expect("the file"));
    assert!(host.book().is_revoked(id));
    let back = host.resume(&resume_secret(1), NOW + 2).expect("the file");
    assert_eq!(back, Err(Refused::Revoked { at: NOW + 1 }));
}

#[test]
fn of_many_that_redeem_a_token_at_once_one_succeeds_and_no_ticket_is_lost() {
    let kept = Kept::new();
    let (_, token) = issue(&mut kept.command(), "Ana");
    let let_in: usize = thread::scope(|scope| {
        let one = || {
            let mut store = kept.command();
            issue(&mut store, "Bo");
            usize::from(redeem(&mut store, &token, NOW).is_ok())
        };
        let all: Vec<_> = (0..8).map(|_| scope.spawn(one)).collect();
        all.into_iter().map(|thread| thread.join().expect("no panic")).sum()
    });
    assert_eq!(let_in, 1);
    let numbers: Vec<String> =
        kept.host().book().list(NOW).iter().map(|listed| listed.id.to_string()).collect();
    assert_eq!(numbers, ["1", "2", "3", "4", "5", "6", "7", "8", "9"]);
}

#[test]
fn a_change_waits_for_another_one_only_as_long_as_it_may() {
    let kept = Kept::new();
    let mut host = kept.host();
    let held = private_file::FileLock::take(host.file(), ".lock").expect("a lock").expect("it is free");
    let busy = host.issue(offer(Role::Watch, "Ana"), NOW, &SystemRandom::new());
    assert!(matches!(busy, Err(StoreError::Busy(_))), "{busy:?}");
    drop(held);
    issue(&mut host, "Ana");
}

#[test]
fn every_damage_is_found_and_the_file_left_as_it_is() {
    let kept = Kept::new();
    issue(&mut kept.host(), "Ana");
    let whole = fs::read(&kept.file).expect("it is read");
    let mut damages: Vec<Vec<u8>> = (0..whole.len()).step_by(29).map(|cut| whole[..cut].to_vec()).collect();
    for at in (0..whole.len()).step_by(11) {
        let mut flipped = whole.clone();
        flipped[at] ^= 0x10;
        damages.push(flipped);
    }
    damages.push([&whole[..], b"x"].concat());
    for damage in damages {
        fs::write(&kept.file, &damage).expect("it is damaged");
        let refused = kept.refused();
        use StoreError::{Damaged, NewerVersion, NoBook};
        assert!(matches!(&refused, Damaged { .. } | NoBook(_) | NewerVersion { .. }), "{refused}");
        assert_eq!(fs::read(&kept.file).expect("it is read"), damage);
    }
    fs::write(&kept.file, &whole).expect("it is mended");
    assert_eq!(kept.host().book().list(NOW).len(), 1);
}

#[cfg(unix)]
#[test]
fn a_book_that_others_can_read_is_refused_with_what_to_do() {
    use std::os::unix::fs::PermissionsExt;
    let kept = Kept::new();
    issue(&mut kept.host(), "Ana");
    let mode = fs::metadata(&kept.file).expect("it is there").permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    fs::set_permissions(&kept.file, fs::Permissions::from_mode(0o644)).expect("a mode");
    let refused = kept.refused().to_string();
    assert!(refused.contains("its mode is 644") && refused.contains("chmod 600"), "{refused}");
    fs::set_permissions(&kept.file, fs::Permissions::from_mode(0o600)).expect("a mode");
    assert_eq!(kept.host().book().list(NOW).len(), 1, "nothing is lost");
}

#[test]
fn a_running_host_notices_that_its_book_was_removed_or_put_back() {
    let kept = Kept::new();
    let mut host = kept.host();
    let (_, token) = issue(&mut host, "Ana");
    let old = fs::read(&kept.file).expect("it is read");
    redeem(&mut host, &token, NOW).expect("it lets in");
    let new = fs::read(&kept.file).expect("it is read");

    private_file::write(&kept.file, &old).expect("the old one is put back");
    let refused = host.redeem(&token, 2, &resume_secret(2), NOW + 1);
    assert!(matches!(refused, Err(StoreError::Replaced { .. })), "{refused:?}");
    fs::remove_file(&kept.file).expect("it is removed");
    assert!(matches!(host.refresh(), Err(StoreError::Replaced { what: "removed", .. })));
    kept.command();
    assert!(matches!(host.refresh(), Err(StoreError::Replaced { .. })), "that of another host");

    private_file::write(&kept.file, &new).expect("the right one is put back");
    assert_eq!(redeem(&mut host, &token, NOW + 1), Err(Refused::Spent { at: NOW }));
}

#[test]
fn the_file_has_no_token_and_no_resume_secret() {
    let kept = Kept::new();
    let mut host = kept.host();
    let (_, token) = issue(&mut host, "Ana");
    redeem(&mut host, &token, NOW).expect("it lets in");
    let bytes = fs::read(&kept.file).expect("it is read");
    let holds = |secret: &[u8]| bytes.windows(secret.len()).any(|window| window == secret);
    assert!(!holds(token.as_bytes()) && !holds(&[1; 32]));
    assert!(holds(b"Ana"), "it is the right file");
}

#[test]
fn a_full_book_is_written_and_read() {
    let kept = Kept::new();
    let mut host = kept.host();
    let mut book = host.book().clone();
    for _ in 1..ENTRIES_MAX {
        book.issue(offer(Role::Operate, &"x".repeat(NAME_MAX)), NOW, &SystemRandom::new()).expect("room");
    }
    ticket_store::write(host.file(), 77, &book).expect("it is written");
    let (last, token) = issue(&mut host, "Ana");
    assert_eq!(last.to_string(), ENTRIES_MAX.to_string());
    drop(host);
    assert_eq!(redeem(&mut kept.host(), &token, NOW).map(|admission| admission.ticket), Ok(last));
}

proptest! {
    #[test]
    fn any_bytes_are_no_book_and_any_content_with_its_checksum_is_one_or_refused(
        mut bytes in prop::collection::vec(any::<u8>(), 0..200), version in 0_u32..3, count in 0_u32..220,
    ) {
        let file = Path::new("host.book");
        prop_assert!(matches!(ticket_store::decode(file, &bytes), Err(StoreError::NoBook(_))));
        let content = bytes.len() as u32;
        let head: Vec<u8> = [&b"trcrbook"[..], &version.to_le_bytes(), &count.to_le_bytes(), &[0; 8]].concat();
        bytes.splice(0..0, head);
        let sum = blake3::hash(&bytes);
        bytes.extend(sum.as_bytes());
        match ticket_store::decode(file, &bytes) {
            Err(StoreError::NewerVersion { found, .. }) => prop_assert!(found == version && version > 1),
            Err(StoreError::Damaged { .. }) => prop_assert!(version <= 1),
            Err(error) => prop_assert!(false, "{}", error),
            Ok(_) => prop_assert!(version == 1 && count == content),
        }
    }
}
