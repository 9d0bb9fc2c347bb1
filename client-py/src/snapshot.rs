//! Saved states of environments.

use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use trocar_client::proto::part;

use crate::error;

/// States of environments, which stay in the server until this is gone or the session ends.
#[pyclass(frozen, module = "trocar._trocar")]
pub(crate) struct Snapshot {
    snapshot: trocar_client::Snapshot,
}

impl Snapshot {
    pub(crate) fn new(snapshot: trocar_client::Snapshot) -> Self {
        Self { snapshot }
    }

    pub(crate) fn inner(&self) -> &trocar_client::Snapshot {
        &self.snapshot
    }
}

#[pymethods]
impl Snapshot {
    fn __len__(&self) -> usize {
        self.snapshot.len()
    }

    /// The states of these indices, in that order.
    #[allow(clippy::needless_pass_by_value, reason = "what Python passes is converted")]
    fn select(&self, indices: Vec<usize>) -> PyResult<Self> {
        if indices.iter().any(|index| *index >= self.snapshot.len()) {
            return Err(PyIndexError::new_err("a snapshot has no such state"));
        }
        Ok(Self { snapshot: self.snapshot.select(&indices) })
    }
}

/// The parts of an exported snapshot, one for each environment.
#[pyfunction]
pub(crate) fn split_snapshot<'py>(
    py: Python<'py>,
    data: &[u8],
) -> PyResult<Vec<Bound<'py, PyBytes>>> {
    let parts = part::split(data).map_err(|refusal| error::rejection(py, &refusal))?;
    Ok(parts.into_iter().map(|part| PyBytes::new(py, part)).collect())
}
