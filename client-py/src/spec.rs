//! What a task looks like, its options and its goal functions.

use std::collections::BTreeMap;

use numpy::ndarray::ArrayD;
use numpy::{Element as Number, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyString};
use trocar_client::proto::control::{MAX_MESSAGE, decode, encode};
use trocar_client::proto::goal::{self, Reward, SuccessRule};
use trocar_client::proto::relative::{Bound as Limit, Place, Rule};
use trocar_client::proto::spec::{self, PRESET};
use trocar_client::{Code, OptionValue, Rejection};

use crate::array::{check_shape, described, plain, with_numbers, wrong_shape};
use crate::error;

/// A task as its clients see it, under one choice of options.
#[pyclass(frozen, module = "trocar._trocar")]
#[derive(Clone)]
pub(crate) struct TaskSpec {
    spec: trocar_client::TaskSpec,
}

impl TaskSpec {
    pub(crate) fn new(spec: trocar_client::TaskSpec) -> Self {
        Self { spec }
    }

    pub(crate) fn inner(&self) -> &trocar_client::TaskSpec {
        &self.spec
    }
}

#[pymethods]
impl TaskSpec {
    /// The specification that `__reduce__` wrote.
    #[new]
    fn from_bytes(py: Python<'_>, encoded: &[u8]) -> PyResult<Self> {
        decode(encoded).map(Self::new).map_err(|refusal| error::rejection(py, &refusal))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let py = slf.py();
        let mut buffer = vec![0; MAX_MESSAGE];
        let length = encode(&slf.get().spec, &mut buffer)
            .map_err(|refusal| error::rejection(py, &refusal))?;
        let arguments = (PyBytes::new(py, &buffer[..length]),);
        Ok((slf.get_type(), arguments).into_pyobject(py)?.into_any())
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| other.get().spec == self.spec)
    }

    #[getter]
    fn id(&self) -> &str {
        &self.spec.id
    }

    #[getter]
    fn summary(&self) -> &str {
        &self.spec.summary
    }

    #[getter]
    fn max_steps(&self) -> u32 {
        self.spec.max_steps
    }

    #[getter]
    fn has_tissue(&self) -> bool {
        self.spec.has_tissue
    }

    #[getter]
    fn seconds_per_step(&self) -> f64 {
        self.spec.seconds_per_step
    }

    #[getter]
    fn action(&self) -> Vec<Element> {
        elements(&self.spec.action)
    }

    #[getter]
    fn observation(&self) -> Vec<Element> {
        elements(&self.spec.observation)
    }

    /// `None` for tasks without goals.
    #[getter]
    fn goal(&self) -> Option<Vec<Element>> {
        self.spec.goal.as_ref().map(|goal| elements(&goal.elements))
    }

    /// None where the goal is one whole, or where there is none.
    #[getter]
    fn goal_parts(&self) -> Vec<GoalPart> {
        let mut success = self.spec.goal.as_ref().map(|goal| &goal.success);
        while let Some(SuccessRule::Scaled { rule, .. }) = success {
            success = Some(rule);
        }
        let Some(SuccessRule::Parts(parts)) = success else { return vec![] };
        parts.iter().cloned().map(GoalPart::from).collect()
    }

    #[getter]
    fn relative(&self) -> Vec<Element> {
        elements(&self.spec.relative.elements())
    }

    #[getter]
    fn relative_program<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        self.spec.relative.features.iter().map(|feature| rule(py, &feature.rule)).collect()
    }

    #[getter]
    fn has_goals(&self) -> bool {
        self.spec.goal.is_some()
    }

    /// The pictures of an observation; `None` where they are not asked for.
    #[getter]
    fn images(&self) -> Option<ImageSpec> {
        self.spec.images.clone().map(|images| ImageSpec {
            kinds: images.kinds.iter().map(|kind| kind.name()).collect(),
            reach: images.reach(),
            views: images.views,
            height: images.height,
            width: images.width,
            intrinsics: images.intrinsics,
            camera_from_world: images.camera_from_world,
            far: images.far,
            bodies: images.bodies,
            with_state: images.with_state,
        })
    }

    /// `sparse`, `dense`, or `state` where it is no function of goals.
    #[getter]
    fn reward(&self) -> &'static str {
        match self.spec.reward {
            Reward::Sparse => "sparse",
            Reward::Dense => "dense",
            Reward::State => "state",
        }
    }

    #[getter]
    fn options(&self, py: Python<'_>) -> PyResult<Vec<OptionSpec>> {
        let option = |option: &spec::OptionSpec| {
            Ok(OptionSpec {
                name: option.name.clone(),
                summary: option.summary.clone(),
                default: to_python(py, &option.default)?,
                allowed: option.allowed.to_string(),
            })
        };
        self.spec.options.iter().map(option).collect()
    }

    /// Rewards of goals of shape (..., goal dim), as the server gives them: float32 (...).
    fn compute_reward<'py>(
        &self,
        achieved: &Bound<'py, PyAny>,
        desired: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let reward = self.spec.reward;
        if reward == Reward::State {
            return Err(self.without_goals(achieved.py()));
        }
        self.of_goals(achieved, desired, |rule, a, d| reward.of(rule, a, d))
    }

    /// Whether goals of shape (..., goal dim) are reached: bool (...).
    fn compute_success<'py>(
        &self,
        achieved: &Bound<'py, PyAny>,
        desired: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        self.of_goals(achieved, desired, SuccessRule::holds)
    }

    /// The features of states (..., state dim) and goals (..., goal dim): float32 (..., features).
    fn features<'py>(
        &self,
        observation: &Bound<'py, PyAny>,
        achieved: &Bound<'py, PyAny>,
        desired: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let py = observation.py();
        let relative = &self.spec.relative;
        if relative.features.is_empty() {
            let allowed = "this task has no relative features, or its observation is scaled";
            let refusal = Rejection::new(Code::Unsupported, "task", &self.spec.id, allowed);
            return Err(error::rejection(py, &refusal));
        }
        let [state, goal] = relative.dims;
        let code = Code::InvalidOption;
        with_numbers(observation, "observation", code, |shape, states| {
            let Some((_, leading)) = shape.split_last().filter(|(last, _)| **last == state) else {
                let expected = format!("(..., {state}), the state alone");
                return Err(wrong_shape(observation, &expected, "observation", code));
            };
            let goals = [leading, &[goal]].concat();
            with_numbers(achieved, "achieved", code, |other, from| {
                check_shape(achieved, other, &goals, "achieved", code)?;
                with_numbers(desired, "desired", code, |other, to| {
                    check_shape(desired, other, &goals, "desired", code)?;
                    let features = self.spec.features(states, from, to);
                    let shape = [leading, &[relative.dim()]].concat();
                    let features = ArrayD::from_shape_vec(shape, features)
                        .map_err(|error| error::new(py, "Internal", error.to_string()))?;
                    Ok(PyArrayDyn::from_owned_array(py, features))
                })
            })
        })
    }

    fn __repr__(&self) -> String {
        format!("<trocar task {}>", self.spec.id)
    }
}

/// How a feature is computed, as words and numbers.
fn rule<'py>(py: Python<'py>, rule: &Rule) -> PyResult<Bound<'py, PyDict>> {
    let told = PyDict::new(py);
    match *rule {
        Rule::Offset { to, from, count, scale, bound } => {
            let bound = match bound {
                Limit::Clip => "clip",
                Limit::Tanh => "tanh",
            };
            told.set_item("kind", "offset")?;
            told.set_item("to", place(py, to)?)?;
            told.set_item("from", place(py, from)?)?;
            told.set_item("count", count)?;
            told.set_item("scale", scale)?;
            told.set_item("bound", bound)?;
        }
        Rule::Rotation { of, seen_from } => {
            told.set_item("kind", "rotation")?;
            told.set_item("of", of)?;
            told.set_item("seen_from", seen_from)?;
        }
        Rule::Line { of, direction, seen_from } => {
            told.set_item("kind", "line")?;
            told.set_item("of", of)?;
            told.set_item("direction", direction)?;
            told.set_item("seen_from", seen_from)?;
        }
    }
    Ok(told)
}

/// A place of one, in the same way.
fn place(py: Python<'_>, place: Place) -> PyResult<Bound<'_, PyDict>> {
    let told = PyDict::new(py);
    match place {
        Place::At(at) => told.set_item("at", at)?,
        Place::Fixed(numbers) => told.set_item("fixed", numbers)?,
        Place::On { at, angles, offset } => {
            told.set_item("at", at)?;
            told.set_item("angles", angles)?;
            told.set_item("offset", offset)?;
        }
    }
    Ok(told)
}

impl TaskSpec {
    fn of_goals<'py, T: Number>(
        &self,
        achieved: &Bound<'py, PyAny>,
        desired: &Bound<'py, PyAny>,
        of_pair: impl Fn(&SuccessRule, &[f32], &[f32]) -> T,
    ) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
        let py = achieved.py();
        let Some(goal) = &self.spec.goal else { return Err(self.without_goals(py)) };
        let (dim, code) = (goal.elements.len(), Code::InvalidOption);
        with_numbers(achieved, "achieved_goal", code, |shape, from| {
            let Some((_, leading)) = shape.split_last().filter(|(last, _)| **last == dim) else {
                let expected = format!("(..., {dim})");
                return Err(wrong_shape(achieved, &expected, "achieved_goal", code));
            };
            with_numbers(desired, "desired_goal", code, |other, to| {
                check_shape(desired, other, shape, "desired_goal", code)?;
                let pairs = from.chunks_exact(dim).zip(to.chunks_exact(dim));
                let results = pairs.map(|(a, d)| of_pair(&goal.success, a, d)).collect();
                let results = ArrayD::from_shape_vec(leading, results)
                    .map_err(|error| error::new(py, "Internal", error.to_string()))?;
                Ok(PyArrayDyn::from_owned_array(py, results))
            })
        })
    }

    fn without_goals(&self, py: Python<'_>) -> PyErr {
        let allowed = "only the server knows its reward, which is no function of goals";
        error::rejection(py, &Rejection::new(Code::Unsupported, "task", &self.spec.id, allowed))
    }
}

/// The pictures of an observation.
#[pyclass(frozen, get_all, module = "trocar._trocar")]
pub(crate) struct ImageSpec {
    kinds: Vec<&'static str>,
    views: Vec<String>,
    height: usize,
    width: usize,
    intrinsics: [f64; 4],
    camera_from_world: Vec<[[f64; 4]; 3]>,
    far: f32,
    reach: [f32; 2],
    bodies: Vec<String>,
    with_state: bool,
}

#[pymethods]
impl ImageSpec {
    fn __repr__(&self) -> String {
        let Self { kinds, height, width, .. } = self;
        format!("<{kinds:?} of {height} by {width} pixels>")
    }
}

/// One element of a vector: what it means, where, in which unit and range.
#[pyclass(frozen, get_all, eq, module = "trocar._trocar")]
#[derive(Clone, PartialEq)]
pub(crate) struct Element {
    name: String,
    frame: String,
    unit: String,
    min: f32,
    max: f32,
    saturates: bool,
}

#[pymethods]
impl Element {
    fn __repr__(&self) -> String {
        let Self { name, frame, unit, min, max, .. } = self;
        format!("<{name} in [{min}, {max}] {unit}, frame {frame:?}>")
    }
}

fn elements(elements: &[spec::Element]) -> Vec<Element> {
    let copy = |element: &spec::Element| {
        let spec::Element { name, frame, unit, min, max, saturates } = element.clone();
        Element { name, frame, unit, min, max, saturates }
    };
    elements.iter().map(copy).collect()
}

/// Some numbers of a goal that belong together.
#[pyclass(frozen, get_all, eq, module = "trocar._trocar")]
#[derive(Clone, PartialEq)]
pub(crate) struct GoalPart {
    name: String,
    start: usize,
    count: usize,
    tolerance: f32,
    unit: f32,
}

impl From<goal::GoalPart> for GoalPart {
    fn from(part: goal::GoalPart) -> Self {
        let goal::GoalPart { name, start, count, tolerance, unit } = part;
        Self { name, start, count, tolerance, unit }
    }
}

#[pymethods]
impl GoalPart {
    fn __repr__(&self) -> String {
        let Self { name, start, count, tolerance, .. } = self;
        format!("<goal part {name}: {start} to {}, within {tolerance}>", start + count)
    }
}

/// One option of a task: its name, its default and what is allowed.
#[pyclass(frozen, get_all, module = "trocar._trocar")]
pub(crate) struct OptionSpec {
    name: String,
    summary: String,
    default: Py<PyAny>,
    allowed: String,
}

#[pymethods]
impl OptionSpec {
    fn __repr__(&self) -> String {
        format!("<option {}: {}>", self.name, self.allowed)
    }
}

fn to_python(py: Python<'_>, value: &OptionValue) -> PyResult<Py<PyAny>> {
    Ok(match value {
        OptionValue::Flag(flag) => PyBool::new(py, *flag).to_owned().into_any().unbind(),
        OptionValue::Number(number) => number.into_pyobject(py)?.into_any().unbind(),
        OptionValue::Text(text) => text.into_pyobject(py)?.into_any().unbind(),
        OptionValue::Numbers(numbers) => numbers.into_pyobject(py)?.into_any().unbind(),
        OptionValue::Texts(texts) => texts.into_pyobject(py)?.into_any().unbind(),
        OptionValue::Table(table) => table.into_pyobject(py)?.into_any().unbind(),
        OptionValue::Preset(preset, table) => {
            let table = table.into_pyobject(py)?;
            table.set_item(PRESET, preset)?;
            table.into_any().unbind()
        }
    })
}

/// The value of an option, by its type; the server checks the rest.
pub(crate) fn option_value(value: &Bound<'_, PyAny>, field: &str) -> PyResult<OptionValue> {
    let value = plain(value, field)?;
    converted(&value).ok_or_else(|| {
        let allowed = "a bool, a number, a string, a sequence of numbers or of strings, or a dict \
                       of numbers or sequences of numbers by name";
        match described(&value) {
            Ok(found) => {
                let refusal = Rejection::new(Code::InvalidOption, field, found, allowed);
                error::rejection(value.py(), &refusal)
            }
            Err(error) => error,
        }
    })
}

fn converted(value: &Bound<'_, PyAny>) -> Option<OptionValue> {
    if let Ok(flag) = value.extract::<bool>() {
        return Some(OptionValue::Flag(flag));
    }
    if value.is_instance_of::<PyString>() {
        return value.extract().ok().map(OptionValue::Text);
    }
    if let Ok(table) = value.cast::<PyDict>() {
        let row = |(name, row): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
            let numbers = row.extract().or_else(|_| row.extract().map(|number| vec![number]));
            Some((name.extract().ok()?, numbers.ok()?))
        };
        let preset = table.get_item(PRESET).ok()?;
        let rows = table
            .iter()
            .filter(|(name, _)| !(preset.is_some() && name.eq(PRESET).is_ok_and(|is| is)));
        let rows: BTreeMap<String, Vec<f64>> = rows.map(row).collect::<Option<_>>()?;
        return Some(match preset {
            Some(preset) => OptionValue::Preset(preset.extract().ok()?, rows),
            None => OptionValue::Table(rows),
        });
    }
    if value.len().is_ok() {
        let numbers = value.extract().map(OptionValue::Numbers);
        return numbers.or_else(|_| value.extract().map(OptionValue::Texts)).ok();
    }
    value.extract().map(OptionValue::Number).ok()
}
