//! The connection to a server.

use std::path::PathBuf;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use trocar_client::private::PrivateServer;
use trocar_client::proto::control::ServerInfo;
use trocar_client::proto::dvrk::{Homing, LiveRequest};
use trocar_client::{Autoreset, CallError, Code, OptionValue, Options, Rejection, SessionRequest};

use crate::array::described;
use crate::live::LiveWorld;
use crate::session::Session;
use crate::spec::TaskSpec;
use crate::{error, spec, wait};

/// A connection to one server; it ends with the last of this object and its sessions.
#[pyclass(frozen, weakref, module = "trocar._trocar")]
pub(crate) struct Client {
    client: trocar_client::Client,
}

#[pymethods]
impl Client {
    /// Connects to the running server of that name.
    #[staticmethod]
    fn connect(py: Python<'_>, name: String) -> PyResult<Self> {
        let connected =
            wait::interruptibly(py, move || trocar_client::Client::connect_as(&name, "python"))?;
        Ok(Self { client: connected.map_err(|error| error::connect(py, error))? })
    }

    /// Connects to the private server of that name, which `binary` is started for if need be.
    #[staticmethod]
    fn launch(py: Python<'_>, private: String, binary: PathBuf) -> PyResult<Self> {
        let connected = wait::interruptibly(py, move || {
            trocar_client::Client::launch(&PrivateServer::new(&private, &binary)?, "python")
        })?;
        Ok(Self { client: connected.map_err(|error| error::connect(py, error))? })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.server().name
    }

    #[getter]
    fn pid(&self) -> u32 {
        self.server().pid
    }

    #[getter]
    fn epoch(&self) -> u64 {
        self.server().epoch
    }

    #[getter]
    fn version(&self) -> &str {
        &self.server().version
    }

    #[getter]
    fn max_envs(&self) -> u32 {
        self.server().max_envs
    }

    /// The ids of the tasks that the server offers.
    fn tasks(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.call(py, trocar_client::Client::tasks)
    }

    /// What a task looks like under some options.
    #[pyo3(signature = (task, options=None))]
    fn describe(
        &self,
        py: Python<'_>,
        task: String,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<TaskSpec> {
        let options = self.options(py, &task, options)?;
        let spec = self.call(py, move |client| client.describe(&task, &options))?;
        Ok(TaskSpec::new(spec))
    }

    /// Opens a session: one task, N environments, one seed, its options.
    #[pyo3(signature = (task, *, envs, seed, autoreset, options=None, view=None))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords")]
    fn open(
        &self,
        py: Python<'_>,
        task: String,
        envs: i64,
        seed: u64,
        autoreset: &str,
        options: Option<&Bound<'_, PyDict>>,
        view: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Session> {
        let refused = |code, field: &str, value: &dyn std::fmt::Display, allowed: &str| {
            error::rejection(py, &Rejection::new(code, field, value, allowed))
        };
        let envs = u32::try_from(envs).map_err(|_| {
            let allowed = format!("allowed are 1 to {}", self.server().max_envs);
            refused(Code::InvalidEnvCount, "envs", &envs, &allowed)
        })?;
        let autoreset = match autoreset {
            "NextStep" => Autoreset::NextStep,
            "SameStep" => Autoreset::SameStep,
            "Disabled" => Autoreset::Disabled,
            other => {
                let allowed = "allowed are \"NextStep\", \"SameStep\", \"Disabled\"";
                return Err(refused(Code::InvalidOption, "autoreset", &other, allowed));
            }
        };
        let options = self.options(py, &task, options)?;
        let view = view.map(view_options).transpose()?;
        let request = SessionRequest { task, envs, seed, autoreset, options, view, live: None };
        let session = self.call(py, move |client| client.open(&request))?;
        Session::new(py, session)
    }

    /// Opens a session with a live world: in lock-step, or where there is a `speed`, so many times as fast as life.
    #[pyo3(signature = (
        task, *, seed=0, options=None, homing="to_zero", speed=None, world=None, intervention=false, view=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords")]
    fn open_live(
        &self,
        py: Python<'_>,
        task: &str,
        seed: u64,
        options: Option<&Bound<'_, PyDict>>,
        homing: &str,
        speed: Option<f64>,
        world: Option<u64>,
        intervention: bool,
        view: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<LiveWorld> {
        let homing = match homing {
            "to_zero" => Homing::ToZero,
            "in_place" => Homing::InPlace,
            other => {
                let allowed = "allowed are \"to_zero\", \"in_place\"";
                let refusal = Rejection::new(Code::InvalidOption, "homing", other, allowed);
                return Err(error::rejection(py, &refusal));
            }
        };
        let options = self.options(py, task, options)?;
        let live = LiveRequest { homing, speed, world, intervention };
        let request = SessionRequest::new(task).seed(seed).options(options).live(live);
        let request = SessionRequest { view: view.map(view_options).transpose()?, ..request };
        let world = self.call(py, move |client| client.open_live(&request))?;
        LiveWorld::new(py, world)
    }

    /// The server's clients and sessions, and how fast it runs.
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        plain(py, serde_json::to_string(&self.call(py, trocar_client::Client::status)?))
    }

    /// What one client, a process, may have of the server.
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        plain(py, serde_json::to_string(&self.call(py, trocar_client::Client::limits)?))
    }

    /// Where the server's live viewer is, as "address:port"; it is started where there is none.
    fn viewer(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.call(py, trocar_client::Client::viewer)?.to_string())
    }

    /// Where the page is that may drive arms.
    fn driving_page(&self, py: Python<'_>) -> PyResult<String> {
        self.call(py, trocar_client::Client::driving_page)
    }

    /// Ends the server, for all of its clients.
    fn shut_down(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, trocar_client::Client::shut_down)
    }

    fn __repr__(&self) -> String {
        let ServerInfo { name, pid, .. } = self.server();
        format!("<trocar client of server {name:?}, process {pid}>")
    }
}

impl Client {
    fn server(&self) -> &ServerInfo {
        self.client.server()
    }

    /// The options of a task; one that it does not know is refused as that, whatever its value.
    fn options(
        &self,
        py: Python<'_>,
        task: &str,
        given: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Options> {
        let mut options = Options::new();
        for (name, value) in given.into_iter().flatten() {
            let name: String = name.extract()?;
            match spec::option_value(&value, &format!("options.{name}")) {
                Ok(value) => options = options.with(&name, value),
                Err(error) => return Err(self.unknown(py, task, &name, &value)?.unwrap_or(error)),
            }
        }
        Ok(options)
    }

    /// The refusal of an option that the task does not know.
    fn unknown(
        &self,
        py: Python<'_>,
        task: &str,
        name: &str,
        value: &Bound<'_, PyAny>,
    ) -> PyResult<Option<PyErr>> {
        let (client, task) = (self.client.clone(), task.to_string());
        let alone = Options::new().with(name, OptionValue::Flag(false));
        match wait::interruptibly(py, move || client.describe(&task, &alone))? {
            Err(CallError::Refused(refusal)) if refusal.code == Code::UnknownOption => {
                let refusal = Rejection { value: described(value)?, ..refusal };
                Ok(Some(error::rejection(py, &refusal)))
            }
            _ => Ok(None),
        }
    }

    fn call<T: Send + 'static>(
        &self,
        py: Python<'_>,
        request: impl FnOnce(&trocar_client::Client) -> Result<T, CallError> + Send + 'static,
    ) -> PyResult<T> {
        let client = self.client.clone();
        wait::interruptibly(py, move || request(&client))?.map_err(|error| error::call(py, error))
    }
}

/// What was told, as dictionaries and lists.
fn plain(py: Python<'_>, told: serde_json::Result<String>) -> PyResult<Bound<'_, PyAny>> {
    let json = told.map_err(|error| error::new(py, "Internal", error.to_string()))?;
    py.import("json")?.call_method1("loads", (json,))
}

/// How environments are drawn.
fn view_options(given: &Bound<'_, PyDict>) -> PyResult<Options> {
    let mut options = Options::new();
    for (name, value) in given {
        let name: String = name.extract()?;
        let value = spec::option_value(&value, &format!("render_options.{name}"))?;
        options = options.with(&name, value);
    }
    Ok(options)
}
