//! Episodes that go wrong record themselves, and come again from what was recorded.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use trocar_client::{Autoreset, Client, Options, SessionRequest};
use trocar_proto::Rejection;
use trocar_proto::builtin::TaskInfo;
use trocar_proto::spec::{Element, OptionSpec};
use trocar_server::recording::{self, Replay};
use trocar_server::service::{ServerConfig, StopSignal, serve};
use trocar_server::sim::frames::{self, Pose};
use trocar_server::sim::random::Rng;
use trocar_server::sim::world::{BodyId, Motion, Part, Shape, Solver, World};
use trocar_server::tasks::expert::ExpertInput;
use trocar_server::tasks::{Registered, State};
use trocar_server::{Registry, Task};

/// A ball in the air: 1 makes its observation no number, −1 throws it away.
#[derive(Clone)]
struct Clumsy {
    ball: BodyId,
    seen: f32,
}

impl Registered for Clumsy {
    const INFO: TaskInfo = TaskInfo {
        id: "Clumsy-v0",
        summary: "Do nothing wrong.",
        steps: 5,
        hertz: 10.0,
        tags: &[],
    };

    fn options() -> Vec<OptionSpec> {
        vec![]
    }

    fn new(_: &Options) -> Result<(Self, World), Rejection> {
        let mut world = World::new(Solver::LIGHT);
        let part =
            Part { body_from_part: Pose::identity(), shape: Shape::Cuboid([0.005; 3].into()) };
        let place = frames::pose([0.55, 0.0, 0.7], [0.0; 3]);
        let ball = world.insert(Motion::Free { mass: 0.01 }, &place, 0.5, &[part]);
        Ok((Self { ball, seen: 0.0 }, world))
    }
}

impl Task for Clumsy {
    fn action(&self) -> Vec<Element> {
        vec![Element::new("mistake", "", "1", -1.0, 1.0)]
    }

    fn state(&self, _: &World, state: &mut State<'_>) {
        state.field(|| Element::new("state", "", "1", -1.0, 1.0), self.seen.into());
    }

    fn reset(&mut self, _: &mut World, _: &mut Rng) {
        self.seen = 0.0;
    }

    fn command(&mut self, world: &mut World, action: Option<&[f32]>) {
        match action {
            Some([1.0]) => self.seen = f32::NAN,
            Some([-1.0]) => {
                world.set_velocity(self.ball, &[0.0, 0.0, 5.0].into());
            }
            _ => {}
        }
    }

    fn reward(&self, _: &World) -> f32 {
        0.0
    }

    fn expert(&self, _: &World, _: &ExpertInput<'_>, _: &mut [f32]) {}
}

fn registry() -> Registry {
    let mut registry = Registry::empty();
    registry.register::<Clumsy>();
    registry
}

/// A folder of this test's own.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

#[test]
fn episodes_that_fail_or_lose_an_object_are_recorded_by_themselves() {
    let name = format!("failures-{}", std::process::id());
    let folder = Folder(std::env::temp_dir().join(format!("trocar-{name}")));
    let config = ServerConfig {
        threads: 2,
        failures: Some(folder.0.clone()),
        ..ServerConfig::new(name.parse().unwrap())
    };
    let stop = StopSignal::default();
    let to_stop = stop.clone();
    let server = std::thread::spawn(move || serve(registry(), &config, &to_stop, || {}).unwrap());
    let start = Instant::now();
    let client = loop {
        match Client::connect(&name) {
            Ok(client) => break client,
            Err(error) => assert!(start.elapsed() < Duration::from_mins(1), "{error}"),
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let request = SessionRequest::new("Clumsy-v0").envs(3).seed(40).autoreset(Autoreset::SameStep);
    let mut session = client.open(&request).unwrap();
    session.reset().unwrap();
    session.step(&[0.0, 0.25, 0.5]).unwrap();
    // The second fails, the third loses its object, the first does neither.
    let reply = session.step(&[0.0, 1.0, -1.0]).unwrap();
    assert!(reply.fault()[0] == 0 && reply.fault()[1] != 0 && reply.fault()[2] == 0);
    session.step(&[0.0, 0.0, -1.0]).unwrap();
    drop(session);
    drop(client);
    stop.set();
    server.join().unwrap();

    let mut names: Vec<_> = fs::read_dir(&folder.0)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let expected = ["Clumsy-v0-41-0-not-finite.trocar", "Clumsy-v0-42-0-lost-object.trocar"];
    assert_eq!(names, expected);
    for (name, fails) in names.iter().zip([true, false]) {
        let bytes = fs::read(folder.0.join(name)).unwrap();
        let course = recording::read(&bytes).unwrap().remove(0);
        let mut replay = Replay::new(&registry(), course).unwrap();
        while let Some(step) = replay.next() {
            step.unwrap();
        }
        assert_eq!(replay.env().steps(), 2);
        assert_eq!((replay.has_failed(), replay.env().has_lost_objects()), (fails, !fails));
    }
}
