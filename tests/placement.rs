//! Episodes that a reset arranges, through a session: the same bits as in-process, each environment as it is asked
//! for, all or none; their exported states go to another server.

use trocar_client::{Autoreset, CallError, Code, Options, Placement, Session, SessionRequest};
use trocar_proto::control::{self, ControlReply, ControlRequest, MAX_MESSAGE};
use trocar_proto::wire::Header;
use trocar_server::Registry;

use crate::harness::{Server, eventually};
use crate::rows::{Row, act, policies};
use crate::twin::Twin;

const ENVS: u32 = 3;
const ALL: [u32; 3] = [0, 1, 2];

/// A session, and the same environments in-process, at the beginning of their first episodes.
fn begun(server: &Server, task: &str) -> (Session, Twin) {
    let request = SessionRequest::new(task).envs(ENVS).seed(40);
    let mut session = server.open(&request);
    let mut twin = Twin::new(task, &Options::new(), ENVS as usize, 40);
    assert_eq!(Row::all(&session.reset().unwrap(), request.autoreset), twin.reset(&ALL, None));
    (session, twin)
}

/// Steps both, and finds the same.
fn step_both(session: &mut Session, twin: &mut Twin, rows: &[Row], steps: usize) {
    let mut policies = policies(3, ENVS as usize);
    let mut rows = rows.to_vec();
    for _ in 0..steps {
        let actions = act(&mut policies, &rows);
        rows = Row::all(&session.step(&actions).unwrap(), Autoreset::NextStep);
        assert_eq!(rows, twin.step(&ALL, &actions).unwrap());
    }
}

/// A needle where those of other episodes lie, by number.
fn needle(seed: u64) -> Placement {
    let mut env = Registry::builtin().make("NeedlePick-v0", &Options::new()).unwrap();
    env.reset(Some(seed));
    let (name, pose) = env.objects().next().unwrap();
    let position: [f64; 3] = pose.translation.vector.into();
    let turned = trocar_server::sim::frames::euler_xyz(&pose.rotation);
    let objects = [(name.to_string(), [position, turned].concat())].into();
    Placement { objects, ..Placement::default() }
}

fn refused(result: Result<trocar_client::Reply, CallError>) -> trocar_client::Rejection {
    match result.err().unwrap() {
        CallError::Refused(refusal) => refusal,
        other => panic!("{other}"),
    }
}

#[test]
fn arranged_episodes_have_the_same_bits_as_in_process() {
    let server = Server::start();
    let (mut session, mut twin) = begun(&server, "NeedlePick-v0");
    let placements: Vec<_> = (100..103).map(needle).collect();
    let rows = Row::all(&session.arrange(None, &placements).unwrap(), Autoreset::NextStep);
    assert_eq!(rows, twin.arrange(&ALL, &placements));
    step_both(&mut session, &mut twin, &rows, 10);

    // To another session, where they are rebuilt.
    let snapshot = session.snapshot().unwrap();
    let bytes = session.export(&snapshot).unwrap();
    let (mut other, _) = begun(&server, "NeedlePick-v0");
    let imported = other.import(&bytes).unwrap();
    let rows = Row::all(&other.restore(&imported).unwrap(), Autoreset::NextStep);
    assert_eq!(rows, Row::all(&session.restore(&snapshot).unwrap(), Autoreset::NextStep));

    // One for some; the others go on.
    let goal = Placement { goal: Some(vec![0.55, 0.0, 0.73]), ..Placement::default() };
    session.reset_envs(&[0, 2], None).unwrap();
    twin.reset(&[0, 2], None);
    let rows = Row::all(
        &session.arrange(Some(&[0, 2]), std::slice::from_ref(&goal)).unwrap(),
        Autoreset::NextStep,
    );
    assert_eq!(rows, twin.arrange(&[0, 2], &[goal.clone(), goal]));
}

#[test]
fn what_one_environment_refuses_is_done_in_none() {
    let server = Server::start();
    let (mut session, mut twin) = begun(&server, "NeedlePick-v0");
    let far = Placement { goal: Some(vec![9.0; 3]), ..Placement::default() };
    let placements = [needle(100), needle(101), far.clone()];
    let refusal = refused(session.arrange(None, &placements));
    assert_eq!(
        (refusal.code, refusal.field.as_str()),
        (Code::InvalidOption, "options.goal[env 2]")
    );
    // All are as they were: the same placements but one, and the same bits.
    let placements = [needle(100), needle(101), needle(102)];
    let rows = Row::all(&session.arrange(None, &placements).unwrap(), Autoreset::NextStep);
    assert_eq!(rows, twin.arrange(&ALL, &placements));
    step_both(&mut session, &mut twin, &rows, 5);
    let refusal = refused(session.arrange(None, &[needle(1)]));
    assert_eq!((refusal.code, refusal.field.as_str()), (Code::ResetNeeded, "options[env 0]"));

    let mut single = server.open(&SessionRequest::new("NeedlePick-v0"));
    single.reset().unwrap();
    assert_eq!(refused(single.arrange(None, &[far])).field, "options.goal");
}

#[test]
fn placements_are_checked_first_and_dropped_afterwards() {
    let server = Server::start();
    let client = server.connect();
    let (mut session, _) = begun(&server, "NeedlePick-v0");
    let before = client.status().unwrap().memory_bytes;
    assert!(session.arrange(None, &[needle(1), needle(2)]).is_err(), "two for three");
    let nan = Placement { tip: Some(vec![f64::NAN; 3]), ..Placement::default() };
    assert_eq!(refused(session.arrange(None, std::slice::from_ref(&nan))).field, "options.tip");
    session.arrange(None, &[needle(1), needle(2), needle(3)]).unwrap();
    drop(session.snapshot().unwrap());
    session.reset().unwrap();
    // The server hears of it with the next snapshot, which is then dropped, too.
    drop(session.snapshot().unwrap());
    eventually("only the last snapshot is left", || {
        let snapshots = client.status().unwrap().memory_bytes - before;
        snapshots == u64::from(ENVS) * trocar_server::Env::MEMORY_BYTES
    });

    // What a client of ours never sends.
    let (id, node) = (session.info().session, 0);
    let request = ControlRequest::ImportPlacement { session: id, node, placement: nan };
    let mut bytes = vec![0; MAX_MESSAGE];
    let length = control::encode(&request, &mut bytes).unwrap();
    let header = Header { length: length as u32, ..Header::new(request.kind()) };
    match client.send_raw(header, &bytes[..length]).unwrap() {
        ControlReply::Refused(refusal) => assert_eq!(refusal.field, "options.tip"),
        other => panic!("not refused: {other:?}"),
    }
}
