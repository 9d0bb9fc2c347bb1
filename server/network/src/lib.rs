//! Policies that were trained: ONNX files, as `python -m trocar.rl export` writes them.
//!
//! Inputs have the names `observation`, `achieved_goal` and `desired_goal`, as many of them as the
//! policy uses, and the shape (1, dimension); the first output is the action, (1, action dim).
//! Elementary functions are those of the runtime, so bits may differ between kinds of processors.
//!
//! A crate of its own because the runtime takes minutes to compile into whatever calls it.

mod onnx;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::{fs, io};

use rten::{Dimension, Model, NodeId, RunOptions, ThreadPool, ValueView};
use trocar_proto::TaskSpec;

/// Fields of the file's metadata: the task's id; its options as JSON; Trocar's version; the card as JSON.
const TASK: &str = "trocar.task";
const OPTIONS: &str = "trocar.options";
const VERSION: &str = "trocar.version";
const CARD: &str = "trocar.card";

/// Why a policy gives no action.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file can't be read, or holds nothing that acts in the task.
    #[error("{}: {why}", path.display())]
    Unfit {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and what is expected.
        why: String,
    },
    /// Computing an action failed.
    #[error("{}", path.display())]
    Failed {
        /// The file.
        path: PathBuf,
        /// What the runtime says.
        source: Source,
    },
}

/// A policy from a file.
#[derive(Clone)]
pub struct Network {
    path: PathBuf,
    model: Arc<Model>,
    inputs: Vec<(NodeId, Part)>,
    output: NodeId,
    /// Where it is computed: one thread, since it is small.
    options: RunOptions,
}

/// What is seen of a state.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// What the arms and objects do, (observation dim).
    pub observation: &'a [f32],
    /// What is achieved, (goal dim).
    pub achieved: &'a [f32],
    /// What is to be achieved, (goal dim).
    pub desired: &'a [f32],
}

/// A part of what is seen.
#[derive(Debug, Clone, Copy)]
enum Part {
    Observation,
    Achieved,
    Desired,
}

impl Part {
    fn of<'a>(self, seen: &Seen<'a>) -> &'a [f32] {
        match self {
            Self::Observation => seen.observation,
            Self::Achieved => seen.achieved,
            Self::Desired => seen.desired,
        }
    }

    fn dim(self, spec: &TaskSpec) -> usize {
        match self {
            Self::Observation => spec.observation_dim(),
            Self::Achieved | Self::Desired => spec.goal_dim(),
        }
    }
}

impl Network {
    /// Reads a file.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let unfit = |error: io::Error| Error::Unfit { path: path.into(), why: error.to_string() };
        Self::read(path, fs::read(path).map_err(unfit)?)
    }

    /// Reads what the file at `path` holds.
    pub fn read(path: &Path, bytes: Vec<u8>) -> Result<Self, Error> {
        let unfit = |why| Error::Unfit { path: path.to_path_buf(), why };
        onnx::check(&bytes).map_err(unfit)?;
        let model =
            guarded(|| Ok(Model::load(bytes)?)).map_err(|error| unfit(error.to_string()))?;
        let mut inputs = Vec::new();
        for id in model.input_ids() {
            let name = model.node_info(*id).and_then(|node| node.name()).unwrap_or_default();
            let part = match name {
                "observation" => Part::Observation,
                "achieved_goal" => Part::Achieved,
                "desired_goal" => Part::Desired,
                _ => {
                    let allowed = "observation, achieved_goal and desired_goal";
                    return Err(unfit(format!("input {name:?}; allowed are {allowed}")));
                }
            };
            inputs.push((*id, part));
        }
        let output = *model.output_ids().first().ok_or_else(|| unfit("no output".into()))?;
        let (path, model) = (path.to_path_buf(), Arc::new(model));
        Ok(Self { path, model, inputs, output, options: options() })
    }

    /// The same policy, computed in a thread of its own.
    #[must_use]
    pub fn twin(&self) -> Self {
        Self { options: options(), ..self.clone() }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The task that it was trained for, if the file says so.
    pub fn task(&self) -> Option<&str> {
        self.model.metadata().get(TASK)
    }

    /// The options of the task that it was trained with, a JSON object, if the file says so.
    pub fn options(&self) -> Option<&str> {
        self.model.metadata().get(OPTIONS)
    }

    /// The version of Trocar that it was trained in, if the file says so.
    pub fn version(&self) -> Option<&str> {
        self.model.metadata().get(VERSION)
    }

    /// How it was trained and how well it does, a JSON object, if the file says so.
    pub fn card(&self) -> Option<&str> {
        self.model.metadata().get(CARD)
    }

    /// An error unless it can act in a task.
    pub fn check(&self, spec: &TaskSpec) -> Result<(), Error> {
        let unfit = |why| Err(Error::Unfit { path: self.path.clone(), why });
        if let Some(task) = self.task().filter(|task| *task != spec.id) {
            return unfit(format!("it was trained for {task}, not for {}", spec.id));
        }
        for (id, part) in &self.inputs {
            let wanted = part.dim(spec);
            let shape = self.model.node_info(*id).and_then(|node| node.shape()).unwrap_or_default();
            if let Some(Dimension::Fixed(width)) = shape.last()
                && *width != wanted
            {
                return unfit(format!("{part:?} has {width} numbers; {} has {wanted}", spec.id));
            }
        }
        Ok(())
    }

    /// Writes the action that it chooses, (action dim).
    pub fn act(&self, seen: &Seen<'_>, action: &mut [f32]) -> Result<(), Error> {
        let (shape, numbers) =
            self.run(seen).map_err(|source| Error::Failed { path: self.path.clone(), source })?;
        if shape != [1, action.len()] {
            let why = format!("its action has the shape {shape:?}; expected [1, {}]", action.len());
            return Err(Error::Unfit { path: self.path.clone(), why });
        }
        action.copy_from_slice(&numbers);
        Ok(())
    }

    fn run(&self, seen: &Seen<'_>) -> Result<([usize; 2], Vec<f32>), Source> {
        let mut inputs = Vec::with_capacity(self.inputs.len());
        for (id, part) in &self.inputs {
            let numbers = part.of(seen);
            inputs.push((*id, ValueView::from_shape([1, numbers.len()], numbers)?.into()));
        }
        let options = Some(self.options.clone());
        guarded(|| {
            let [output] = self.model.run_n(inputs, [self.output], options)?;
            Ok(output.into_shape_vec::<f32, 2>()?)
        })
    }
}

/// Any error.
type Source = Box<dyn std::error::Error + Send + Sync>;

/// Does what the runtime may panic at, where a file holds what its authors did not think of.
fn guarded<T>(work: impl FnOnce() -> Result<T, Source>) -> Result<T, Source> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err("the runtime failed at what it holds".into()))
}

fn options() -> RunOptions {
    RunOptions::default().with_thread_pool(Some(Arc::new(ThreadPool::with_num_threads(1))))
}
