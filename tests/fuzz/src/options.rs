//! Options of tasks, as text and as a message, and the environment that they make.

use std::sync::LazyLock;

use trocar_proto::control::{self, ControlReply};
use trocar_proto::spec::{Allowed, OptionValue};
use trocar_proto::{Options, TaskSpec};
use trocar_server::Registry;
use trocar_server::tasks::Assignment;

use crate::control::{check, encode};
use crate::input::Input;

static REGISTRY: LazyLock<Registry> = LazyLock::new(Registry::builtin);

/// Every task with its default options.
static TASKS: LazyLock<Vec<TaskSpec>> = LazyLock::new(|| {
    REGISTRY.ids().map(|id| REGISTRY.spec(id, &Options::new()).expect("a task")).collect()
});

/// A byte that says which task, one that says how the rest is read: as lines `NAME=VALUE`, or as a message.
pub(crate) fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let task = &TASKS[input.byte() as usize % TASKS.len()];
    let options = if input.byte().is_multiple_of(2) {
        let text = String::from_utf8_lossy(input.rest());
        let Ok(assignments) = text.lines().map(Assignment::parse).collect::<Result<Vec<_>, _>>()
        else {
            return;
        };
        Assignment::options(&assignments, &task.options)
    } else {
        control::decode(input.rest())
    };
    match options {
        Ok(options) => make(task, &options),
        Err(refusal) => check(&refusal),
    }
}

/// What is allowed makes an environment that can be reset and stepped.
fn make(task: &TaskSpec, options: &Options) {
    let spec = match REGISTRY.spec(&task.id, options) {
        Ok(spec) => spec,
        Err(refusal) => return check(&refusal),
    };
    encode(&ControlReply::DescribeTask(spec.clone().into())).expect("a client can be told");
    let mut env = REGISTRY.make(&task.id, options).expect("its description was made");
    assert_eq!(*env.spec(), spec);
    env.reset(Some(1));
    let action = vec![0.0; spec.action_dim()];
    env.step(&action).ok();
    let [mut observation, mut achieved, mut desired] =
        [spec.observation_dim(), spec.goal_dim(), spec.goal_dim()].map(|dim| vec![0.0; dim]);
    env.observe(&mut observation, &mut achieved, &mut desired);
    let mut seen = observation.iter().chain(&achieved).chain(&desired);
    assert!(seen.all(|number| number.is_finite()), "{options:?}");
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = vec![];
    for (number, task) in (0..).zip(TASKS.iter()) {
        let mut options = Options::new();
        for option in &task.options {
            let (value, text) = other(&option.allowed);
            let text = format!("{}{text}", option.name);
            seeds.push([vec![number, 0], text.into_bytes()].concat());
            options = options.with(&option.name, value);
        }
        seeds.push([vec![number, 1], encode(&options).expect("it is short")].concat());
    }
    seeds
}

/// A value that is allowed, most often not the default, and as text.
fn other(allowed: &Allowed) -> (OptionValue, String) {
    let numbers = |numbers: &[f64]| {
        let texts: Vec<_> = numbers.iter().map(ToString::to_string).collect();
        texts.join(",")
    };
    match allowed {
        Allowed::Flag => (OptionValue::Flag(true), "=true".into()),
        Allowed::Range { max, .. } => (OptionValue::Number(*max), format!("={max}")),
        Allowed::NumberOf(numbers) => (OptionValue::Number(numbers[0]), format!("={}", numbers[0])),
        Allowed::OneOf(words) => {
            let last = words[words.len() - 1].clone();
            (OptionValue::Text(last.clone()), format!("={last}"))
        }
        Allowed::SomeOf(words) => {
            (OptionValue::Texts(words.clone()), format!("={}", words.join(",")))
        }
        Allowed::Vector { count, min, .. } => {
            let vector = vec![*min; *count];
            (OptionValue::Numbers(vector.clone()), format!("={}", numbers(&vector)))
        }
        Allowed::Table(rows) => {
            let row = &rows[0];
            let vector = vec![row.max; row.count];
            let text = format!(".{}={}", row.name, numbers(&vector));
            (OptionValue::Table([(row.name.clone(), vector)].into()), text)
        }
    }
}
