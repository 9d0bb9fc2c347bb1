//! The words that a server and its clients share: rubbish is written into them, here and under a running server.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::Duration;

use trocar_client::SessionRequest;
use trocar_proto::endpoint::{Endpoint, Membership};
use trocar_proto::notify::doorbell::{Doorbell, SLOTS};
use trocar_proto::notify::reply_event::ReplyEvent;

use crate::hosted::{self, Known};
use crate::input::Input;

/// Most that is done with an input's words.
const MOST_ACTIONS: usize = 24;

/// Words that no server looks at, both sides of them.
struct Pair {
    made: (Doorbell, ReplyEvent),
    opened: (Doorbell, ReplyEvent),
    files: Vec<File>,
    _membership: Membership,
}

static PAIR: LazyLock<Mutex<Pair>> = LazyLock::new(|| {
    let name = format!("words-{}", std::process::id()).parse().expect("a name");
    let endpoint = Endpoint::new(&name);
    let membership = endpoint.join().expect("shared memory");
    let made = (
        Doorbell::make(&endpoint, 1).expect("made"),
        ReplyEvent::make(&endpoint, 1, 1).expect("made"),
    );
    let opened = (
        Doorbell::open(&endpoint, 1).expect("it is there"),
        ReplyEvent::open(&endpoint, 1, 1).expect("it is there"),
    );
    Mutex::new(Pair { made, opened, files: words_of(&endpoint, 1), _membership: membership })
});

/// A session of the server, and the files of all words.
static UNDER_A_SERVER: Mutex<Option<(Known, Vec<File>)>> = Mutex::new(None);

/// A byte that says whose words, and what is done with them.
pub(crate) fn run(data: &[u8]) {
    let mut input = Input::new(data);
    if input.byte() % 16 == 15 { under_a_server(input) } else { alone(input) }
}

/// The files with the words of a session and with the doorbell.
fn words_of(endpoint: &Endpoint, session: u64) -> Vec<File> {
    let files = endpoint.files().expect("a folder");
    let open = |end: &str| {
        let is_it = |path: &&PathBuf| path.to_string_lossy().ends_with(end);
        let path = files.iter().find(is_it).expect("words that a server has made");
        File::options().write(true).open(path).expect("words of this user")
    };
    vec![open(&format!(".{session}")), open(".doorbell")]
}

/// Writes any word anywhere.
fn scribble(files: &[File], input: &mut Input<'_>) {
    let file = &files[input.byte() as usize % files.len()];
    let at = u64::from(input.byte()) / 4 * 4;
    let room = file.metadata().expect("it is there").len().saturating_sub(at).min(8);
    file.write_all_at(&input.u64().to_le_bytes()[..room as usize], at).expect("it is written");
}

fn alone(mut input: Input<'_>) {
    let pair = PAIR.lock().unwrap_or_else(PoisonError::into_inner);
    let Pair { made: (server, replies), opened: (client, awaited), files, .. } = &*pair;
    for _ in 0..MOST_ACTIONS {
        if input.is_empty() {
            break;
        }
        let action = input.byte();
        let number = input.u32();
        match action % 8 {
            0 | 1 => scribble(files, &mut input),
            2 => {
                client.ring(number);
                assert!(server.is_rung(), "what rings is seen");
            }
            3 => {
                let taken: Vec<_> = server.take().collect();
                assert!(taken.iter().all(|slot| (*slot as usize) < SLOTS), "{taken:?}");
                assert!(taken.windows(2).all(|pair| pair[0] < pair[1]), "{taken:?}");
                assert!(!server.is_rung());
            }
            4 => server.advertise(number & 4 != 0),
            5 => {
                server.wake_all();
                server.sleep(number, Duration::ZERO);
            }
            6 => {
                if replies.signal() {
                    replies.wake();
                }
            }
            _ => {
                awaited.wait(awaited.count(), Duration::ZERO);
                assert!(!replies.signal(), "no client sleeps any more");
                let before = client.heartbeat();
                server.beat();
                assert_eq!(client.heartbeat(), before.wrapping_add(1));
            }
        }
    }
}

/// A server answers, and right, whatever stands in its words.
fn under_a_server(mut input: Input<'_>) {
    let server = hosted::server();
    let mut session = UNDER_A_SERVER.lock().unwrap_or_else(PoisonError::into_inner);
    let (known, files) = session.get_or_insert_with(|| {
        let known = server.open(&SessionRequest::new("EcmReach-v0").envs(2));
        let files = words_of(&server.endpoint, known.session.info().session);
        (known, files)
    });
    for _ in 0..MOST_ACTIONS {
        if input.is_empty() {
            break;
        }
        scribble(files, &mut input);
    }
    known.check();
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let action = |action: u8, number: u32| [vec![action], number.to_le_bytes().to_vec()].concat();
    let scribble = |file: u8, at: u8, word: u64| {
        [action(0, 0), vec![file, at], word.to_le_bytes().to_vec()].concat()
    };
    let mut seeds = vec![vec![]];
    for number in [0, 1, 2, 3, 63, 64, 127, 128, 1 << 20] {
        let actions: Vec<u8> = (2..8).flat_map(|each| action(each, number)).collect();
        seeds.push([vec![0], actions].concat());
    }
    for at in (0..=252).step_by(8) {
        let rubbish = [scribble(0, at, u64::MAX), scribble(1, at, u64::MAX)].concat();
        let actions: Vec<u8> = (2..8).flat_map(|each| action(each, 5)).collect();
        seeds.push([vec![0], rubbish, actions].concat());
    }
    for at in [0, 16, 64, 128] {
        seeds.push([vec![15, 0, at], vec![0xff; 8], vec![1, at], vec![0x7f; 8]].concat());
    }
    seeds
}
