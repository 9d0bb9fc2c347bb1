//! Which episodes are recorded, and how: everything that changes what a task does, with actions of which
//! half are the expert's and half are random.

use rayon::prelude::*;
use trocar_proto::spec::{Allowed, OptionSpec, OptionValue};
use trocar_proto::{Options, TaskSpec};
use trocar_server::Registry;
use trocar_server::sim::random::Rng;

use super::format::{Episode, json_of, number, quantised};
use super::player::Player;

/// Actions of an episode, unless it ends earlier: as many as goal tasks allow.
const STEPS: usize = 50;

/// Steps from one mark to the next.
pub(crate) const EVERY: usize = 10;

/// The first seed: all episodes have seeds of their own.
const FIRST_SEED: u64 = 7_000;

/// A row of a table by name.
type Row<'a> = (&'a str, &'a [f64]);

/// Rows of `setup` under which a task's arm can do its work.
const SETUPS: [(&str, &[Row]); 15] = [
    ("NeedleReach-v0", &[("base", &[0.06, 0.25, 0.845, -1.9]), ("table_height", &[0.672])]),
    ("GauzeRetrieve-v0", &[("table_height", &[0.67])]),
    ("NeedlePick-v0", &[("table_height", &[0.67])]),
    ("BiPegTransfer-v0", &[("base_2", &[0.06, -0.235, 0.85, -1.25])]),
    ("PegTransfer-v0", &[("table_height", &[0.67])]),
    ("CylinderPick-v0", &[("table_height", &[0.67])]),
    ("CylinderReach-v0", &[("table_height", &[0.672])]),
    ("NeedleRegrasp-v0", &[("base", &[0.055, 0.235, 0.85, -1.9]), ("table_height", &[0.673])]),
    ("EcmReach-v0", &[("base", &[-0.04, 0.01, 1.01, 0.5])]),
    ("MisOrient-v0", &[("base", &[-0.04, 0.01, 1.01, 0.5])]),
    ("StaticTrack-v0", &[("base", &[-0.04, 0.01, 1.01, 0.5])]),
    ("ActiveTrack-v0", &[("base", &[-0.04, 0.01, 1.01, 0.5])]),
    ("TissueRetract-v0", &[("table_height", &[0.67])]),
    ("TissuePoint-v0", &[("table_height", &[0.67])]),
    ("GauzePlace-v0", &[("table_height", &[0.67])]),
];

/// The episodes of every task, not yet played.
pub(crate) fn all() -> Vec<Episode> {
    let registry = Registry::builtin();
    let mut all = vec![];
    for id in registry.ids() {
        let spec = registry.spec(id, &Options::new()).unwrap();
        let options = if registry.tagged("tissue").any(|tissue| tissue == id) {
            few(&spec)
        } else {
            [physics(&spec), starts(&spec), domains(&spec), settings(&spec), views(&spec)].concat()
        };
        for options in options {
            let seed = FIRST_SEED + all.len() as u64;
            all.push(Episode {
                task: id.into(),
                options,
                seed,
                number: u32::from(seed.is_multiple_of(5)),
                expert_steps: 0,
                dim: 0,
                actions: vec![],
                marks: vec![],
            });
        }
    }
    all
}

/// Action modes, rewards, both ways to grasp, every row of `domain` at once, an arm elsewhere and every camera: what a task has whose steps take
/// a hundred times as long as others'.
fn few(spec: &TaskSpec) -> Vec<Options> {
    let mut options = crossed(vec![Options::new()], spec, "action");
    options.push(Options::new().with_text("reward", "dense").with_text("grasp", "approx"));
    let rows = |options: &Options| match options.0.get("domain") {
        Some(OptionValue::Table(rows)) => rows.len(),
        _ => 0,
    };
    let all = domains(spec).into_iter().filter(|options| options.text("preset").is_none());
    options.extend(all.max_by_key(rows));
    options.extend(settings(spec).into_iter().take(1));
    options.extend(views(spec));
    options
}

/// Plays episodes and notes what happens.
pub(crate) fn record(episodes: Vec<Episode>) -> Vec<Episode> {
    episodes.into_par_iter().map(record_one).collect()
}

fn record_one(mut episode: Episode) -> Episode {
    let what = format!("{} under {}", episode.task, json_of(&episode.options));
    let mut player = Player::new(&episode).unwrap_or_else(|refusal| panic!("{what}: {refusal}"));
    let mut driver = Driver::new(&episode, player.env().spec());
    episode.dim = driver.last.len() as u8;
    (episode.expert_steps, episode.actions) = (0, vec![]);
    episode.marks = vec![player.mark()];
    for step in 1..=STEPS {
        episode.expert_steps += u16::from(driver.choose(&player, step));
        let stored: Vec<_> = driver.last.iter().copied().map(quantised).collect();
        player.step(&stored.iter().copied().map(number).collect::<Vec<_>>());
        episode.actions.extend(stored);
        let is_last = step == STEPS || player.env().needs_reset();
        if is_last || step.is_multiple_of(EVERY) {
            episode.marks.push(player.mark());
        }
        if is_last {
            break;
        }
    }
    episode
}

/// In which steps of an episode the expert acts.
enum Shift {
    /// Six of ten.
    Bursts,
    /// The first thirty.
    First,
    /// Thirty, after some at random and before others.
    Middle,
    /// The last fifteen.
    Last,
}

/// Chooses actions: the expert's, or random ones.
struct Driver {
    rng: Rng,
    shift: Shift,
    /// Whether random actions begin at the last one and leave jaws as they are, so that what is held is
    /// carried; otherwise they are all over the range and beyond.
    wanders: bool,
    /// Which numbers of an action are of jaws.
    jaws: Vec<bool>,
    last: Vec<f32>,
}

impl Driver {
    fn new(episode: &Episode, spec: &TaskSpec) -> Self {
        let mut rng = Rng::new(episode.seed, u64::MAX);
        let shift = [Shift::Bursts, Shift::First, Shift::Middle, Shift::Last];
        let index = rng.index(shift.len());
        Self {
            shift: shift.into_iter().nth(index).unwrap(),
            wanders: rng.unit() < 0.5,
            jaws: spec.action.iter().map(|element| element.name.ends_with("jaw")).collect(),
            last: vec![0.0; spec.action_dim()],
            rng,
        }
    }

    /// Chooses the action of a step; whether it is the expert's.
    fn choose(&mut self, player: &Player, step: usize) -> bool {
        let is_expert = match self.shift {
            Shift::Bursts => step % 10 < 6,
            Shift::First => step <= 30,
            Shift::Middle => (6..=35).contains(&step),
            Shift::Last => step > 35,
        };
        if is_expert {
            player.env().expert(&mut self.last);
            return true;
        }
        for (number, is_jaw) in self.last.iter_mut().zip(&self.jaws) {
            if !self.wanders {
                *number = self.rng.uniform(-1.3, 1.3) as f32;
            } else if !is_jaw {
                *number = (*number + self.rng.uniform(-0.5, 0.5) as f32).clamp(-1.3, 1.3);
            }
        }
        false
    }
}

/// The words of an option that is a choice; none where the task does not know it.
fn words(spec: &TaskSpec, name: &str) -> Vec<String> {
    match spec.options.iter().find(|option| option.name == name) {
        Some(OptionSpec { allowed: Allowed::OneOf(words) | Allowed::SomeOf(words), .. }) => {
            words.clone()
        }
        _ => vec![],
    }
}

/// Each of `options` with each word of an option; the default is not given.
fn crossed(options: Vec<Options>, spec: &TaskSpec, name: &str) -> Vec<Options> {
    let words = words(spec, name);
    if words.is_empty() {
        return options;
    }
    let with = |options: &Options, word: &String| {
        // A preset brings another default of `grasp`.
        let is_given = *word != words[0] || (name == "grasp" && options.text("preset").is_some());
        if is_given { options.clone().with_text(name, word) } else { options.clone() }
    };
    options.iter().flat_map(|options| words.iter().map(|word| with(options, word))).collect()
}

/// Each of `options` with one word of an option, in turns.
fn alternated(options: Vec<Options>, spec: &TaskSpec, name: &str) -> Vec<Options> {
    let words = words(spec, name);
    let with = |(index, options): (usize, Options)| {
        // The number of words of what is crossed is even, so every second round is shifted.
        let word = words.get((index + index / 4) % words.len().max(1));
        word.map_or(options.clone(), |word| options.with_text(name, word))
    };
    options.into_iter().enumerate().map(with).collect()
}

/// Action modes, grasps and presets, each with each.
fn physics(spec: &TaskSpec) -> Vec<Options> {
    let mut options = vec![Options::new()];
    for name in ["preset", "grasp", "action"] {
        options = crossed(options, spec, name);
    }
    // The first one is the task as it is without options.
    let changed = options.split_off(1);
    for name in ["spawn", "reward"] {
        options.extend(words(spec, name).iter().map(|word| Options::new().with_text(name, word)));
    }
    options.extend(alternated(alternated(changed, spec, "spawn"), spec, "reward"));
    options
}

/// Starts, grasps and action modes, each with each.
fn starts(spec: &TaskSpec) -> Vec<Options> {
    let starts = words(spec, "start").into_iter().skip(1);
    let mut options: Vec<_> = starts.map(|word| Options::new().with_text("start", &word)).collect();
    options = crossed(options, spec, "grasp");
    options = crossed(options, spec, "action");
    let of_surrol = |(index, options): (usize, Options)| {
        if index % 3 == 0 { options.with_text("preset", "surrol") } else { options }
    };
    let options = options.into_iter().enumerate().map(of_surrol).collect();
    alternated(alternated(options, spec, "spawn"), spec, "reward")
}

/// Every row of `domain` by itself, and all together.
fn domains(spec: &TaskSpec) -> Vec<Options> {
    let domain = spec.options.iter().find(|option| option.name == "domain");
    let Some(OptionSpec { allowed: Allowed::Table(rows), .. }) = domain else { return vec![] };
    let range = |name: &str, [min, max]: [f64; 2]| {
        // Later actions hardly leave an episode.
        if name == "latency" { vec![1.0, 3.0] } else { vec![min, max] }
    };
    let rows = rows.iter().map(|row| (row.name.clone(), range(&row.name, [row.min, row.max])));
    let domain = |rows: &[(String, Vec<f64>)]| {
        Options::new().with("domain", OptionValue::Table(rows.iter().cloned().collect()))
    };
    let rows: Vec<_> = rows.collect();
    let mut options: Vec<_> = rows.chunks(1).map(domain).collect();
    // What is late fails, and then nothing is held that could be light or heavy.
    let in_time: Vec<_> = rows.iter().filter(|(name, _)| name != "latency").cloned().collect();
    for base in [domain(&rows), domain(&in_time), domain(&in_time)] {
        options.push(base.clone());
        options.push(base.with_text("preset", "surrol"));
    }
    let last = options.pop().unwrap();
    options.extend(crossed(vec![last], spec, "action"));
    let again: Vec<_> = options[..rows.len()].to_vec();
    options.extend(again);
    options
}

/// Arms elsewhere, grasps from further off, and targets that are perceived.
fn settings(spec: &TaskSpec) -> Vec<Options> {
    let mut options = vec![];
    for (_, rows) in SETUPS.iter().filter(|(id, _)| *id == spec.id) {
        let rows = rows.iter().map(|(name, row)| ((*name).to_string(), row.to_vec()));
        let moved = Options::new().with("setup", OptionValue::Table(rows.collect()));
        options.extend(crossed(vec![moved], spec, "action"));
    }
    if spec.options.iter().any(|option| option.name == "grasp_distance") {
        let far = Options::new().with_text("grasp", "approx");
        options.push(far.clone().with("grasp_distance", OptionValue::Number(0.006)));
        options.push(far.with("grasp_distance", OptionValue::Number(0.0)));
    }
    if words(spec, "observation").iter().any(|word| word == "perceived") {
        let perceived = crossed(vec![observing(&["perceived"])], spec, "preset");
        options.extend(crossed(perceived, spec, "action"));
        let off = OptionValue::Table([("camera_pose_angle".into(), vec![-0.004, 0.004])].into());
        options
            .push(observing(&["perceived", "rgb"]).with("domain", off).with("image_size", size()));
    }
    options
}

/// Pictures from every camera that the task has.
fn views(spec: &TaskSpec) -> Vec<Options> {
    let pictures = observing(&["state", "rgb", "depth", "mask"]).with("image_size", size());
    let mut options = crossed(vec![pictures.clone()], spec, "camera");
    let points = observing(&["rgb", "depth", "mask", "points"]).with("image_size", size());
    let points = points.with_text("camera", "overview");
    let has_preset = !words(spec, "preset").is_empty();
    options.push(if has_preset { points.with_text("preset", "surrol") } else { points });
    let near = [("camera_eye", [0.7, 0.2, 0.9]), ("camera_target", [0.45, 0.0, 0.7])];
    let placed = near.iter().fold(pictures.with_text("camera", "placed"), |options, (name, at)| {
        options.with(name, OptionValue::Numbers(at.to_vec()))
    });
    options.push(placed.with("camera_view", OptionValue::Number(30.0)));
    // Without an endoscope there is no picture from it.
    options.retain(|options| Registry::builtin().make(&spec.id, options).is_ok());
    options
}

fn size() -> OptionValue {
    OptionValue::Numbers(vec![48.0, 64.0])
}

fn observing(words: &[&str]) -> Options {
    let words = words.iter().map(ToString::to_string).collect();
    Options::new().with("observation", OptionValue::Texts(words))
}
