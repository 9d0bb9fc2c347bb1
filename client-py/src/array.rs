//! Arrays in both directions: replies as NumPy arrays, what Python sends as plain numbers.

use numpy::ndarray::{ArrayView, ArrayView2, ArrayViewD, Axis, Dimension};
use numpy::{
    Element, PyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;
use trocar_client::{Code, Rejection};

use crate::error;
use crate::session::Reply;

/// Finds a region of a reply, so that what is viewed can lie nowhere else.
pub(crate) type Part<T> = fn(&trocar_client::Reply) -> &[T];

/// A (rows, width) array: a fresh one that Python owns, or with `copy` false a read-only one that
/// lies in shared memory and keeps the reply there.
pub(crate) fn matrix<'py, T: Element>(
    reply: &Bound<'py, Reply>,
    part: Part<T>,
    width: usize,
    copy: bool,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let inner = reply.get().inner();
    let rows = ArrayView2::from_shape((inner.rows(), width), part(&inner))
        .map_err(|error| error::new(reply.py(), "Malformed", error.to_string()))?;
    if copy { Ok(PyArray2::from_array(reply.py(), &rows)) } else { view(&rows, reply) }
}

/// The pictures of one view: a (rows, …) array of those that lie (rows, views, …), as [`matrix`].
pub(crate) fn pictures<'py, T: Element>(
    reply: &Bound<'py, Reply>,
    part: Part<T>,
    shape: &[usize],
    views: usize,
    index: usize,
    copy: bool,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let inner = reply.get().inner();
    let shape = [&[inner.rows(), views], shape].concat();
    let all = ArrayViewD::from_shape(shape, part(&inner))
        .map_err(|error| error::new(reply.py(), "Malformed", error.to_string()))?;
    let rows = all.index_axis(Axis(1), index);
    if copy { Ok(PyArrayDyn::from_array(reply.py(), &rows)) } else { view(&rows, reply) }
}

#[allow(unsafe_code)]
fn view<'py, T: Element, D: Dimension>(
    rows: &ArrayView<'_, T, D>,
    owner: &Bound<'py, Reply>,
) -> PyResult<Bound<'py, PyArray<T, D>>> {
    // SAFETY: `rows` lies in the shared memory of `owner`'s reply, which stays mapped at the same
    // place until `owner` is dropped; the new array's base keeps `owner` alive.
    let view = unsafe { PyArray::borrow_from_array(rows, owner.clone().into_any()) };
    view.try_readwrite()?.make_nonwriteable();
    Ok(view)
}

/// A fresh array of one truth value per row.
pub(crate) fn flags<'py>(py: Python<'py>, bytes: &[u8]) -> Bound<'py, PyArray1<bool>> {
    PyArray1::from_iter(py, bytes.iter().map(|byte| *byte != 0))
}

/// Numbers that came from Python, row-major.
pub(crate) struct Numbers {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f32>,
}

/// Reads anything that NumPy takes for an array of numbers; `field` and `code` name it in errors.
pub(crate) fn numbers(value: &Bound<'_, PyAny>, field: &str, code: Code) -> PyResult<Numbers> {
    let py = value.py();
    if let Ok(array) = value.cast::<PyArrayDyn<f32>>() {
        return Ok(collect(&array.try_readonly()?, |number| number));
    }
    let as_array = || -> PyResult<PyReadonlyArrayDyn<'_, f64>> {
        let keywords = [("dtype", "float64")].into_py_dict(py)?;
        let array = py.import("numpy")?.call_method("asarray", (value,), Some(&keywords))?;
        Ok(array.cast::<PyArrayDyn<f64>>()?.try_readonly()?)
    };
    as_array().map(|array| collect(&array, |number| number as f32)).map_err(|error| {
        let found = value.repr().map_or_else(|_| "?".to_string(), |text| text.to_string());
        let refusal = error::rejection(
            py,
            &Rejection::new(code, field, found, "expected an array of numbers"),
        );
        refusal.set_cause(py, Some(error));
        refusal
    })
}

/// As [`numbers`], and `act` gets shape and values: of an array of float32 in row-major order the
/// array's own, without a copy.
pub(crate) fn with_numbers<T>(
    value: &Bound<'_, PyAny>,
    field: &str,
    code: Code,
    act: impl FnOnce(&[usize], &[f32]) -> PyResult<T>,
) -> PyResult<T> {
    if let Ok(array) = value.cast::<PyArrayDyn<f32>>()
        && array.is_c_contiguous()
    {
        let array = array.try_readonly()?;
        return act(array.shape(), array.as_slice()?);
    }
    let numbers = numbers(value, field, code)?;
    act(&numbers.shape, &numbers.values)
}

fn collect<T: Element + Copy>(
    array: &PyReadonlyArrayDyn<'_, T>,
    convert: impl Fn(T) -> f32,
) -> Numbers {
    let values = array.as_array().iter().map(|number| convert(*number)).collect();
    Numbers { shape: array.shape().to_vec(), values }
}

/// A shape as Python writes it.
pub(crate) fn shape_text(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        several => {
            let parts: Vec<_> = several.iter().map(ToString::to_string).collect();
            format!("({})", parts.join(", "))
        }
    }
}

/// An error unless `found` is `expected`.
pub(crate) fn check_shape(
    py: Python<'_>,
    found: &[usize],
    expected: &[usize],
    field: &str,
    code: Code,
) -> PyResult<()> {
    if found == expected {
        return Ok(());
    }
    let found = format!("array of shape {}", shape_text(found));
    let expected = format!("expected shape {}", shape_text(expected));
    Err(error::rejection(py, &Rejection::new(code, field, found, expected)))
}
