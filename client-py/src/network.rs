//! Policies that were trained: ONNX files.

use std::path::Path;

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use trocar_client::{Code, Rejection};
use trocar_network::{Error, Seen};

use crate::error;
use crate::spec::TaskSpec;

/// A policy of an ONNX file, as `trocar rollout --policy` runs it.
#[pyclass(frozen, module = "trocar._trocar")]
pub(crate) struct Network {
    network: trocar_network::Network,
}

#[pymethods]
impl Network {
    /// What the file `name` holds.
    #[new]
    fn new(py: Python<'_>, name: &str, content: Vec<u8>) -> PyResult<Self> {
        let network = py.detach(|| trocar_network::Network::read(Path::new(name), content));
        Ok(Self { network: network.map_err(|error| refused(py, error))? })
    }

    /// The task that it was trained for, if the file says so.
    #[getter]
    fn task(&self) -> Option<&str> {
        self.network.task()
    }

    /// The options of the task that it was trained with, a JSON object, if the file says so.
    #[getter]
    fn options(&self) -> Option<&str> {
        self.network.options()
    }

    /// How it was trained and how well it does, a JSON object, if the file says so.
    #[getter]
    fn card(&self) -> Option<&str> {
        self.network.card()
    }

    /// An error unless it can act in a task.
    fn check(&self, py: Python<'_>, spec: &TaskSpec) -> PyResult<()> {
        self.network.check(spec.inner()).map_err(|error| refused(py, error))
    }

    /// The action that it chooses.
    #[expect(clippy::needless_pass_by_value, reason = "as they come from Python")]
    fn act<'py>(
        &self,
        py: Python<'py>,
        observation: PyReadonlyArray1<'py, f32>,
        achieved: PyReadonlyArray1<'py, f32>,
        desired: PyReadonlyArray1<'py, f32>,
        numbers: usize,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let [observation, achieved, desired] = [&observation, &achieved, &desired];
        let seen = Seen {
            observation: observation.as_slice()?,
            achieved: achieved.as_slice()?,
            desired: desired.as_slice()?,
        };
        let mut action = vec![0.0; numbers];
        self.network.act(&seen, &mut action).map_err(|error| refused(py, error))?;
        Ok(PyArray1::from_vec(py, action))
    }
}

/// The exception of a policy that gives no action.
fn refused(py: Python<'_>, error: Error) -> PyErr {
    let (path, why) = match error {
        Error::Unfit { path, why } => (path, why),
        Error::Failed { path, source } => (path, source.to_string()),
    };
    error::rejection(py, &Rejection::new(Code::InvalidOption, "policy", path.display(), why))
}
