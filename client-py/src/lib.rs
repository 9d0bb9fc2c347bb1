//! `trocar._trocar`: the Python bindings of the Trocar client.
//!
//! Thin on purpose: connections, sessions, replies as arrays, errors. Spaces, environments and
//! ids are Python (`python/trocar/`); physics is the server's.

mod array;
mod client;
mod columns;
mod error;
mod live;
mod network;
mod session;
mod snapshot;
mod spec;
mod wait;

use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyTuple};

/// The module; its Python side is documented in `_trocar.pyi`.
#[pymodule]
fn _trocar(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("PRIVATE_SERVER", trocar_client::private::VARIABLE)?;
    module.add("BINARY", trocar_client::private::BINARY)?;
    let stages = trocar_client::proto::Stage::ALL.map(trocar_client::proto::Stage::name);
    module.add("STAGES", PyTuple::new(module.py(), stages)?)?;
    let tasks = trocar_client::proto::builtin::ALL;
    let tasks = tasks.iter().map(|task| (task.id, (task.steps, task.hertz, task.tags.to_vec())));
    module.add("TASKS", tasks.into_py_dict(module.py())?)?;
    module.add("INFOS", PyTuple::new(module.py(), columns::all_infos())?)?;
    module.add_class::<client::Client>()?;
    module.add_class::<session::Session>()?;
    module.add_class::<session::Reply>()?;
    module.add_class::<live::LiveWorld>()?;
    module.add_class::<network::Network>()?;
    module.add_class::<snapshot::Snapshot>()?;
    module.add_class::<spec::TaskSpec>()?;
    module.add_class::<spec::Element>()?;
    module.add_class::<spec::GoalPart>()?;
    module.add_class::<spec::ImageSpec>()?;
    module.add_class::<spec::OptionSpec>()?;
    module.add_function(wrap_pyfunction!(unique_name, module)?)?;
    module.add_function(wrap_pyfunction!(seed_of, module)?)?;
    module.add_function(wrap_pyfunction!(snapshot::split_snapshot, module)?)?;
    Ok(())
}

/// A name for a private server that no other has.
#[pyfunction]
fn unique_name() -> String {
    trocar_client::private::unique_name()
}

/// The seed of a number of any size, given by its bytes, the least significant one first.
#[pyfunction]
fn seed_of(number: &[u8]) -> u64 {
    trocar_client::proto::seed::of_le_bytes(number)
}
