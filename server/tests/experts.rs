//! What becomes of the scripted experts' episodes: `fixtures/experts.tsv` has every task under everything that
//! changes what its expert does, and the seeds with which the expert fails.
//!
//! The episodes must end as the table says, no worse and no better; `make experts` writes it anew. With
//! `TROCAR_SOAK=1` more seeds are played instead, of which a share may fail.
//!
//! An expert fails where the last step is no success; without goals, where the episode ends early. In none of
//! these episodes may a number leave its bounds. Where friction alone is to hold objects, no constraint but the
//! fingers' hinges may ever be in the world.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use trocar_proto::spec::{Allowed, OptionSpec, RowSpec};
use trocar_proto::{OptionValue, Options, TaskSpec};
use trocar_server::Registry;

/// The committed table, and its first line.
const TABLE: &str = "tests/fixtures/experts.tsv";
const HEAD: &str = "task\toptions\tseeds\tfailing seeds";

/// A task under options.
struct Case {
    id: String,
    options: Options,
    /// How many seeds, from 0 on, the table tells of, and how many are played in a soak.
    seeds: [u64; 2],
    /// The share of a soak's episodes that may fail; none where nothing is promised.
    may_fail: Option<f64>,
}

impl Case {
    /// What stands for it in the table, the options as `trocar rollout --option` takes them.
    fn name(&self) -> String {
        let number =
            |numbers: &[f64]| numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
        let mut words = vec![];
        for (name, value) in &self.options.0 {
            match value {
                OptionValue::Text(word) => words.push(format!("{name}={word}")),
                OptionValue::Texts(list) => words.push(format!("{name}={}", list.join(","))),
                OptionValue::Table(rows) => {
                    words.extend(
                        rows.iter().map(|(row, it)| format!("{name}.{row}={}", number(it))),
                    );
                }
                other => words.push(format!("{name}={other}")),
            }
        }
        let options = if words.is_empty() { "-".into() } else { words.join(" ") };
        format!("{}\t{options}", self.id)
    }

    /// Plays so many seeds.
    fn play(&self, seeds: u64) -> Played {
        let env = Registry::builtin().make(&self.id, &self.options).unwrap();
        let grasp = env.spec().options.iter().find(|option| option.name == "grasp");
        let grasp = grasp.map(|option| self.options.0.get("grasp").unwrap_or(&option.default));
        let by_friction = grasp == Some(&OptionValue::Text("interact".into()));
        let hinges = 2 * (env.spec().action_dim() / 5).max(1);
        let has_goal = env.spec().goal.is_some();
        let play = |seed: u64| {
            let mut env = env.clone();
            let mut action = vec![0.0; env.spec().action_dim()];
            env.reset(Some(seed));
            let mut last = None;
            while !env.needs_reset() {
                env.expert(&mut action);
                last = Some(env.step(&action).unwrap());
                let joints = env.world().joints().count();
                assert!(!by_friction || joints == hinges, "{}: {seed}", self.name());
            }
            let last = last.unwrap();
            let fails = if has_goal { !last.is_success } else { last.terminated };
            let excesses = env.clamped().into_iter();
            (seed, fails, excesses.map(|it| format!("{}: {seed}: {it:?}", self.name())).collect())
        };
        let mut played = Played { seeds, ..Played::default() };
        let episodes: Vec<(_, _, Vec<_>)> = (0..seeds).into_par_iter().map(play).collect();
        for (seed, fails, out_of_bounds) in episodes {
            played.failing.extend(fails.then_some(seed));
            played.out_of_bounds.extend(out_of_bounds);
        }
        played
    }
}

/// What became of the first seeds of a case.
#[derive(Default)]
struct Played {
    seeds: u64,
    failing: Vec<u64>,
    /// Numbers that the environment had to clamp.
    out_of_bounds: Vec<String>,
}

/// The cases of one task, with the numbers of seeds and the bars that they share.
struct Cases<'a> {
    spec: &'a TaskSpec,
    grasps: bool,
    found: Vec<Case>,
}

impl Cases<'_> {
    /// Adds a case; `seeds` of a task that grasps, which takes long, and of any other.
    fn add(&mut self, options: Options, seeds: [[u64; 2]; 2], may_fail: Option<f64>) {
        // As many steps, not episodes: they are ten times as long where a target is followed.
        let episode = u64::from(self.spec.max_steps.div_ceil(50));
        let seeds = seeds[usize::from(!self.grasps)].map(|seeds| seeds.div_ceil(episode));
        self.found.push(Case { id: self.spec.id.clone(), options, seeds, may_fail });
    }

    /// Adds what is special about tasks with tissue, whose steps take a hundred times as long as others'.
    fn add_tissue(&mut self) {
        for (option, word) in
            [("action", "cartesian_abs"), ("action", "joint"), ("expert_sees", "measured")]
        {
            self.add(Options::new().with_text(option, word), [[1, 100]; 2], Some(0.05));
        }
        self.add(Options::new().with("rate", OptionValue::Number(20.0)), [[1, 100]; 2], Some(0.05));
        let domain = self.spec.options.iter().find(|option| option.name == "domain");
        let Some(OptionSpec { allowed: Allowed::Table(rows), .. }) = domain else { return };
        let moduli = rows.iter().filter(|row| row.name == "modulus");
        let moduli = moduli.flat_map(|row| [("modulus", row.min), ("modulus", row.max)]);
        for (row, number) in moduli.chain([("friction", 0.5)]).collect::<Vec<_>>() {
            let rows = BTreeMap::from([(row.to_string(), vec![number; 2])]);
            let options = Options::new().with("domain", OptionValue::Table(rows));
            self.add(options, [[2, 100]; 2], Some(0.1));
        }
    }

    /// Adds the ends of every row of `domain`, and all rows together over their whole ranges.
    fn add_domain(&mut self, option: &OptionSpec) {
        /// Rows for which experts are not made; what they make of them is told all the same.
        const UNPROMISED: [&str; 6] = [
            "friction",
            "joint_offset",
            "latency",
            "latency_seconds",
            "action_noise",
            "action_noise_angle",
        ];
        let Allowed::Table(rows) = &option.allowed else { return };
        // What is wrong with arms has a table of its own in GRASPING.md.
        let is_of_task = |row: &&RowSpec| !crate::suite::is_arm_error(&row.name);
        let rows: Vec<_> = rows.iter().filter(is_of_task).collect();
        let draws = |ranges: BTreeMap<String, Vec<f64>>| {
            Options::new().with("domain", OptionValue::Table(ranges))
        };
        for row in &rows {
            let may_fail = (!UNPROMISED.contains(&row.name.as_str())).then_some(0.1);
            for end in [row.min, row.max] {
                let options = draws(BTreeMap::from([(row.name.clone(), vec![end; 2])]));
                self.add(options, [[3, 40], [5, 100]], may_fail);
            }
        }
        let promised = rows.iter().filter(|row| !UNPROMISED.contains(&row.name.as_str()));
        let whole = promised.map(|row| (row.name.clone(), vec![row.min, row.max]));
        self.add(draws(whole.collect()), [[4, 100], [20, 100]], Some(0.1));
    }
}

/// Every task as the paper has it and under everything that changes what its expert does.
fn cases() -> Vec<Case> {
    /// What changes no episode of an expert: rewards, and how pictures are taken.
    const OTHERS: [&str; 3] = ["reward", "camera", "look"];
    let registry = Registry::builtin();
    let mut cases = vec![];
    for id in registry.ids() {
        let spec = registry.spec(id, &Options::new()).unwrap();
        let is_tissue = registry.tagged("tissue").any(|tissue| tissue == id);
        let grasps = !is_tissue && spec.options.iter().any(|option| option.name == "grasp");
        // What is only reached for is reached always; what is grasped may be lost.
        let may_fail = Some(if grasps { 0.05 } else { 0.0 });
        let mut own = Cases { spec: &spec, grasps, found: vec![] };
        let may_fail = if is_tissue { Some(0.05) } else { may_fail };
        let few = if is_tissue { [6, 200] } else { [100, 500] };
        own.add(Options::new(), [[16, 500], few], may_fail);
        if grasps {
            let surrol = Options::new().with_text("preset", "surrol");
            own.add(surrol.with_text("grasp", "interact"), [[16, 500]; 2], may_fail);
        }
        if ["NeedlePick-v0", "PegTransfer-v0"].contains(&id) {
            let rows = BTreeMap::from([("friction".to_string(), vec![0.5, 0.5])]);
            let slippery = Options::new().with("domain", OptionValue::Table(rows));
            own.add(slippery, [[16, 500]; 2], Some(0.1));
        }
        if is_tissue {
            own.add_tissue();
            cases.extend(own.found);
            continue;
        }
        for option in spec.options.iter().filter(|option| !OTHERS.contains(&option.name.as_str())) {
            match &option.allowed {
                Allowed::OneOf(words) => {
                    let few = if option.name == "spawn" { [16, 500] } else { [4, 100] };
                    for word in &words[1..] {
                        let options = Options::new().with_text(&option.name, word);
                        own.add(options, [few, [50, 500]], may_fail);
                    }
                }
                Allowed::SomeOf(words) if words.iter().any(|word| word == "perceived") => {
                    let words = OptionValue::Texts(vec!["perceived".into()]);
                    let options = Options::new().with(&option.name, words);
                    // What an expert that perceives must achieve is tested with pictures.
                    own.add(options, [[5, 50]; 2], None);
                }
                Allowed::NumberOf(numbers) => {
                    for number in
                        numbers.iter().filter(|it| option.default != OptionValue::Number(**it))
                    {
                        let options =
                            Options::new().with(&option.name, OptionValue::Number(*number));
                        own.add(options, [[4, 100], [20, 100]], may_fail);
                    }
                }
                Allowed::Table(_) if option.name == "domain" => own.add_domain(option),
                _ => {}
            }
        }
        cases.extend(own.found);
    }
    cases
}

/// A case's line of the table.
fn line(case: &Case, played: &Played) -> String {
    let failing: Vec<_> = played.failing.iter().map(ToString::to_string).collect();
    let failing = if failing.is_empty() { "-".into() } else { failing.join(" ") };
    format!("{}\t{}\t{failing}", case.name(), played.seeds)
}

#[test]
fn experts_do_as_well_as_the_table_says_and_stay_in_bounds() {
    let soak = std::env::var_os("TROCAR_SOAK").is_some();
    let mut cases = cases();
    let only = std::env::var("TROCAR_TASK").ok();
    cases.retain(|case| only.as_ref().is_none_or(|only| *only == case.id));
    let play = |case: &Case| case.play(case.seeds[usize::from(soak)]);
    let played: Vec<_> = cases.par_iter().map(play).collect();
    let out_of_bounds: Vec<_> = played.iter().flat_map(|played| &played.out_of_bounds).collect();
    assert!(out_of_bounds.is_empty(), "{out_of_bounds:#?}");
    let lines: Vec<_> =
        cases.iter().zip(&played).map(|(case, played)| line(case, played)).collect();
    if soak {
        eprintln!("{}", lines.join("\n"));
        let is_bad = |case: &Case, played: &Played| {
            let most = case.may_fail.map(|share| share * played.seeds as f64);
            most.is_some_and(|most| played.failing.len() as f64 > most)
        };
        let pairs = cases.iter().zip(&played).zip(&lines);
        let bad = pairs.filter(|((case, played), _)| is_bad(case, played));
        let bad: Vec<_> = bad.map(|(_, line)| line).collect();
        assert!(bad.is_empty(), "{bad:#?}");
    } else if std::env::var_os("TROCAR_WRITE_EXPERTS").is_some() {
        // Of other tasks than those that were played it stays as it was.
        let text = std::fs::read_to_string(path()).unwrap();
        let is_kept = |line: &&str| only.as_ref().is_some_and(|only| !line.starts_with(only));
        let kept = text.lines().skip(1).filter(is_kept).map(String::from);
        let lines: Vec<_> = kept.chain(lines).collect();
        std::fs::write(path(), format!("{HEAD}\n{}\n", lines.join("\n"))).unwrap();
    } else {
        assert!(only.is_none(), "the table has every task");
        assert_same(&lines);
    }
}

fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(TABLE)
}

/// Fails unless the table has these lines.
fn assert_same(lines: &[String]) {
    let text = std::fs::read_to_string(path()).unwrap();
    let expected: Vec<_> = text.lines().skip(1).collect();
    let gone = expected.iter().filter(|line| !lines.iter().any(|other| other == *line));
    let new = lines.iter().filter(|line| !expected.contains(&line.as_str()));
    let mut changed: Vec<_> = gone.map(|line| format!("- {line}")).collect();
    changed.extend(new.map(|line| format!("+ {line}")));
    // What was and what is of a case stand together.
    changed.sort_by(|one, other| one[2..].cmp(&other[2..]));
    assert!(
        changed.is_empty() && text.lines().next() == Some(HEAD),
        "{TABLE} is not what experts do (-: the table, +: now). Where that is meant, `make experts` \
         writes it anew.\n{}",
        changed.join("\n")
    );
}
