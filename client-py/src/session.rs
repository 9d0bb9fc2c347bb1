//! A session and its replies.

use std::collections::BTreeMap;
use std::iter::repeat_n;
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};

use numpy::{PyArray1, PyArrayMethods};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use trocar_client::proto::spec::ImageKind;
use trocar_client::{Code, Placement};

use crate::array::{Part, check_shape, flags, listed, pictures, with_numbers};
use crate::columns;
use crate::snapshot::Snapshot;
use crate::spec::TaskSpec;
use crate::{error, wait};

/// How an episode shall begin: goal, poses of objects by name, tips.
type Wanted = (Option<Vec<f64>>, BTreeMap<String, Vec<f64>>, Option<Vec<f64>>);

/// N environments of one task, which live in the server until this is closed.
#[pyclass(frozen, weakref, module = "trocar._trocar")]
pub(crate) struct Session {
    /// `None` once closed. Never waited for: a second thread gets an error.
    open: Mutex<Option<trocar_client::Session>>,
    spec: Py<TaskSpec>,
    id: u64,
    epoch: u64,
    envs: usize,
}

#[pymethods]
impl Session {
    #[getter]
    fn id(&self) -> u64 {
        self.id
    }

    #[getter]
    fn epoch(&self) -> u64 {
        self.epoch
    }

    #[getter]
    fn envs(&self) -> usize {
        self.envs
    }

    #[getter]
    fn spec(&self, py: Python<'_>) -> Py<TaskSpec> {
        self.spec.clone_ref(py)
    }

    /// Whether replies shall carry the scripted expert's action.
    fn want_expert(&self, py: Python<'_>, wanted: bool) -> PyResult<()> {
        self.with(py, |session| {
            session.want_expert(wanted);
            Ok(())
        })
    }

    /// Number of requests whose replies can be received.
    fn in_flight(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |session| Ok(session.in_flight()))
    }

    /// Resets environments and waits; with another request in flight it is refused.
    #[pyo3(signature = (env_ids=None, seeds=None, episodes=None))]
    fn reset(
        &self,
        py: Python<'_>,
        env_ids: Option<&Bound<'_, PyArray1<u32>>>,
        seeds: Option<&Bound<'_, PyArray1<u64>>>,
        episodes: Option<&Bound<'_, PyArray1<u64>>>,
    ) -> PyResult<Reply> {
        let env_ids = env_ids.map(listed).transpose()?;
        let seeds = seeds.map(listed).transpose()?;
        let episodes = episodes.map(listed).transpose()?;
        self.exchange(py, |session| {
            match (&seeds, &episodes) {
                (Some(seeds), Some(episodes)) => {
                    session.start_reset_to(env_ids.as_deref(), seeds, episodes)
                }
                _ => session.start_reset(env_ids.as_deref(), seeds.as_deref()),
            }
            .map_err(|error| error::call(py, error))
        })
        .map(Reply::new)
    }

    /// Lets episodes that have only begun begin as placements (goal, objects, tip) ask for, and waits.
    #[pyo3(signature = (placements, env_ids=None))]
    fn arrange(
        &self,
        py: Python<'_>,
        placements: Vec<Wanted>,
        env_ids: Option<&Bound<'_, PyArray1<u32>>>,
    ) -> PyResult<Reply> {
        let env_ids = env_ids.map(listed).transpose()?;
        let placement = |(goal, objects, tip)| Placement { goal, objects, tip };
        let placements: Vec<_> = placements.into_iter().map(placement).collect();
        self.exchange(py, |session| {
            py.detach(|| session.start_arrange(env_ids.as_deref(), &placements))
                .map_err(|error| error::call(py, error))
        })
        .map(Reply::new)
    }

    /// Steps all environments and waits; with another request in flight it is refused.
    #[pyo3(signature = (actions, single=false))]
    fn step(&self, py: Python<'_>, actions: &Bound<'_, PyAny>, single: bool) -> PyResult<Reply> {
        self.exchange(py, |session| start_step(session, None, actions, single)).map(Reply::new)
    }

    /// Starts a step of some environments.
    fn send(
        &self,
        py: Python<'_>,
        actions: &Bound<'_, PyAny>,
        env_ids: &Bound<'_, PyArray1<u32>>,
    ) -> PyResult<()> {
        let env_ids = listed(env_ids)?;
        self.with(py, |session| {
            wait::settled(py, session)?;
            start_step(session, Some(&env_ids), actions, false)
        })
    }

    /// Waits for the reply to the oldest request; where that is interrupted, it can be repeated.
    fn recv(&self, py: Python<'_>) -> PyResult<Reply> {
        self.with(py, |session| {
            wait::settled(py, session)?;
            let reply = wait::reply(py, session)?;
            Ok(Reply::new(reply))
        })
    }

    /// Saves the states of environments and waits.
    #[pyo3(signature = (env_ids=None))]
    fn snapshot(
        &self,
        py: Python<'_>,
        env_ids: Option<&Bound<'_, PyArray1<u32>>>,
    ) -> PyResult<Snapshot> {
        let env_ids = env_ids.map(listed).transpose()?;
        let reply = self.exchange(py, |session| {
            py.detach(|| session.start_snapshot(env_ids.as_deref()))
                .map_err(|error| error::call(py, error))
        })?;
        let missing = || error::new(py, "Malformed", "the reply is to another request");
        reply.into_snapshot().map(Snapshot::new).ok_or_else(missing)
    }

    /// Lets environments go on from a snapshot of this session, and waits.
    #[pyo3(signature = (snapshot, env_ids=None))]
    fn restore(
        &self,
        py: Python<'_>,
        snapshot: &Snapshot,
        env_ids: Option<&Bound<'_, PyArray1<u32>>>,
    ) -> PyResult<Reply> {
        let env_ids = env_ids.map(listed).transpose()?;
        self.exchange(py, |session| {
            session
                .start_restore(env_ids.as_deref(), snapshot.inner())
                .map_err(|error| error::call(py, error))
        })
        .map(Reply::new)
    }

    /// Lets environments go on from the present states of others, and waits.
    #[pyo3(signature = (sources, env_ids=None))]
    fn fork(
        &self,
        py: Python<'_>,
        sources: &Bound<'_, PyArray1<u32>>,
        env_ids: Option<&Bound<'_, PyArray1<u32>>>,
    ) -> PyResult<Reply> {
        let (sources, env_ids) = (listed(sources)?, env_ids.map(listed).transpose()?);
        self.exchange(py, |session| {
            session.start_fork(&sources, env_ids.as_deref()).map_err(|error| error::call(py, error))
        })
        .map(Reply::new)
    }

    /// Draws an environment: uint8 (H, W, 3), or with `depth` float32 (H, W) in m.
    fn render<'py>(
        &self,
        py: Python<'py>,
        env_id: u32,
        depth: bool,
    ) -> PyResult<Bound<'py, PyAny>> {
        let reply = self.exchange(py, |session| {
            session.start_render(env_id, depth).map_err(|error| error::call(py, error))
        })?;
        let view = self.with(py, |session| Ok(session.info().view.clone()))?;
        let Some(view) = view else {
            return Err(error::new(py, "Malformed", "the session has no view"));
        };
        let (height, width) = (view.views.len() * view.height, view.width);
        if depth {
            let array = PyArray1::from_slice(py, reply.picture_depth()).reshape([height, width])?;
            return Ok(array.into_any());
        }
        let array = PyArray1::from_slice(py, reply.picture_rgb()).reshape([height, width, 3])?;
        Ok(array.into_any())
    }

    /// A snapshot of this session as bytes.
    fn export_snapshot<'py>(
        &self,
        py: Python<'py>,
        snapshot: &Snapshot,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = self.with(py, |session| {
            py.detach(|| session.export(snapshot.inner())).map_err(|error| error::call(py, error))
        })?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Brings an exported snapshot into this session.
    fn import_snapshot(&self, py: Python<'_>, data: &[u8]) -> PyResult<Snapshot> {
        self.with(py, |session| {
            py.detach(|| session.import(data)).map_err(|error| error::call(py, error))
        })
        .map(Snapshot::new)
    }

    /// Gives up on the replies of all requests in flight.
    fn abandon(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |session| {
            session.abandon();
            Ok(())
        })
    }

    /// Ends the session; once is enough, more does no harm.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let session = self.lock(py)?.take();
        if let Some(session) = session {
            py.detach(|| wait::farewell(session));
        }
        Ok(())
    }

    #[getter]
    fn closed(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.lock(py)?.is_none())
    }

    fn __repr__(&self) -> String {
        format!("<trocar session {}, {} environments>", self.id, self.envs)
    }
}

impl Session {
    pub(crate) fn new(py: Python<'_>, session: trocar_client::Session) -> PyResult<Self> {
        let info = session.info();
        let (id, epoch, envs) = (info.session, info.epoch, session.envs());
        let spec = Py::new(py, TaskSpec::new(info.spec.clone()))?;
        Ok(Self { open: Mutex::new(Some(session)), spec, id, epoch, envs })
    }

    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Option<trocar_client::Session>>> {
        match self.open.try_lock() {
            Ok(guard) => Ok(guard),
            // Whatever panicked left a session whose next call reports what is wrong with it.
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => {
                Err(error::new(py, "Busy", "another thread waits for this session"))
            }
        }
    }

    fn with<T>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut trocar_client::Session) -> PyResult<T>,
    ) -> PyResult<T> {
        match self.lock(py)?.as_mut() {
            Some(session) => act(session),
            None => Err(error::new(py, "Closed", "the session was closed")),
        }
    }

    /// Starts a request and waits for its reply, on which it gives up where that fails.
    fn exchange(
        &self,
        py: Python<'_>,
        start: impl FnOnce(&mut trocar_client::Session) -> PyResult<()>,
    ) -> PyResult<trocar_client::Reply> {
        self.with(py, |session| {
            wait::settled(py, session)?;
            if session.in_flight() > 0 {
                let message = "requests are in flight; receive their replies first";
                return Err(error::new(py, "TooManyInFlight", message));
            }
            start(session)?;
            wait::reply(py, session).inspect_err(|_| session.abandon())
        })
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        let session = self.open.get_mut().map_or_else(|e| e.into_inner().take(), Option::take);
        if let Some(session) = session {
            // While the interpreter shuts down there is no other thread to let run meanwhile.
            let mut session = Some(session);
            Python::try_attach(|py| {
                let session = session.take();
                py.detach(|| session.map(wait::farewell));
            });
        }
    }
}

/// `actions` is (rows, action dim); where `single`, the user's space has no axis of environments.
fn start_step(
    session: &mut trocar_client::Session,
    env_ids: Option<&[u32]>,
    actions: &Bound<'_, PyAny>,
    single: bool,
) -> PyResult<()> {
    let code = Code::InvalidAction;
    with_numbers(actions, "action", code, |shape, values| {
        let rows = env_ids.map_or(session.envs(), <[u32]>::len);
        let expected = [rows, session.spec().action_dim()];
        // One environment may have the axis or not, whatever its space says.
        if rows != 1 || shape != &expected[1..] {
            let shown = if single && shape != expected { &expected[1..] } else { &expected };
            check_shape(actions, shape, shown, "action", code)?;
        }
        session.start_step(env_ids, values).map_err(|error| error::call(actions.py(), error))
    })
}

/// The reply to a reset or a step. Row r belongs to environment `env_ids()[r]`; the arrays that
/// `copy=False` gives lie in shared memory and keep the reply there.
#[pyclass(frozen, module = "trocar._trocar")]
pub(crate) struct Reply {
    /// The lock is never held for long: it only lets threads share the reply.
    reply: Mutex<trocar_client::Reply>,
}

impl Reply {
    fn new(reply: trocar_client::Reply) -> Self {
        Self { reply: Mutex::new(reply) }
    }

    pub(crate) fn inner(&self) -> MutexGuard<'_, trocar_client::Reply> {
        // It is only read, so a panic cannot have left it half changed.
        self.reply.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Observation, rewards, terminations, truncations, infos, whether an episode began somewhere.
type Transition<'py> = (
    Bound<'py, PyAny>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyDict>,
    bool,
);

#[pymethods]
impl Reply {
    #[getter]
    fn rows(&self) -> usize {
        self.inner().rows()
    }

    /// Whether the task has goals; without them, arrays of goals have no columns.
    #[getter]
    fn has_goals(&self) -> bool {
        self.inner().spec().goal.is_some()
    }

    /// Whether the state is wanted, which it is unless only pictures are.
    #[getter]
    fn has_state(&self) -> bool {
        self.inner().spec().images.as_ref().is_none_or(|images| images.with_state)
    }

    fn env_ids<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let reply = self.inner();
        PyArray1::from_iter(py, (0..reply.rows()).map(|row| i64::from(reply.env_id(row))))
    }

    /// The column of that name: a fresh array, or with `copy` false a view where rows have several numbers.
    #[pyo3(signature = (name, copy=true))]
    fn array<'py>(slf: &Bound<'py, Self>, name: &str, copy: bool) -> PyResult<Bound<'py, PyAny>> {
        columns::array(slf, name, copy)
    }

    /// What infos tell of every row, by key; with `expert` also what the scripted expert would do.
    fn infos<'py>(slf: &Bound<'py, Self>, expert: bool) -> PyResult<Bound<'py, PyDict>> {
        let infos = PyDict::new(slf.py());
        columns::infos(slf, expert, |key, _, array| infos.set_item(key, array))?;
        Ok(infos)
    }

    /// Pictures by name, `rgb` or `rgb_left` and so on: arrays of shape (rows, …).
    #[pyo3(signature = (copy=true))]
    fn images<'py>(slf: &Bound<'py, Self>, copy: bool) -> PyResult<Bound<'py, PyDict>> {
        use trocar_client::Reply as R;
        images(slf, [R::depth, R::points], R::rgb, R::mask, copy)
    }

    /// As `images`, of episodes that a same-step autoreset replaced.
    #[pyo3(signature = (copy=true))]
    fn final_images<'py>(slf: &Bound<'py, Self>, copy: bool) -> PyResult<Bound<'py, PyDict>> {
        use trocar_client::Reply as R;
        images(slf, [R::final_depth, R::final_points], R::final_rgb, R::final_mask, copy)
    }

    /// What Gymnasium's vector environments return of a step, and whether somewhere an episode began.
    fn transition<'py>(
        slf: &Bound<'py, Self>,
        expert: bool,
        copy: bool,
    ) -> PyResult<Transition<'py>> {
        let (py, reply) = (slf.py(), slf.get());
        let (has_goals, images) = (reply.has_goals(), reply.inner().spec().images.clone());
        let array = |name| columns::array(slf, name, copy);
        let observation = if has_goals || images.is_some() {
            let state = match &images {
                Some(_) => Self::images(slf, copy)?,
                None => PyDict::new(py),
            };
            if images.is_none_or(|images| images.with_state) {
                state.set_item(intern!(py, "observation"), array("observation")?)?;
            }
            if has_goals {
                state.set_item(intern!(py, "achieved_goal"), array("achieved_goal")?)?;
                state.set_item(intern!(py, "desired_goal"), array("desired_goal")?)?;
            }
            state.into_any()
        } else {
            array("observation")?
        };
        let (infos, rows) = (PyDict::new(py), reply.rows());
        columns::infos(slf, expert, |key, mask, array| {
            infos.set_item(key, array)?;
            infos.set_item(mask, PyArray1::from_iter(py, repeat_n(true, rows)))
        })?;
        let inner = reply.inner();
        let begun = inner.steps().contains(&0);
        let [terminated, truncated] =
            [inner.terminated(), inner.truncated()].map(|bytes| flags(py, bytes));
        let reward = PyArray1::from_slice(py, inner.reward());
        Ok((observation, reward, terminated, truncated, infos, begun))
    }

    /// Reward, terminated, truncated and infos of row 0, without arrays but the expert's action.
    fn outcome<'py>(
        slf: &Bound<'py, Self>,
        expert: bool,
    ) -> PyResult<(f32, bool, bool, Bound<'py, PyDict>)> {
        let infos = columns::first_infos(slf, expert)?;
        let reply = slf.get().inner();
        let first = |bytes: &[u8]| bytes.first().is_some_and(|byte| *byte != 0);
        let reward = reply.reward().first().copied().unwrap_or_default();
        Ok((reward, first(reply.terminated()), first(reply.truncated()), infos))
    }
}

/// All pictures of a reply by name.
fn images<'py>(
    reply: &Bound<'py, Reply>,
    [depth, points]: [Part<f32>; 2],
    rgb: Part<u8>,
    mask: Part<i32>,
    copy: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(reply.py());
    let Some(spec) = reply.get().inner().spec().images.clone() else { return Ok(dict) };
    let (height, width, views) = (spec.height, spec.width, spec.views.len());
    for kind in &spec.kinds {
        for (index, suffix) in spec.views.iter().enumerate() {
            let array = match kind {
                ImageKind::Rgb => {
                    pictures(reply, rgb, &[height, width, 3], views, index, copy)?.into_any()
                }
                ImageKind::Depth => {
                    pictures(reply, depth, &[height, width, 1], views, index, copy)?.into_any()
                }
                ImageKind::Mask => {
                    pictures(reply, mask, &[height, width], views, index, copy)?.into_any()
                }
                ImageKind::Points => {
                    pictures(reply, points, &[height * width, 3], views, index, copy)?.into_any()
                }
            };
            dict.set_item(format!("{}{suffix}", kind.name()), array)?;
        }
    }
    Ok(dict)
}
