//! A live world: commands to its arms, ticks, and what can be read.

use std::sync::{Mutex, MutexGuard, TryLockError};

use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use trocar_client::proto::dvrk::record::Question;
use trocar_client::proto::dvrk::{ArmRecord, Command, Report};
use trocar_client::{Code, Rejection};

use crate::snapshot::Snapshot;
use crate::spec::TaskSpec;
use crate::{error, wait};

/// A joint state: positions, velocities, stamp in s.
type Joints<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, f64);

/// An event: arm, stamp in s, topic, value.
type Told = (String, f64, &'static str, Py<PyAny>);

/// A world in the server whose arms this process commands, until it is closed.
#[pyclass(frozen, weakref, module = "trocar._trocar")]
pub(crate) struct LiveWorld {
    /// `None` once closed. Never waited for: a second thread gets an error.
    open: Mutex<Option<trocar_client::LiveWorld>>,
    spec: Py<TaskSpec>,
    id: u64,
    arms: Vec<String>,
}

#[pymethods]
impl LiveWorld {
    #[getter]
    fn id(&self) -> u64 {
        self.id
    }

    #[getter]
    fn spec(&self, py: Python<'_>) -> Py<TaskSpec> {
        self.spec.clone_ref(py)
    }

    #[getter]
    fn arms(&self) -> Vec<String> {
        self.arms.clone()
    }

    #[getter]
    fn objects(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        self.with(py, |world| Ok(world.live().objects.clone()))
    }

    #[getter]
    fn speed(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        self.with(py, |world| Ok(world.live().speed))
    }

    /// Names of an arm's joints, whether it has a jaw, and where its remote centre is in the world.
    fn describe(&self, py: Python<'_>, arm: &str) -> PyResult<(Vec<String>, bool, [f64; 7])> {
        self.with(py, |world| {
            let place = world.live().arm(arm).map_err(|refusal| error::rejection(py, &refusal))?;
            let info = &world.live().arms[place as usize];
            Ok((info.joints.clone(), info.has_jaw, info.world_from_base))
        })
    }

    /// Gives a command to an arm with the next [`Self::advance`].
    #[pyo3(signature = (arm, topic, numbers=vec![], more=vec![], text=""))]
    #[expect(clippy::needless_pass_by_value, reason = "as they come from Python")]
    fn command(
        &self,
        py: Python<'_>,
        arm: &str,
        topic: &str,
        numbers: Vec<f64>,
        more: Vec<f64>,
        text: &str,
    ) -> PyResult<()> {
        let command = Command::of(topic, &numbers, &more, text)
            .map_err(|refusal| error::rejection(py, &refusal))?;
        self.with(py, |world| {
            py.detach(|| world.command(arm, &command)).map_err(|error| error::call(py, error))
        })
    }

    /// Gives the commands, and lets so many ticks pass; how many did.
    #[pyo3(signature = (ticks, until_event=false))]
    fn advance(&self, py: Python<'_>, ticks: u32, until_event: bool) -> PyResult<u32> {
        self.with(py, |world| {
            let started = py.detach(|| world.start(ticks, until_event));
            started.map_err(|error| error::call(py, error))?;
            loop {
                let polled = py.detach(|| world.poll(wait::SLICE));
                match polled.map_err(|error| error::call(py, error))? {
                    Some(passed) => return Ok(passed),
                    None => py.check_signals()?,
                }
            }
        })
    }

    /// The events that arms have told since the last call, oldest first.
    fn events(&self, py: Python<'_>) -> PyResult<Vec<Told>> {
        self.with(py, |world| {
            let mut told = vec![];
            while let Some(event) = world.next_event() {
                let arm = self.arms.get(event.arm as usize).cloned().unwrap_or_default();
                let topic = event.report.topic();
                let value = match event.report {
                    Report::OperatingState(is) => {
                        (is.state.name(), is.is_homed, is.is_busy).into_pyobject(py)?.into_any()
                    }
                    Report::GoalReached(is) => is.into_pyobject(py)?.to_owned().into_any(),
                    Report::Ratio(ratio) | Report::RatioV(ratio) | Report::RatioA(ratio) => {
                        ratio.into_pyobject(py)?.into_any()
                    }
                    Report::ToolType(text)
                    | Report::EndoscopeType(text)
                    | Report::Warning(text)
                    | Report::Error(text) => text.into_pyobject(py)?.into_any(),
                };
                told.push((arm, event.stamp as f64 * 1e-9, topic, value.unbind()));
            }
            Ok(told)
        })
    }

    /// An arm's operating state: its name, whether it is homed, whether it is busy.
    fn operating_state(&self, py: Python<'_>, arm: &str) -> PyResult<(&'static str, bool, bool)> {
        self.arm(py, arm, |arm| {
            let is = arm.operating_state();
            Ok((is.state.name(), is.is_homed, is.is_busy))
        })
    }

    /// `measured_js`, or the set-point's: of the joints, or of the jaw. Without a tool, all are joints.
    #[pyo3(signature = (arm, *, setpoint=false, jaw=false))]
    fn joints<'py>(
        &self,
        py: Python<'py>,
        arm: &str,
        setpoint: bool,
        jaw: bool,
    ) -> PyResult<Joints<'py>> {
        self.with(py, |world| {
            let refused = |refusal: Rejection| error::rejection(py, &refusal);
            let place = world.live().arm(arm).map_err(refused)? as usize;
            let info = &world.live().arms[place];
            let record = world.arm(arm).map_err(|error| error::call(py, error))?;
            let (position, velocity) = if setpoint {
                (&record.setpoint_position, &record.setpoint_velocity)
            } else {
                (&record.measured_position, &record.measured_velocity)
            };
            let joints = match record.has_tool {
                0 => info.raw_joints.len(),
                _ => info.joints.len(),
            };
            let has_jaw = info.has_jaw && record.has_tool != 0;
            let range = match jaw {
                false => 0..joints,
                true if has_jaw => joints..joints + 1,
                true => 0..0,
            };
            let array = |numbers: &[f64]| PyArray1::from_slice(py, &numbers[range.clone()]);
            Ok((array(position), array(velocity), record.stamp as f64 * 1e-9))
        })
    }

    /// A pose as x, y, z, then x, y, z, w of a quaternion, and its stamp in s, which is 0 without a tool: `measured_cp`,
    /// `setpoint_cp`, `local/measured_cp` or `local/setpoint_cp`.
    fn pose(&self, py: Python<'_>, arm: &str, topic: &str) -> PyResult<([f64; 7], f64)> {
        self.arm(py, arm, |arm| {
            let pose = match topic {
                "measured_cp" => arm.measured_cp,
                "setpoint_cp" => arm.setpoint_cp,
                "local/measured_cp" => arm.local_measured_cp,
                "local/setpoint_cp" => arm.local_setpoint_cp,
                _ => {
                    let allowed = "measured_cp, setpoint_cp, and both below local/";
                    let refusal = Rejection::new(Code::InvalidOption, "topic", topic, allowed);
                    return Err(error::rejection(py, &refusal));
                }
            };
            Ok((pose, valid_stamp(arm)))
        })
    }

    /// `measured_cv`: m/s and rad/s, and its stamp in s, which is 0 without a tool.
    fn twist(&self, py: Python<'_>, arm: &str) -> PyResult<([f64; 6], f64)> {
        self.arm(py, arm, |arm| Ok((arm.measured_cv, valid_stamp(arm))))
    }

    /// The ratio of moves, the process that drives the arm (0 if none does), the name of its reference frame.
    fn status(&self, py: Python<'_>, arm: &str) -> PyResult<(f64, u32, String)> {
        self.arm(py, arm, |arm| Ok((arm.ratio, arm.driver, arm.reference_frame.read())))
    }

    /// Asks about an arm's kinematics: numbers and an empty text, or none and why.
    #[pyo3(signature = (arm, question, numbers=vec![], more=vec![]))]
    #[expect(clippy::needless_pass_by_value, reason = "as they come from Python")]
    fn ask(
        &self,
        py: Python<'_>,
        arm: &str,
        question: &str,
        numbers: Vec<f64>,
        more: Vec<f64>,
    ) -> PyResult<(Vec<f64>, String)> {
        let question = match question {
            "forward_kinematics" => Question::ForwardKinematics,
            "local/forward_kinematics" => Question::LocalForwardKinematics,
            "inverse_kinematics" => Question::InverseKinematics,
            "actuator_to_joint_position" => Question::ActuatorToJointPosition,
            "body/jacobian" => Question::BodyJacobian,
            "spatial/jacobian" => Question::SpatialJacobian,
            "task/set_point" => Question::TaskSetPoint,
            "task/action" => Question::TaskAction,
            _ => {
                let allowed = "a service of the arm, body/jacobian or spatial/jacobian";
                let refusal = Rejection::new(Code::InvalidOption, "question", question, allowed);
                return Err(error::rejection(py, &refusal));
            }
        };
        self.with(py, |world| {
            let answer = py.detach(|| world.ask(arm, question, [&numbers, &more]));
            Ok(match answer.map_err(|error| error::call(py, error))? {
                Ok(numbers) => (numbers, String::new()),
                Err(why) => (vec![], why),
            })
        })
    }

    /// Ticks, steps, reward, success, and whether the state is terminal.
    #[getter]
    fn world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.with(py, |world| {
            let (seen, told) = (world.world(), PyDict::new(py));
            told.set_item("ticks", seen.ticks)?;
            told.set_item("steps", seen.steps)?;
            told.set_item("reward", seen.reward)?;
            told.set_item("is_success", seen.is_success != 0)?;
            told.set_item("terminated", seen.terminated != 0)?;
            told.set_item("late", seen.late)?;
            told.set_item("lost_events", seen.lost_events)?;
            Ok(told)
        })
    }

    /// Ticks that have passed since the world began.
    #[getter]
    fn ticks(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |world| Ok(world.world().ticks))
    }

    /// Observation, achieved and desired goal.
    #[expect(clippy::type_complexity, reason = "three arrays")]
    fn observation<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>)>
    {
        self.with(py, |world| {
            let array = |numbers: &[f32]| PyArray1::from_slice(py, numbers);
            let goals = [world.achieved_goal(), world.desired_goal()].map(array);
            let [achieved, desired] = goals;
            Ok((array(world.observation()), achieved, desired))
        })
    }

    /// Where an object is in the world: x, y, z, then x, y, z, w of a quaternion.
    fn object(&self, py: Python<'_>, name: &str) -> PyResult<[f64; 7]> {
        self.with(py, |world| world.object(name).copied().map_err(|error| error::call(py, error)))
    }

    /// Keeps the state of the world in the server.
    fn snapshot(&self, py: Python<'_>) -> PyResult<Snapshot> {
        self.with(py, |world| {
            let kept = py.detach(|| world.snapshot());
            Ok(Snapshot::new(kept.map_err(|error| error::call(py, error))?))
        })
    }

    /// Brings the world back to a state that was kept.
    fn restore(&self, py: Python<'_>, snapshot: &Snapshot) -> PyResult<()> {
        self.with(py, |world| {
            let restored = py.detach(|| world.restore(snapshot.inner()));
            restored.map_err(|error| error::call(py, error))
        })
    }

    /// Begins the first episode of a seed.
    fn reset(&self, py: Python<'_>, seed: u64) -> PyResult<()> {
        self.with(py, |world| {
            let begun = py.detach(|| world.reset(seed));
            begun.map_err(|error| error::call(py, error))
        })
    }

    /// What led to the present state, as bytes of a recording.
    fn recording<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.with(py, |world| {
            let recording = py.detach(|| world.recording());
            Ok(PyBytes::new(py, &recording.map_err(|error| error::call(py, error))?))
        })
    }

    /// Draws the world: uint8 (H, W, 3), or with `depth` float32 (H, W) in m.
    #[pyo3(signature = (depth=false))]
    fn render<'py>(&self, py: Python<'py>, depth: bool) -> PyResult<Bound<'py, PyAny>> {
        self.with(py, |world| {
            let failed = |failure| error::call(py, failure);
            let view = world.info().view.clone();
            let [height, width] =
                view.map_or([0; 2], |view| [view.views.len() * view.height, view.width]);
            if depth {
                let pixels = py.detach(|| world.render_depth()).map_err(failed)?;
                let array = PyArray1::from_vec(py, pixels).reshape([height, width])?;
                return Ok(array.into_any());
            }
            let pixels = py.detach(|| world.render()).map_err(failed)?;
            Ok(PyArray1::from_vec(py, pixels).reshape([height, width, 3])?.into_any())
        })
    }

    /// Ends the session; once is enough, more does no harm.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let world = self.lock(py)?.take();
        if let Some(world) = world {
            py.detach(|| wait::farewell(world));
        }
        Ok(())
    }

    #[getter]
    fn closed(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.lock(py)?.is_none())
    }

    fn __repr__(&self) -> String {
        format!("<trocar live world of session {}: {}>", self.id, self.arms.join(", "))
    }
}

/// The stamp of what is Cartesian, s.
fn valid_stamp(arm: &ArmRecord) -> f64 {
    if arm.has_tool == 0 { 0.0 } else { arm.stamp as f64 * 1e-9 }
}

impl LiveWorld {
    pub(crate) fn new(py: Python<'_>, world: trocar_client::LiveWorld) -> PyResult<Self> {
        let spec = Py::new(py, TaskSpec::new(world.spec().clone()))?;
        let arms = world.live().arms.iter().map(|arm| arm.name.clone()).collect();
        let id = world.info().session;
        Ok(Self { open: Mutex::new(Some(world)), spec, id, arms })
    }

    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Option<trocar_client::LiveWorld>>> {
        match self.open.try_lock() {
            Ok(guard) => Ok(guard),
            // Whatever panicked left a world whose next call reports what is wrong with it.
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => {
                Err(error::new(py, "Busy", "another thread waits for this world"))
            }
        }
    }

    fn with<T>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut trocar_client::LiveWorld) -> PyResult<T>,
    ) -> PyResult<T> {
        match self.lock(py)?.as_mut() {
            Some(world) => act(world),
            None => Err(error::new(py, "Closed", "the live world was closed")),
        }
    }

    fn arm<T>(
        &self,
        py: Python<'_>,
        name: &str,
        read: impl FnOnce(&ArmRecord) -> PyResult<T>,
    ) -> PyResult<T> {
        self.with(py, |world| read(world.arm(name).map_err(|error| error::call(py, error))?))
    }
}

impl Drop for LiveWorld {
    fn drop(&mut self) {
        let world = self.open.get_mut().map_or_else(|e| e.into_inner().take(), Option::take);
        if let Some(world) = world {
            // While the interpreter shuts down there is no other thread to let run meanwhile.
            let mut world = Some(world);
            Python::try_attach(|py| {
                let world = world.take();
                py.detach(|| world.map(wait::farewell));
            });
        }
    }
}
