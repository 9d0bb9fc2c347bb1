//! One suite on two implementations: environments in-process, and a session in a server.

use trocar_client::{Autoreset, CallError, Code, Options, Session, SessionRequest};
use trocar_proto::TaskSpec;
use trocar_server::Registry;

use crate::harness::{Server, tasks};
use crate::rows::{Row, act, policies};
use crate::twin::Twin;

/// N environments of one task, however they are run.
trait Envs {
    fn spec(&self) -> TaskSpec;
    fn reset(&mut self, env_ids: &[u32], seeds: Option<&[u64]>) -> Vec<Row>;
    fn step(&mut self, env_ids: &[u32], actions: &[f32]) -> Result<Vec<Row>, Code>;
}

impl Envs for Twin {
    fn spec(&self) -> TaskSpec {
        self.spec().clone()
    }

    fn reset(&mut self, env_ids: &[u32], seeds: Option<&[u64]>) -> Vec<Row> {
        self.reset(env_ids, seeds)
    }

    fn step(&mut self, env_ids: &[u32], actions: &[f32]) -> Result<Vec<Row>, Code> {
        self.step(env_ids, actions)
    }
}

/// A session, and the mode that it was opened with.
struct Remote(Session, Autoreset);

impl Envs for Remote {
    fn spec(&self) -> TaskSpec {
        self.0.spec().clone()
    }

    fn reset(&mut self, env_ids: &[u32], seeds: Option<&[u64]>) -> Vec<Row> {
        Row::all(&self.0.reset_envs(env_ids, seeds).expect("the ids are good"), self.1)
    }

    fn step(&mut self, env_ids: &[u32], actions: &[f32]) -> Result<Vec<Row>, Code> {
        let sent = self.0.send(env_ids, actions).and_then(|()| self.0.recv());
        match sent {
            Ok(reply) => Ok(Row::all(&reply, self.1)),
            Err(CallError::Refused(refusal)) => Err(refusal.code),
            Err(other) => panic!("{other}"),
        }
    }
}

/// Runs `check` on both implementations of every registered task.
fn on_both(envs: u32, autoreset: Autoreset, check: fn(&mut dyn Envs)) {
    let server = Server::start();
    for task in tasks() {
        check(&mut Twin::new(task, &Options::new(), envs as usize, 40).autoreset(autoreset));
        let request = SessionRequest::new(task).envs(envs).seed(40).autoreset(autoreset);
        check(&mut Remote(server.open(&request), autoreset));
    }
}

fn zeros(envs: &dyn Envs, count: usize) -> Vec<f32> {
    vec![0.0; count * envs.spec().action_dim()]
}

impl Row {
    /// What tells one episode's beginning from another's.
    fn start(&self) -> (&[u32], &[u32]) {
        (&self.observation, &self.desired)
    }

    /// The scripted expert's action.
    fn experts(&self) -> Vec<f32> {
        self.expert.iter().map(|bits| f32::from_bits(*bits)).collect()
    }
}

#[test]
fn a_session_has_the_specification_of_the_task() {
    let server = Server::start();
    let client = server.connect();
    let registry = Registry::builtin();
    assert_eq!(client.tasks().unwrap(), registry.ids().collect::<Vec<_>>());
    for task in registry.ids() {
        for mode in ["paper", "joint"] {
            let options = Options::new().with_text("action", mode);
            let expected = registry.spec(task, &options).unwrap();
            assert_eq!(client.describe(task, &options).unwrap(), expected);
            let request = SessionRequest::new(task).options(options);
            assert_eq!(client.open(&request).unwrap().spec(), &expected);
        }
    }
}

#[test]
fn a_reset_begins_an_episode() {
    on_both(3, Autoreset::NextStep, |envs| {
        let rows = envs.reset(&[0, 1, 2], None);
        for (row, seed) in rows.iter().zip(40..) {
            assert_eq!((row.seed, row.episode, row.steps), (seed, 0, 0));
            assert_eq!(row.reward, 0);
            assert!(!row.terminated && !row.truncated && !row.is_success);
        }
        assert_ne!(rows[0].start(), rows[1].start());
    });
}

#[test]
fn seeds_and_episodes_decide_the_start() {
    on_both(2, Autoreset::NextStep, |envs| {
        let first = envs.reset(&[0, 1], Some(&[7, 9]));
        let second = envs.reset(&[0, 1], None);
        assert_eq!([second[0].seed, second[1].seed], [7, 9]);
        assert_eq!([second[0].episode, second[1].episode], [1, 1]);
        assert_ne!(first[0].start(), second[0].start());
        // Which environment it is does not matter, only its seed.
        let swapped = envs.reset(&[0, 1], Some(&[9, 7]));
        assert_eq!(swapped, [first[1].clone(), first[0].clone()]);
        let again = envs.reset(&[0, 1], None);
        assert_eq!(again, [second[1].clone(), second[0].clone()]);
    });
}

#[test]
fn a_masked_reset_leaves_the_others_alone() {
    on_both(4, Autoreset::NextStep, |envs| {
        envs.reset(&[0, 1, 2, 3], None);
        let actions = zeros(envs, 4);
        envs.step(&[0, 1, 2, 3], &actions).unwrap();
        let reset = envs.reset(&[1, 3], Some(&[100, 101]));
        assert_eq!([reset[0].seed, reset[1].seed], [100, 101]);
        let rows = envs.step(&[0, 1, 2, 3], &actions).unwrap();
        assert_eq!(rows.iter().map(|row| row.steps).collect::<Vec<_>>(), [2, 1, 2, 1]);
        assert_eq!(rows.iter().map(|row| row.seed).collect::<Vec<_>>(), [40, 100, 42, 101]);
    });
}

#[test]
fn episodes_end_at_the_time_limit() {
    on_both(1, Autoreset::Disabled, |envs| {
        let limit = envs.spec().max_steps;
        envs.reset(&[0], None);
        let mut row = envs.step(&[0], &zeros(envs, 1)).unwrap().remove(0);
        for step in 2..=limit {
            assert!(!row.truncated && !row.terminated);
            row = envs.step(&[0], &row.experts()).unwrap().remove(0);
            assert_eq!(row.steps, step);
        }
        assert!(row.truncated && !row.terminated);
    });
}

#[test]
fn a_terminal_state_ends_an_episode_before_its_time_limit() {
    on_both(1, Autoreset::SameStep, |envs| {
        if envs.spec().goal.is_some() {
            return; // such tasks have none
        }
        let mut row = envs.reset(&[0], None).remove(0);
        let mut steps = 0;
        while !row.terminated {
            assert!(!row.truncated && !row.is_success && row.last.is_none());
            assert!(steps < envs.spec().max_steps, "an endoscope that rests loses its target");
            row = envs.step(&[0], &zeros(envs, 1)).unwrap().remove(0);
            steps += 1;
        }
        assert!(!row.truncated);
        assert_eq!((row.steps, row.episode), (0, 1));
        let [observation, achieved, desired] = row.last.as_ref().unwrap();
        assert_ne!(observation, &row.observation);
        assert!(achieved.is_empty() && desired.is_empty());
    });
}

#[test]
fn a_step_before_the_first_reset_is_refused_in_every_mode() {
    for mode in [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled] {
        on_both(2, mode, |envs| {
            let actions = zeros(envs, 2);
            assert_eq!(envs.step(&[0, 1], &actions), Err(Code::ResetNeeded));
            envs.reset(&[0], None);
            // One that is not ready holds up all, and none of them moves.
            assert_eq!(envs.step(&[0, 1], &actions), Err(Code::ResetNeeded));
            let rows = envs.step(&[0], &zeros(envs, 1)).unwrap();
            assert_eq!(rows[0].steps, 1);
        });
    }
}

/// Steps until an episode has ended; returns the last row of it.
fn play_out(envs: &mut dyn Envs) -> Row {
    let mut row = envs.reset(&[0], None).remove(0);
    while !row.truncated && !row.terminated {
        row = envs.step(&[0], &row.experts()).unwrap().remove(0);
    }
    row
}

#[test]
fn without_autoreset_an_ended_episode_needs_a_reset() {
    on_both(1, Autoreset::Disabled, |envs| {
        let last = play_out(envs);
        assert_eq!((last.steps, last.episode), (envs.spec().max_steps, 0));
        let action = zeros(envs, 1);
        assert_eq!(envs.step(&[0], &action), Err(Code::ResetNeeded));
        assert_eq!(envs.reset(&[0], None)[0].episode, 1);
        assert_eq!(envs.step(&[0], &action).unwrap()[0].steps, 1);
    });
}

#[test]
fn next_step_autoreset_shows_the_end_and_then_resets() {
    on_both(1, Autoreset::NextStep, |envs| {
        let last = play_out(envs);
        assert_eq!((last.steps, last.episode), (envs.spec().max_steps, 0));
        let action = zeros(envs, 1);
        let first = envs.step(&[0], &action).unwrap().remove(0);
        assert_eq!((first.steps, first.episode, first.reward), (0, 1, 0));
        assert!(!first.truncated && !first.terminated && !first.is_success);
        assert_eq!(envs.step(&[0], &action).unwrap()[0].steps, 1);
    });
}

#[test]
fn same_step_autoreset_shows_both_ends() {
    on_both(1, Autoreset::SameStep, |envs| {
        let last = play_out(envs);
        assert_eq!((last.steps, last.episode), (0, 1));
        let [observation, achieved, _] = last.last.as_ref().unwrap();
        assert_ne!(observation, &last.observation);
        assert!(achieved != &last.achieved || achieved.is_empty());
        assert_eq!(envs.step(&[0], &zeros(envs, 1)).unwrap()[0].steps, 1);
    });
}

#[test]
fn the_expert_ends_its_episodes_in_success() {
    on_both(2, Autoreset::Disabled, |envs| {
        let mut rows = envs.reset(&[0, 1], None);
        while !rows[0].truncated {
            let actions: Vec<f32> = rows.iter().flat_map(Row::experts).collect();
            rows = envs.step(&[0, 1], &actions).unwrap();
        }
        let has_goal = envs.spec().goal.is_some();
        assert!(rows.iter().all(|row| row.is_success == has_goal));
    });
}

/// Plays `steps` steps of all environments; returns every row.
fn play(envs: &mut dyn Envs, count: usize, steps: usize) -> Vec<Vec<Row>> {
    let ids: Vec<u32> = (0..count as u32).collect();
    let mut policies = policies(3, count);
    let mut played = vec![envs.reset(&ids, None)];
    for _ in 0..steps {
        let actions = act(&mut policies, &played[played.len() - 1]);
        played.push(envs.step(&ids, &actions).unwrap());
    }
    played
}

#[test]
fn both_implementations_agree_bit_by_bit_in_every_mode() {
    let server = Server::start();
    for task in tasks() {
        for mode in [Autoreset::NextStep, Autoreset::SameStep] {
            let mut twin = Twin::new(task, &Options::new(), 3, 40).autoreset(mode);
            let request = SessionRequest::new(task).envs(3).seed(40).autoreset(mode);
            let mut remote = Remote(server.open(&request), mode);
            assert_eq!(play(&mut twin, 3, 120), play(&mut remote, 3, 120));
        }
    }
}

#[test]
fn an_environment_that_is_under_way_is_not_sent_again() {
    let server = Server::start();
    let mut session = server.open(&SessionRequest::new("EcmReach-v0").envs(4));
    session.reset().unwrap();
    session.send(&[1, 3], &[0.0; 6]).unwrap();
    for (group, actions) in [(&[0, 3][..], &[0.0; 6][..]), (&[0, 1, 2], &[0.0; 9])] {
        let Err(CallError::Refused(refusal)) = session.send(group, actions) else {
            panic!("{group:?} was sent");
        };
        assert_eq!((refusal.code, refusal.field.as_str()), (Code::InvalidEnvIds, "env_ids"));
    }
    assert!(session.start_reset(None, None).is_err());
    session.send(&[0, 2], &[0.0; 6]).unwrap();
    assert_eq!(session.recv().unwrap().steps(), [1, 1]);
    assert_eq!(session.recv().unwrap().steps(), [1, 1]);
}

#[test]
fn two_groups_in_flight_go_as_if_alone() {
    let server = Server::start();
    for task in tasks() {
        let mode = Autoreset::NextStep;
        let expected = play(&mut Twin::new(task, &Options::new(), 4, 40), 4, 120);
        let mut session = server.open(&SessionRequest::new(task).envs(4).seed(40));
        let all = Row::all(&session.reset().unwrap(), mode);
        assert_eq!(all, expected[0]);
        let groups: [&[u32]; 2] = [&[0, 3], &[1, 2]];
        let mut policies = policies(3, 4);
        let mut send = |session: &mut Session, group: &[u32], rows: &[Row]| {
            let act = |id: &u32| policies[*id as usize].act(&rows[*id as usize]);
            session.send(group, &group.iter().flat_map(act).collect::<Vec<f32>>()).unwrap();
        };
        for group in groups {
            send(&mut session, group, &expected[0]);
        }
        assert!(matches!(session.send(&[0], &[]), Err(CallError::Refused(_))));
        for (step, rows) in expected.iter().enumerate().skip(1) {
            for group in groups {
                let reply = session.recv().unwrap();
                let ids: Vec<u32> = (0..reply.rows()).map(|row| reply.env_id(row)).collect();
                assert_eq!(ids, group);
                for (id, row) in ids.iter().zip(Row::all(&reply, mode)) {
                    assert_eq!(row, rows[*id as usize], "environment {id} after step {step}");
                }
                if step + 1 < expected.len() {
                    send(&mut session, group, rows);
                }
            }
        }
        assert!(matches!(session.recv(), Err(CallError::NothingInFlight)));
    }
}
