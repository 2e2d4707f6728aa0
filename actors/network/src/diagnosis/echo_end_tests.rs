//! What a stranger gets of an echo: nothing; and whoever asks, as much as he sent.

use trocar_scene::SimTime;

use super::{ECHOES_MAX, EchoEnd, NEWS_EVERY};
use crate::control::EchoCounts;
use crate::datagram::{DATAGRAM_MAX, Keys, Kind, Opener, PAYLOAD_MAX, Sealer, Side};

const MS: fn(u64) -> SimTime = SimTime::from_millis;

fn keys(byte: u8) -> Keys {
    let made = Keys::from_exporter(7, 0, |_, _, out: &mut [u8]| {
        out.fill(byte);
        Ok::<(), ()>(())
    });
    made.expect("keys")
}

fn ends() -> (EchoEnd, Sealer, Opener) {
    let (send, receive) = keys(1).split(Side::Client);
    (EchoEnd::new(7, keys(1)), Sealer::new(send), Opener::new(receive, SimTime::ZERO))
}

#[test]
fn an_echo_is_as_long_as_its_question_and_the_same() {
    let (mut end, mut sealer, mut opener) = ends();
    let (mut question, mut answer) = ([0; DATAGRAM_MAX], [0; DATAGRAM_MAX]);
    for bytes in [0, 24, PAYLOAD_MAX] {
        let length = sealer.seal(Kind::Echo, 0, MS(1), &vec![9; bytes], &mut question).expect("sealed");
        let answered = end.answer(MS(2), &mut question[..length], &mut answer).expect("an answer");
        assert_eq!(answered, length);
        let (header, payload) = opener.open(MS(3), &mut answer[..answered]).expect("it is authentic");
        assert_eq!((header.kind, payload), (Kind::Echo, &vec![9; bytes][..]));
    }
    assert_eq!(end.news(MS(3)), Some(EchoCounts { short: 2, long: 1 }));
}

#[test]
fn nothing_answers_a_stranger_a_repetition_another_kind_or_one_too_many() {
    let (mut end, mut sealer, _) = ends();
    let (mut question, mut answer) = ([0; DATAGRAM_MAX], [0; DATAGRAM_MAX]);
    let mut ask = |end: &mut EchoEnd, sealer: &mut Sealer, kind| {
        let length = sealer.seal(kind, 0, MS(1), b"there", &mut question).expect("sealed");
        let copy = question[..length].to_vec();
        (end.answer(MS(2), &mut question[..length], &mut answer), copy)
    };
    let (stranger, _) = keys(2).split(Side::Client);
    assert_eq!(ask(&mut end, &mut Sealer::new(stranger), Kind::Echo).0, None, "a stranger");
    assert_eq!(ask(&mut end, &mut sealer, Kind::Rows).0, None, "no echo");
    let (first, mut again) = ask(&mut end, &mut sealer, Kind::Echo);
    assert!(first.is_some());
    assert_eq!(end.answer(MS(3), &mut again, &mut [0; DATAGRAM_MAX]), None, "a repetition");
    for _ in 1..ECHOES_MAX {
        assert!(ask(&mut end, &mut sealer, Kind::Echo).0.is_some());
    }
    assert_eq!(ask(&mut end, &mut sealer, Kind::Echo).0, None, "one too many");
}

#[test]
fn counts_are_told_when_they_have_changed_and_not_too_often() {
    let (mut end, mut sealer, _) = ends();
    let mut ask = |end: &mut EchoEnd| {
        let mut question = [0; DATAGRAM_MAX];
        let length = sealer.seal(Kind::Echo, 0, MS(1), b"there", &mut question).expect("sealed");
        end.answer(MS(1), &mut question[..length], &mut [0; DATAGRAM_MAX]).expect("an answer");
    };
    assert_eq!(end.news(MS(0)), None);
    ask(&mut end);
    assert_eq!(end.news(MS(1)), Some(EchoCounts { short: 1, long: 0 }));
    assert_eq!(end.news(MS(500)), None, "nothing has changed");
    ask(&mut end);
    assert_eq!(end.news(MS(501)), Some(EchoCounts { short: 2, long: 0 }));
    ask(&mut end);
    assert_eq!(end.news(MS(502)), None, "it is too early");
    assert_eq!(end.news(MS(501) + NEWS_EVERY), Some(EchoCounts { short: 3, long: 0 }));
}
