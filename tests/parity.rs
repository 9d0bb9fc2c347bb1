//! Same seed and actions, same bits: in-process and through a session, alone and among 64, on one
//! thread and on two, before and after a restart of the server, under several options.

use trocar_client::{Autoreset, Options, Session, SessionRequest};
use trocar_server::Registry;

use crate::harness::{Server, soak, tasks};
use crate::rows::{Row, act, policies};
use crate::twin::Twin;

/// Past the end of an episode, and into the next.
const STEPS: usize = 70;

/// The same for tasks under options, where only the first steps are compared unless in a soak.
fn steps_under(options: &Options) -> usize {
    let long = options.0.is_empty() || soak();
    if long { STEPS } else { 15 }
}

/// Seed of the first environment.
const SEED: u64 = 1000;

/// Every row of every environment, message by message.
type Trajectory = Vec<Vec<Row>>;

/// The option sets of a task that are tried: its defaults, and each word of each choice.
fn option_sets(task: &str) -> Vec<Options> {
    let mut sets = vec![Options::new()];
    for option in Registry::builtin().spec(task, &Options::new()).unwrap().options {
        if let trocar_proto::spec::Allowed::OneOf(words) = option.allowed {
            let word = |word: &String| Options::new().with_text(&option.name, word);
            sets.extend(words.iter().skip(1).map(word));
        }
    }
    sets
}

fn in_process(task: &str, options: &Options, envs: usize) -> Trajectory {
    let mut twin = Twin::new(task, options, envs, SEED);
    let all = twin.all();
    let mut policies = policies(SEED, envs);
    let mut played = vec![twin.reset(&all, None)];
    for _ in 0..steps_under(options) {
        let actions = act(&mut policies, &played[played.len() - 1]);
        played.push(twin.step(&all, &actions).unwrap());
    }
    played
}

fn through(session: &mut Session, seed: u64, steps: usize) -> Trajectory {
    let mut policies = policies(seed, session.envs());
    let mut played = vec![Row::all(&session.reset().unwrap(), Autoreset::NextStep)];
    for _ in 0..steps {
        let actions = act(&mut policies, &played[played.len() - 1]);
        played.push(Row::all(&session.step(&actions).unwrap(), Autoreset::NextStep));
    }
    played
}

fn remote(server: &Server, task: &str, options: &Options, envs: usize, seed: u64) -> Trajectory {
    let request = SessionRequest::new(task).envs(envs as u32).seed(seed).options(options.clone());
    through(&mut server.open(&request), seed, steps_under(options))
}

#[test]
fn every_task_and_option_has_the_same_bits_in_process_and_through_a_session() {
    let server = Server::start();
    for task in tasks() {
        for options in option_sets(task) {
            let expected = in_process(task, &options, 2);
            let found = remote(&server, task, &options, 2, SEED);
            assert!(found == expected, "{task} {options:?}");
        }
    }
}

/// How many environments keep each other company: 64, but fewer where they grasp or handle tissue, which takes long.
fn company(task: &str) -> usize {
    let spec = Registry::builtin().spec(task, &Options::new()).unwrap();
    let grasps = spec.options.iter().any(|option| option.name == "grasp");
    let is_tissue = Registry::builtin().tagged("tissue").any(|tissue| tissue == task);
    match (soak(), is_tissue, grasps) {
        (false, true, _) => 2,
        (false, false, true) => 8,
        _ => 64,
    }
}

/// The first processor that this process may use.
fn first_cpu() -> String {
    let allowed = rustix::thread::sched_getaffinity(None).unwrap();
    (0..rustix::thread::CpuSet::MAX_CPU).find(|cpu| allowed.is_set(*cpu)).unwrap().to_string()
}

#[test]
fn bits_do_not_depend_on_company_threads_or_the_run_of_the_server() {
    for task in tasks() {
        let options = Options::new();
        let envs = company(task);
        let expected = in_process(task, &options, envs);
        let mut server = Server::start_with(&["--threads", "1"]);
        assert!(remote(&server, task, &options, envs, SEED) == expected, "{task}: one thread");
        for index in [0, envs / 4 + 1, envs - 1] {
            let alone = remote(&server, task, &options, 1, SEED + index as u64);
            let same = alone.iter().zip(&expected).all(|(alone, all)| alone[0] == all[index]);
            assert!(same, "{task}: environment {index} alone");
        }
        let name = server.name().to_string();
        drop(server);
        server = Server::start_named(&name, &["--threads", "2"]);
        assert!(remote(&server, task, &options, envs, SEED) == expected, "{task}: two threads");
        drop(server);
        let pinned = Server::start_with(&["--threads", "3", "--cpus", &first_cpu()]);
        assert!(remote(&pinned, task, &options, envs, SEED) == expected, "{task}: one processor");
    }
}

#[test]
fn sessions_side_by_side_do_not_touch_each_other() {
    let server = Server::start();
    let tasks: Vec<&str> = tasks().collect();
    std::thread::scope(|scope| {
        for index in 0..6 {
            let (server, task) = (&server, &tasks[index % tasks.len()]);
            scope.spawn(move || {
                let expected = in_process(task, &Options::new(), 1 + index);
                let found = remote(server, task, &Options::new(), 1 + index, SEED);
                assert!(found == expected, "{task} with {} environments", 1 + index);
            });
        }
    });
}

#[test]
fn an_episode_begins_by_its_number_as_it_did_in_turn() {
    let server = Server::start();
    let request = SessionRequest::new("NeedleReach-v0").envs(2);
    let mut session = server.open(&request.clone().seed(SEED));
    let in_turn: Vec<_> =
        (0..3).map(|_| Row::all(&session.reset().unwrap(), Autoreset::NextStep)).collect();
    let mut other = server.open(&request);
    for episode in [2, 0] {
        other.start_reset_to(None, &[SEED, SEED + 1], &[episode, episode]).unwrap();
        let begun = Row::all(&other.recv().unwrap(), Autoreset::NextStep);
        assert_eq!(begun, in_turn[episode as usize]);
    }
    let mixed = Row::all(&other.reset().unwrap(), Autoreset::NextStep);
    assert_eq!(mixed, in_turn[1]);
}

/// The numbers are those of the tests in Python.
#[test]
fn environments_count_on_from_any_seed() {
    let server = Server::start();
    let request = SessionRequest::new("EcmReach-v0").envs(2);
    let mut counted = server.open(&request.clone().seed(u64::MAX));
    let seeds = [8_245_168_133_484_221_968, 313_702_574_736_366_215];
    assert_eq!(counted.reset().unwrap().seed(), seeds);
    let mut given = server.open(&request);
    assert_eq!(given.reset_envs(&[0, 1], Some(&[u64::MAX, 5])).unwrap().seed(), [seeds[0], 5]);
}
