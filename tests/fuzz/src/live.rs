//! Commands, ticks and questions to a live world, in a server of this process.

use trocar_client::{CallError, LiveWorld, SessionRequest};
use trocar_proto::wire::{Header, LiveRequestLayout, Region, kind};

use crate::control::check;
use crate::hosted;
use crate::input::Input;

/// Most messages of an input, and most commands of a message.
const MOST_MESSAGES: usize = 6;
const MOST_COMMANDS: u8 = 4;

/// Ticks of a message, unless it asks for any number of them.
const MOST_TICKS: u32 = 64;

/// Where a command has its topic, its numbers, their counts, its text and that text's length, bytes.
const TOPIC: usize = 4;
const NUMBERS: usize = 8;
const COUNTS: usize = NUMBERS + 24 * 8;
const TEXT: usize = COUNTS + 8;
const LENGTH: usize = TEXT + 256;

/// Places of topics, as in [`TOPICS`](trocar_proto::dvrk::record::TOPICS).
const STATE_COMMAND: u8 = 0;
const SERVO_JP: u8 = 3;
const MOVE_JP: u8 = 9;
const MOVE_CP: u8 = 11;

/// What commands often say.
const WORDS: [&str; 8] =
    ["", "enable", "home", "disable", "pause", "resume", "PSM1_base", "LARGE_NEEDLE_DRIVER:400006"];

const ASKS: u8 = 16;
const ANY_TICKS: u8 = 32;

/// Messages: a form that says whether it is a question and how many commands there are, flags, ticks, commands. The
/// same ones must lead to the same bits twice.
pub(crate) fn run(data: &[u8]) {
    let server = hosted::server();
    let played = [(); 2].map(|()| {
        let request = SessionRequest::new("NeedleReach-v0").seed(7);
        let mut world = server.client.open_live(&request).expect("there is room");
        play(&mut world, Input::new(data))
    });
    assert_eq!(played[0], played[1], "the same messages, the same bits");
}

/// What was answered, and what is there in the end.
fn play(world: &mut LiveWorld, mut input: Input<'_>) -> Vec<String> {
    let mut told = vec![];
    for _ in 0..MOST_MESSAGES {
        if input.is_empty() {
            break;
        }
        match message(world, &mut input) {
            Ok(()) => {}
            Err(CallError::Refused(refusal)) => {
                check(&refusal);
                told.push(format!("{} {}", refusal.field, refusal.allowed));
            }
            Err(other) => panic!("{other}"),
        }
    }
    world.look().expect("a live world answers");
    let arm = world.arm("PSM1").expect("it has this arm");
    let numbers = arm.measured_position.iter().chain(&arm.setpoint_position);
    assert!(numbers.chain(&arm.measured_cp).all(|number| number.is_finite()), "{arm:?}");
    told.push(format!("{:?} {:?}", arm.operating_state(), arm.measured_position));
    told.push(format!("{:?} {:?}", world.object("needle"), world.observation()));
    told
}

fn message(world: &mut LiveWorld, input: &mut Input<'_>) -> Result<(), CallError> {
    let (form, flags) = (input.byte(), input.byte());
    let rows = u32::from(form % MOST_COMMANDS);
    let info = world.info();
    let header = Header {
        flags: u32::from(flags % 4),
        session: info.session,
        epoch: info.epoch,
        rows,
        ..Header::new(if form & ASKS == 0 { kind::LIVE } else { kind::ASK })
    };
    let ticks = input.u32();
    let ticks = if form & ANY_TICKS == 0 { ticks % MOST_TICKS } else { ticks };
    let LiveRequestLayout { ticks: at, commands, question, .. } = LiveRequestLayout::new();
    let asked = (form & ASKS != 0).then(|| record(question, input));
    let records: Vec<_> = (0..rows).map(|_| record(commands, input)).collect();
    world.call_raw(header, |payload| {
        payload.fill(0);
        payload[at.offset..at.offset + 4].copy_from_slice(&ticks.to_le_bytes());
        let mut write = |offset: usize, bytes: &[u8]| {
            payload[offset..offset + bytes.len()].copy_from_slice(bytes);
        };
        for (index, record) in records.iter().enumerate() {
            write(commands.offset + index * commands.element, record);
        }
        if let Some(asked) = &asked {
            write(question.offset, asked);
        }
    })
}

/// A command or a question, whose beginnings are alike: the arm, the topic, numbers of a byte or of eight, their counts,
/// and a text.
fn record(region: Region, input: &mut Input<'_>) -> Vec<u8> {
    let mut bytes = vec![0; LENGTH + 8];
    bytes[0] = input.byte();
    bytes[TOPIC] = input.byte();
    let [first, second] = [input.byte(), input.byte()];
    bytes[COUNTS] = first;
    bytes[COUNTS + 4] = second;
    for place in 0..usize::from(first % 25) + usize::from(second % 25) {
        let small = input.byte();
        let number = match small {
            0x80 => f64::from_bits(input.u64()),
            small => f64::from(small as i8) / 100.0,
        };
        if let Some(room) = bytes.get_mut(NUMBERS + 8 * place..NUMBERS + 8 * place + 8) {
            room.copy_from_slice(&number.to_le_bytes());
        }
    }
    let word = input.byte();
    let text = match WORDS.get(usize::from(word)) {
        Some(text) => text.as_bytes(),
        None => input.take(usize::from(word)),
    };
    bytes[TEXT..TEXT + text.len()].copy_from_slice(text);
    bytes[LENGTH] = text.len() as u8;
    bytes.truncate(region.element);
    bytes
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let command = |topic: u8, numbers: &[u8], word: u8| {
        [&[0, topic, numbers.len() as u8, 0], numbers, &[word]].concat()
    };
    let send = |command: &[u8], ticks: u8| [&[1, 0, ticks, 0, 0, 0], command].concat();
    let ready =
        [send(&command(STATE_COMMAND, &[], 1), 1), send(&command(STATE_COMMAND, &[], 2), 63)];
    let ready = ready.concat();
    let joints: &[u8] = &[10, 20, 12, 0, 5, 0];
    // 0.12 m below the remote centre, unturned; in the base frame.
    let move_cp = [0, MOVE_CP, 3, 4, 0, 0, 0xf4, 0, 0, 0, 100, 6];
    let mut seeds = vec![
        [ready.clone(), send(&command(SERVO_JP, joints, 0), 20)].concat(),
        [ready.clone(), send(&command(MOVE_JP, joints, 0), 63)].concat(),
        [ready.clone(), send(&move_cp, 63)].concat(),
        // Ticks without end, and a question about a pose.
        vec![ANY_TICKS, 0, 0xff, 0xff, 0xff, 0xff],
        [&[ASKS, 0, 0, 0, 0, 0, 0, 2, 7, 6][..], &[0, 0, 0xf4, 0, 0, 0, 100], joints].concat(),
        // Numbers that are none.
        [ready.clone(), send(&command(SERVO_JP, &[0x80, 0, 0, 0, 0, 0, 0, 0xf8, 0x7f], 0), 1)]
            .concat(),
    ];
    for topic in 0..32 {
        seeds.push([ready.clone(), send(&command(topic, joints, 3), 9)].concat());
    }
    for which in 0..7 {
        seeds.push([&[ASKS, 0, 0, 0, 0, 0, 0, which, 6, 0][..], joints].concat());
    }
    seeds
}
