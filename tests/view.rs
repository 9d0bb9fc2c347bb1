//! The live viewer: what it says of sessions and their environments, and that it harms none of them.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Instant;

use rustix::process::Signal;
use serde_json::{Value, json};
use trocar_client::proto::dvrk::{Command, Homing, LiveRequest, StateCommand};
use trocar_client::{Autoreset, Code, LiveWorld, Options, SessionRequest};
use trocar_server::render::Jaws;
use trocar_server::sim::frames::Pose;
use trocar_server::view::message::{self, ENDED, HAS_ENDOSCOPE, STEP};
use trocar_server::view::{MOST_CONNECTIONS, MOST_PAGES};
use trocar_server::{Env, Registry};
use tungstenite::client::client;
use tungstenite::error::Error;
use tungstenite::handshake::HandshakeError;
use tungstenite::{Message, WebSocket};

use crate::harness::{PATIENCE, eventually};
use crate::live::refused;
use crate::operation::{Logged, get};
use crate::twin::Bystander;

/// A server with a viewer, and where that is.
struct Theatre {
    logged: Logged,
    address: String,
}

impl Theatre {
    fn open() -> Self {
        let logged = Logged::start(&["--view", "0", "--threads", "2"]);
        let address = logged.line("serving")["view"].as_str().unwrap().to_string();
        assert!(address.starts_with("127.0.0.1:"), "{address}");
        Self { logged, address }
    }

    fn page(&self) -> Page {
        Page::connect(&self.address)
    }
}

/// A page without a browser.
struct Page(WebSocket<TcpStream>);

/// What a frame says.
#[derive(Debug, Default)]
struct Frame {
    scene: u32,
    flags: u32,
    steps: u32,
    seed: u64,
    stage: u32,
    endoscope: Vec<f32>,
    poses: Vec<f32>,
    contacts: Vec<f32>,
    jaws: Vec<f32>,
    /// Rewards and flags.
    marks: Vec<(f32, u32)>,
    /// The words of skins.
    skins: Vec<u32>,
}

impl Frame {
    fn read(bytes: &[u8]) -> Self {
        let (words, []) = bytes.as_chunks::<4>() else { panic!("words of 32 bits") };
        let words: Vec<_> = words.iter().map(|word| u32::from_le_bytes(*word)).collect();
        let [
            kind,
            scene,
            flags,
            steps,
            low,
            high,
            _,
            _,
            stage,
            parts,
            contacts,
            jaws,
            marks,
            skins,
        ] = words[..14]
        else {
            panic!("a frame has a head")
        };
        assert_eq!(kind, message::FRAME);
        let mut rest = words[14..].iter().map(|word| f32::from_bits(*word));
        let mut take = |count: u32| rest.by_ref().take(count as usize).collect::<Vec<_>>();
        let frame = Self {
            scene,
            flags,
            steps,
            seed: u64::from(high) << 32 | u64::from(low),
            stage,
            endoscope: take(8),
            poses: take(7 * parts),
            contacts: take(6 * contacts),
            jaws: take(4 * jaws),
            marks: take(2 * marks).chunks(2).map(|mark| (mark[0], mark[1].to_bits())).collect(),
            skins: take(skins).into_iter().map(f32::to_bits).collect(),
        };
        assert_eq!(rest.count(), 0, "nothing else is in it");
        frame
    }
}

impl Page {
    fn connect(address: &str) -> Self {
        Self::try_connect(address, None).unwrap_or_else(|why| panic!("no page: {why}"))
    }

    /// An error is the answer's status and text.
    fn try_connect(address: &str, origin: Option<&str>) -> Result<Self, String> {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut request = tungstenite::client::IntoClientRequest::into_client_request(format!(
            "ws://{address}/live"
        ))
        .unwrap();
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().unwrap());
        }
        match client(request, stream) {
            Ok((socket, _)) => Ok(Self(socket)),
            Err(HandshakeError::Failure(Error::Http(response))) => {
                let said = response.body().clone().unwrap_or_default();
                Err(format!("{} {}", response.status(), String::from_utf8_lossy(&said)))
            }
            Err(other) => panic!("{other}"),
        }
    }

    fn say(&mut self, command: &Value) {
        self.0.send(Message::text(command.to_string())).unwrap();
    }

    fn watch(&mut self, session: u64, env: u32, pace: &str) {
        self.say(&json!({"watch": {"session": session, "env": env, "pace": pace}}));
    }

    /// The next text of this type.
    fn text(&mut self, kind: &str) -> Value {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            if let Message::Text(text) = self.0.read().unwrap() {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["type"] == kind {
                    return value;
                }
            }
        }
        panic!("no {kind} came");
    }

    /// The list, once it is as it should be.
    fn sessions(&mut self, is_it: impl Fn(&[Value]) -> bool) -> Vec<Value> {
        let start = Instant::now();
        loop {
            let list = self.text("sessions")["list"].as_array().unwrap().clone();
            if is_it(&list) {
                return list;
            }
            assert!(start.elapsed() < PATIENCE, "the list stays {list:?}");
        }
    }

    /// The number of the only session.
    fn session(&mut self) -> u64 {
        self.sessions(|list| list.len() == 1)[0]["id"].as_u64().unwrap()
    }

    /// The next frame, and what else came before it.
    fn frame(&mut self) -> (Frame, Vec<Message>) {
        let mut before = vec![];
        loop {
            match self.0.read().unwrap() {
                Message::Binary(bytes) if kind(&bytes) == message::FRAME => {
                    return (Frame::read(&bytes), before);
                }
                other => before.push(other),
            }
        }
    }

    /// The frame of this step, and everything that came before it.
    fn frame_of(&mut self, steps: u32) -> (Frame, Vec<Message>) {
        let start = Instant::now();
        let mut all = vec![];
        loop {
            let (frame, before) = self.frame();
            all.extend(before);
            if frame.steps == steps {
                return (frame, all);
            }
            assert!(start.elapsed() < PATIENCE, "{steps} was never shown");
        }
    }
}

fn kind(bytes: &[u8]) -> u32 {
    u32::from_le_bytes(bytes[..4].try_into().unwrap())
}

fn numbers(pose: &Pose) -> [f32; 7] {
    let (at, turn) = (pose.translation.vector, pose.rotation.coords);
    [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w].map(|number| number as f32)
}

/// Compares a frame with the environment in-process, all numbers as bits.
fn assert_shows(frame: &Frame, env: &Env) {
    let scene = env.scene();
    let poses: Vec<_> =
        scene.instances().iter().flat_map(|part| numbers(&part.world_from_mesh)).collect();
    assert_eq!(frame.poses, poses);
    assert_eq!((frame.steps, frame.seed), (env.steps(), env.seed()));
    assert_eq!(frame.stage, env.stage() as u32);
    assert_eq!(frame.flags, HAS_ENDOSCOPE);
    assert!(frame.skins.is_empty(), "nothing deforms");
    let lens = scene.endoscope.unwrap();
    assert_eq!(frame.endoscope[..7], numbers(&lens.world_from_camera));
    assert_eq!(frame.endoscope[7], lens.view as f32);
    let jaws = |jaws: &Jaws| {
        let [one, other] = jaws.pressures;
        [jaws.opening, jaws.asked, one, other].map(|number| number as f32)
    };
    assert_eq!(frame.jaws, scene.jaws.iter().flat_map(jaws).collect::<Vec<_>>());
    let mut contacts: Vec<_> = env.world().contacts().collect();
    contacts.sort_by(|one, other| other.force.norm().total_cmp(&one.force.norm()));
    contacts.truncate(message::MOST_CONTACTS);
    let contacts = contacts.iter().flat_map(|contact| {
        let (at, force) = (contact.point, contact.force);
        [at.x, at.y, at.z, force.x, force.y, force.z].map(|number| number as f32)
    });
    assert_eq!(frame.contacts, contacts.collect::<Vec<_>>());
}

#[test]
fn a_server_without_a_viewer_starts_one_when_it_is_asked_for() {
    let logged = Logged::start(&["--threads", "2"]);
    let client = logged.server.connect();
    let mut session = logged.server.open(&SessionRequest::new("EcmReach-v0").seed(3));
    session.reset().unwrap();
    let address = client.viewer().unwrap();
    assert!(address.ip().is_loopback());
    assert_eq!(logged.server.connect().viewer().unwrap(), address);
    let mut page = Page::connect(&address.to_string());
    let number = page.session();
    page.watch(number, 0, "live");
    // It was simulated before the page asked.
    session.step(&[0.0; 3]).unwrap();
    let (frame, _) = page.frame();
    assert_eq!((frame.seed, frame.steps), (3, 1));
}

#[test]
fn a_live_world_is_shown_while_its_arms_move() {
    let theatre = Theatre::open();
    let live = LiveRequest { speed: Some(10.0), ..LiveRequest::default() };
    let request = SessionRequest::new("NeedleReach-v0").seed(4).live(live);
    let mut world = theatre.logged.server.connect().open_live(&request).unwrap();
    let mut page = theatre.page();
    let number = page.session();
    page.watch(number, 0, "live");
    let (first, _) = page.frame();
    assert_eq!(first.seed, 4);
    for word in [StateCommand::Enable, StateCommand::Home] {
        world.command("PSM1", &Command::State(word)).unwrap();
    }
    world.look().unwrap();
    let start = Instant::now();
    while page.frame().0.poses == first.poses {
        assert!(start.elapsed() < PATIENCE, "the arm was never shown to move");
    }
}

#[test]
fn a_page_takes_over_from_sessions_that_let_it_and_from_no_others() {
    let theatre = Theatre::open();
    let client = theatre.logged.server.connect();
    let token = client.driving_page().unwrap().split_once("token=").unwrap().1.to_string();
    let mut page = theatre.page();
    let [mut alone, mut supervised] = [false, true].map(|intervention| {
        let live = LiveRequest { homing: Homing::InPlace, intervention, ..LiveRequest::default() };
        let request = SessionRequest::new("NeedleReach-v0").live(live);
        let mut world = client.open_live(&request).unwrap();
        for word in [StateCommand::Enable, StateCommand::Home] {
            world.command("PSM1", &Command::State(word)).unwrap();
        }
        world.advance(2).unwrap();
        world
    });
    let me = supervised.arm("PSM1").unwrap().driver;
    let drive = |page: &mut Page, world: &LiveWorld| {
        let wish = json!({"session": world.info().session, "token": token, "arm": "PSM1", "motion": "hold"});
        page.say(&json!({ "drive": wish }));
    };
    // What the page asks for is done in its order.
    drive(&mut page, &supervised);
    drive(&mut page, &alone);
    let words = page.text("error")["message"].to_string();
    assert!(words.contains("drives it, in session"), "{words}");

    // What the session asks of that arm is refused, until the page lets go or an episode begins.
    let hold = |world: &mut LiveWorld| {
        world.command("PSM1", &Command::Hold).unwrap();
        world.look()
    };
    for is_reset in [true, false] {
        assert_eq!(refused(hold(&mut supervised)).code, Code::ArmIsDriven);
        supervised.look().unwrap();
        assert!(![0, me].contains(&supervised.arm("PSM1").unwrap().driver));
        if is_reset {
            supervised.reset(7).unwrap();
            assert_eq!(supervised.arm("PSM1").unwrap().driver, 0);
            hold(&mut supervised).unwrap();
            drive(&mut page, &supervised);
            drive(&mut page, &alone);
            page.text("error");
        } else {
            page.say(&json!("let_go"));
            let start = Instant::now();
            while hold(&mut supervised).is_err() {
                assert!(start.elapsed() < PATIENCE, "the page never lets go");
            }
        }
        assert_eq!(supervised.arm("PSM1").unwrap().driver, me);
    }
    hold(&mut alone).unwrap();
}

#[test]
fn frames_are_a_faithful_copy_of_the_scene() {
    let theatre = Theatre::open();
    let request = SessionRequest::new("NeedlePick-v0").envs(2).seed(5);
    let mut session = theatre.logged.server.open(&request);
    let mut twin = Registry::builtin().make("NeedlePick-v0", &Options::new()).unwrap();
    twin.reset(Some(6));
    let mut actions = session.reset().unwrap().expert_action().to_vec();
    let mut page = theatre.page();
    let number = page.session();
    page.watch(number, 1, "live");
    let (frame, before) = page.frame();
    assert_shows(&frame, &twin);

    // What it is made of came before it, and nothing that has another form.
    let scene = before.iter().find_map(|message| {
        let Message::Text(text) = message else { return None };
        let value: Value = serde_json::from_str(text).unwrap();
        (value["type"] == "scene").then_some(value)
    });
    let (card, scene) = (scene.unwrap(), twin.scene());
    assert_eq!(card["number"], frame.scene);
    assert_eq!((&card["session"], &card["env"]), (&json!(number), &json!(1)));
    assert_eq!(card["bodies"], json!(scene.bodies()));
    assert_eq!(card["jaws"], json!(["psm1"]));
    let meshes: Vec<&[u8]> = before
        .iter()
        .filter_map(|message| match message {
            Message::Binary(bytes) if kind(bytes) == message::MESH => Some(&bytes[..]),
            _ => None,
        })
        .collect();
    let parts = card["parts"].as_array().unwrap();
    assert_eq!(parts.len(), scene.instances().len());
    for (part, instance) in parts.iter().zip(scene.instances()) {
        let bytes = meshes[part["mesh"].as_u64().unwrap() as usize];
        let vertices: Vec<_> = instance.mesh.vertices().flat_map(|at| [at.x, at.y, at.z]).collect();
        let (head, data) = bytes.split_at(20);
        assert_eq!(head[8..12], (vertices.len() as u32 / 3).to_le_bytes());
        let (floats, _) = data.as_chunks::<4>();
        let sent = floats.iter().map(|word| f32::from_le_bytes(*word)).take(vertices.len());
        assert_eq!(sent.collect::<Vec<_>>(), vertices);
        assert_eq!(part["body"], instance.body);
        assert_eq!(part["size"], instance.size);
        assert_eq!(part["metallic"], json!(instance.material.metallic));
    }

    // Until the needle is held: contacts, forces and the jaws' state are those of the twin.
    let mut touched = 0;
    let mut marks = frame.marks;
    // The endoscope's comes when it is drawn, which may be soon or late.
    let is_picture = |message: &Message| matches!(message, Message::Binary(bytes) if kind(bytes) == message::PICTURE);
    let mut pictures: Vec<_> =
        before.iter().filter(|message| is_picture(message)).cloned().collect();
    for steps in 1..=30 {
        let reply = session.step(&actions).unwrap();
        actions.copy_from_slice(reply.expert_action());
        let mut action = [0.0; 5];
        twin.expert(&mut action);
        twin.step(&action).unwrap();
        if steps % 6 == 0 {
            let (frame, before) = page.frame_of(steps);
            assert_shows(&frame, &twin);
            touched += frame.contacts.len();
            assert!(frame.jaws[2..].iter().all(|pressure| *pressure >= 0.0));
            marks.extend(frame.marks);
            pictures.extend(before.iter().filter(|message| is_picture(message)).cloned());
            let scenes = before
                .iter()
                .filter(|message| message.is_text())
                .filter(|message| message.to_text().unwrap().contains("\"type\":\"scene\""));
            assert_eq!(scenes.count(), 0, "its form has not changed");
        }
    }
    assert!(touched > 0, "the jaws have touched the needle");
    assert!(marks.iter().filter(|(_, flags)| flags & STEP != 0).count() >= 5);
    let png = loop {
        if let Some(Message::Binary(bytes)) = pictures.pop() {
            break bytes;
        }
        pictures.extend(Some(page.0.read().unwrap()).filter(is_picture));
    };
    assert_eq!(&png[16..24], b"\x89PNG\r\n\x1a\n");
}

#[test]
fn the_list_says_how_sessions_do_and_whole_episodes_can_be_watched() {
    let theatre = Theatre::open();
    let mut page = theatre.page();
    let hello = page.text("hello");
    assert_eq!(hello["name"], theatre.logged.server.name());
    assert_eq!(page.sessions(<[Value]>::is_empty), [] as [Value; 0]);
    let request = SessionRequest::new("NeedleReach-v0").envs(3).autoreset(Autoreset::NextStep);
    let mut session = theatre.logged.server.open(&request);
    let mut actions = session.reset().unwrap().expert_action().to_vec();
    let number = page.session();
    page.watch(number, 2, "episodes");
    let (first, _) = page.frame();
    assert_eq!((first.steps, first.seed), (0, 2));
    // The first was under way when it was asked for; the second is shown from its beginning.
    for _ in 0..2 * 51 {
        let reply = session.step(&actions).unwrap();
        actions.copy_from_slice(reply.expert_action());
    }
    let mut steps = vec![];
    let last = loop {
        let (frame, _) = page.frame();
        steps.push(frame.steps);
        if frame.marks.iter().any(|(_, flags)| flags & ENDED != 0) {
            break frame;
        }
    };
    assert_eq!(steps, (0..=50).collect::<Vec<_>>());
    assert_eq!(last.marks, [(0.0, STEP | ENDED | message::SUCCESS)]);
    let list = page.sessions(|list| list[0]["episodes"] == 6);
    let card = &list[0];
    assert_eq!((&card["task"], &card["envs"]), (&json!("NeedleReach-v0"), &json!(3)));
    assert_eq!((&card["success_rate"], &card["max_steps"]), (&json!(1.0), &json!(50)));
    assert_eq!((&card["pid"], &card["language"]), (&json!(std::process::id()), &json!("rust")));
    assert!(card["steps_per_second"].as_f64().unwrap() > 0.0);
    // Tasks without goals have no success to speak of.
    let mut other = theatre.logged.server.open(&SessionRequest::new("ActiveTrack-v0"));
    other.reset().unwrap();
    let list = page.sessions(|list| list.len() == 2);
    assert_eq!(list[1]["success_rate"], Value::Null);
    drop(session);
    assert_eq!(page.text("gone")["session"], number);
    page.sessions(|list| list.len() == 1);
}

#[test]
fn a_session_has_the_same_bits_whoever_watches_it() {
    let theatre = Theatre::open();
    let server = &theatre.logged.server;
    let bystanders = [Bystander::start(server), Bystander::start(server)];
    let mut pages: Vec<_> = (0..4).map(|_| theatre.page()).collect();
    let list = pages[0].sessions(|list| list.len() == 2);
    let ids: Vec<_> = list.iter().map(|card| card["id"].as_u64().unwrap()).collect();
    for (index, page) in pages.iter_mut().enumerate() {
        page.watch(ids[index % 2], index as u32 % 3, ["live", "episodes"][index / 2]);
    }
    for page in &mut pages {
        for _ in 0..5 {
            page.frame();
        }
    }
    bystanders.into_iter().for_each(Bystander::finish);
}

#[test]
fn what_is_no_command_gets_an_error_and_harms_nothing() {
    let theatre = Theatre::open();
    let bystander = Bystander::start(&theatre.logged.server);
    let mut page = theatre.page();
    let id = page.session();
    for (garbage, part) in [
        ("", "no command"),
        ("{", "no command"),
        ("\"stop\"", "stop"),
        ("{\"watch\": {\"session\": -1, \"env\": 0}}", "-1"),
        ("{\"watch\": {\"session\": 1, \"env\": 0, \"pace\": \"fast\"}}", "fast"),
        ("{\"watch\": {\"session\": 1, \"env\": 0, \"more\": 1}}", "more"),
        ("{\"watch\": {\"session\": 99, \"env\": 0}}", "no session 99"),
        ("[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[", "no command"),
        ("{\"pause\": null}", "no command"),
    ] {
        page.0.send(Message::text(garbage)).unwrap();
        let message = page.text("error")["message"].to_string();
        assert!(message.contains(part), "{garbage}: {message}");
    }
    page.watch(id, 3, "live");
    let message = page.text("error")["message"].to_string();
    assert!(message.contains("the last is 2"), "{message}");
    page.0.send(Message::binary(vec![0xff; 64])).unwrap();
    assert!(page.text("error")["message"].to_string().contains("text"));
    // It still does what it is asked.
    page.watch(id, 0, "live");
    page.frame();
    page.say(&json!({"pause": true}));
    page.say(&json!({"pause": false}));
    page.frame();
    page.say(&json!("leave"));

    // Commands are short.
    let mut long = theatre.page();
    long.0.send(Message::text("x".repeat(2 * message::LONGEST_COMMAND))).unwrap();
    let closed = loop {
        match long.0.read() {
            Ok(Message::Close(_)) | Err(_) => break true,
            Ok(_) => {}
        }
    };
    assert!(closed);
    let ask = |request: &[u8]| {
        let mut stream = TcpStream::connect(&theatre.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(request).ok();
        // Not closed from this side: the server need not answer a client that has gone.
        let mut answer = vec![];
        stream.read_to_end(&mut answer).ok();
        String::from_utf8_lossy(&answer).into_owned()
    };
    for (request, status) in [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n".as_slice(), "HTTP/1.1 400"),
        (b"POST / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", "HTTP/1.1 405"),
        (
            b"GET /../../etc/passwd HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
            "HTTP/1.1 404",
        ),
        (b"GET /live HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", "HTTP/1.1 400"),
        (b"GET / HTTP/1.1\r\nHost: example.org\r\nConnection: close\r\n\r\n", "HTTP/1.1 403"),
    ] {
        let answer = ask(request);
        assert!(answer.starts_with(status), "{}: {answer}", String::from_utf8_lossy(request));
    }
    let foreign = Page::try_connect(&theatre.address, Some("https://example.org")).err();
    assert!(foreign.as_ref().is_some_and(|why| why.starts_with("403")), "{foreign:?}");
    let ours = format!("http://{}", theatre.address);
    assert!(Page::try_connect(&theatre.address, Some(&ours)).is_ok());
    bystander.finish();
}

#[test]
fn the_page_is_one_file_that_may_load_nothing_else() {
    let theatre = Theatre::open();
    let answer = get(&theatre.address, "/");
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    assert!(head.contains("text/html") && head.contains("default-src 'none'"), "{head}");
    assert!(head.contains("connect-src 'self'"), "{head}");
    assert!(body.contains("three.js") && body.contains("Permission is hereby granted"));
    for tag in ["<script src", "<link rel=\"stylesheet\"", "<img", "@import"] {
        assert!(!body.contains(tag), "{tag}");
    }
}

#[test]
fn a_page_that_does_not_read_holds_nobody_up() {
    let theatre = Theatre::open();
    let request = SessionRequest::new("EcmReach-v0").envs(4).autoreset(Autoreset::NextStep);
    let mut session = theatre.logged.server.open(&request);
    session.reset().unwrap();
    let mut page = theatre.page();
    let number = page.session();
    for pace in ["live", "episodes"] {
        page.watch(number, 0, pace);
        page.frame();
        // Nothing is read from here on, and no more asked for.
        for _ in 0..1000 {
            session.step(&[0.1; 12]).unwrap();
        }
    }
    // A page that reads at last sees what is, not all that was.
    let (frame, _) = page.frame();
    assert!(frame.marks.len() <= 1);
}

#[test]
fn so_many_pages_watch_and_no_more() {
    let mut theatre = Theatre::open();
    let files = theatre.logged.server.process().open_files();
    let mut pages: Vec<_> = (0..MOST_PAGES).map(|_| theatre.page()).collect();
    let why = Page::try_connect(&theatre.address, None).err().unwrap();
    assert!(why.starts_with("503") && why.contains("no more"), "{why}");
    drop(pages.pop());
    eventually("a place is free", || Page::try_connect(&theatre.address, None).is_ok());
    // Clients that connect and say nothing take no more than there are places.
    let silent: Vec<_> =
        (0..2 * MOST_CONNECTIONS).map(|_| TcpStream::connect(&theatre.address).unwrap()).collect();
    assert!(theatre.logged.server.process().open_files() <= files + MOST_CONNECTIONS + 4);
    let bystander = Bystander::start(&theatre.logged.server);
    bystander.finish();
    drop((silent, pages));
    eventually("all is closed again", || theatre.logged.server.process().open_files() <= files + 2);
}

#[test]
fn an_ending_server_says_goodbye() {
    let mut theatre = Theatre::open();
    let mut page = theatre.page();
    page.text("hello");
    theatre.logged.server.process().signal(Signal::TERM);
    page.text("bye");
    let end = loop {
        match page.0.read() {
            Ok(Message::Close(frame)) => break frame.map(|frame| u16::from(frame.code)),
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
    };
    assert_eq!(end, Some(1001));
    drop(page);
    assert_eq!(theatre.logged.server.process().wait().code(), Some(0));
}

#[test]
fn a_viewer_where_nobody_can_listen_is_no_server() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let name = crate::harness::unique_name();
    let output = crate::harness::serve(&name).args(["--view", &address]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("--view") && said.contains(&address), "{said}");
    crate::harness::assert_nothing_is_left(&name);
}
