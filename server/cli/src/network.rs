//! Policies that were trained: ONNX files, as `python -m trocar.rl export` writes them.
//!
//! Inputs have the names `observation`, `achieved_goal` and `desired_goal`, as many of them as the
//! policy uses, and the shape (1, dimension); the first output is the action, (1, action dim).
//! Elementary functions are those of the runtime, so bits may differ between kinds of processors.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, ensure};
use rten::{Dimension, Model, NodeId, RunOptions, ThreadPool, ValueView};
use trocar_proto::TaskSpec;

use crate::exit::Exit;

/// The field of the file's metadata that names the task.
const TASK: &str = "trocar.task";

/// A policy from a file.
#[derive(Clone)]
pub(crate) struct Network {
    path: PathBuf,
    model: Arc<Model>,
    inputs: Vec<(NodeId, Part)>,
    output: NodeId,
    /// Where it is computed: one thread, since it is small.
    options: RunOptions,
}

/// What is seen of a state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen<'a> {
    pub(crate) observation: &'a [f32],
    pub(crate) achieved: &'a [f32],
    pub(crate) desired: &'a [f32],
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
    pub(crate) fn load(path: &Path) -> anyhow::Result<Self> {
        let unfit = |why: String| Exit::Usage(format!("--policy {}: {why}", path.display()));
        let model = Model::load_file(path).map_err(|error| unfit(error.to_string()))?;
        let mut inputs = Vec::new();
        for id in model.input_ids() {
            let name = model.node_info(*id).and_then(|node| node.name()).unwrap_or_default();
            let part = match name {
                "observation" => Part::Observation,
                "achieved_goal" => Part::Achieved,
                "desired_goal" => Part::Desired,
                _ => {
                    let allowed = "observation, achieved_goal and desired_goal";
                    return Err(unfit(format!("input {name:?}; allowed are {allowed}")).into());
                }
            };
            inputs.push((*id, part));
        }
        let output = *model.output_ids().first().ok_or_else(|| unfit("no output".into()))?;
        let (path, model) = (path.to_path_buf(), Arc::new(model));
        Ok(Self { path, model, inputs, output, options: options() })
    }

    /// The same policy, computed in a thread of its own.
    pub(crate) fn twin(&self) -> Self {
        Self { options: options(), ..self.clone() }
    }

    /// The file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The task that it was trained for, if the file says so.
    pub(crate) fn task(&self) -> Option<&str> {
        self.model.metadata().get(TASK)
    }

    /// An error unless it can act in a task.
    pub(crate) fn check(&self, spec: &TaskSpec) -> anyhow::Result<()> {
        let unfit = |why: String| {
            Err(Exit::Usage(format!("--policy {}: {why}", self.path.display())).into())
        };
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

    /// Writes the action that it chooses.
    pub(crate) fn act(&self, seen: &Seen<'_>, action: &mut [f32]) -> anyhow::Result<()> {
        let inputs = self.inputs.iter().map(|(id, part)| {
            let numbers = part.of(seen);
            Ok((*id, ValueView::from_shape([1, numbers.len()], numbers)?.into()))
        });
        let inputs = inputs.collect::<anyhow::Result<Vec<_>>>()?;
        let [output] = self
            .model
            .run_n(inputs, [self.output], Some(self.options.clone()))
            .with_context(|| self.path.display().to_string())?;
        let ([rows, columns], numbers) = output.into_shape_vec::<f32, 2>()?;
        ensure!(
            rows == 1 && columns == action.len(),
            "{}: its action has the shape ({rows}, {columns}); expected (1, {})",
            self.path.display(),
            action.len()
        );
        action.copy_from_slice(&numbers);
        Ok(())
    }
}

fn options() -> RunOptions {
    RunOptions::default().with_thread_pool(Some(Arc::new(ThreadPool::with_num_threads(1))))
}
