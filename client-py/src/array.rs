//! Arrays in both directions: replies as NumPy arrays, what Python sends as plain numbers.

use numpy::ndarray::{ArrayView, ArrayView2, ArrayViewD, Axis, Dimension};
use numpy::{
    Element, PyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::intern;
use pyo3::prelude::*;
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
pub(crate) fn pictures<'py, T: Element + Copy>(
    reply: &Bound<'py, Reply>,
    part: Part<T>,
    shape: &[usize],
    views: usize,
    index: usize,
    copy: bool,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let inner = reply.get().inner();
    let all = ArrayViewD::from_shape([&[inner.rows(), views], shape].concat(), part(&inner))
        .map_err(|error| error::new(reply.py(), "Malformed", error.to_string()))?;
    let rows = all.index_axis(Axis(1), index);
    if !copy {
        return view(&rows, reply);
    }
    let copied = PyArrayDyn::zeros(reply.py(), rows.raw_dim(), false);
    let size = shape.iter().product::<usize>().max(1);
    // One copy per picture: NumPy's own copy of an array with gaps moves single elements.
    let pictures = part(&inner).chunks_exact(size).skip(index).step_by(views);
    for (target, picture) in
        copied.try_readwrite()?.as_slice_mut()?.chunks_exact_mut(size).zip(pictures)
    {
        target.copy_from_slice(picture);
    }
    Ok(copied)
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

/// Reads anything that NumPy takes for an array of numbers, by the rule of `trocar._arrays`, and gives
/// `act` its shape and values, row-major; `field` and `code` name it in errors. Aligned arrays in
/// row-major order are read here: of float32 without a copy, of float64 rounded.
pub(crate) fn with_numbers<T>(
    value: &Bound<'_, PyAny>,
    field: &str,
    code: Code,
    act: impl FnOnce(&[usize], &[f32]) -> PyResult<T>,
) -> PyResult<T> {
    if let Some(array) = in_order::<f32>(value)? {
        return act(array.shape(), array.as_slice()?);
    }
    if let Some(array) = in_order::<f64>(value)? {
        let rounded: Vec<_> = array.as_slice()?.iter().map(|number| *number as f32).collect();
        return act(array.shape(), &rounded);
    }
    let py = value.py();
    let copied = rule(py, "floats")?.call1((value, field, error::class_of(code)))?;
    let array = copied.cast::<PyArrayDyn<f32>>()?.try_readonly()?;
    act(array.shape(), array.as_slice()?)
}

/// A value that is an aligned array of that type in row-major order.
fn in_order<'py, T: Element>(
    value: &Bound<'py, PyAny>,
) -> PyResult<Option<PyReadonlyArrayDyn<'py, T>>> {
    // Subclasses may mean something else by their elements, as masked arrays do.
    if !value.is_exact_instance_of::<PyUntypedArray>() {
        return Ok(None);
    }
    let Ok(array) = value.cast::<PyArrayDyn<T>>() else { return Ok(None) };
    if array.is_c_contiguous() && array.is_aligned() {
        return Ok(Some(array.try_readonly()?));
    }
    Ok(None)
}

/// The elements of an array of the bindings' own, which are aligned and contiguous.
pub(crate) fn listed<T: Element + Copy>(array: &Bound<'_, PyArray1<T>>) -> PyResult<Vec<T>> {
    Ok(array.try_readonly()?.as_slice()?.to_vec())
}

/// An array, tensor or scalar as Python's own numbers or strings; anything else as it is.
pub(crate) fn plain<'py>(value: &Bound<'py, PyAny>, field: &str) -> PyResult<Bound<'py, PyAny>> {
    if !value.hasattr(intern!(value.py(), "dtype"))? {
        return Ok(value.clone());
    }
    rule(value.py(), "plain")?.call1((value, field))
}

/// A value as refusals quote it.
pub(crate) fn described(value: &Bound<'_, PyAny>) -> PyResult<String> {
    rule(value.py(), "described")?.call1((value,))?.extract()
}

fn rule<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("trocar._arrays")?.getattr(name)
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

/// An error unless the shape of `value` is `expected`.
pub(crate) fn check_shape(
    value: &Bound<'_, PyAny>,
    shape: &[usize],
    expected: &[usize],
    field: &str,
    code: Code,
) -> PyResult<()> {
    if shape == expected {
        return Ok(());
    }
    Err(wrong_shape(value, &shape_text(expected), field, code))
}

/// The refusal of an array that has another shape than `expected`.
pub(crate) fn wrong_shape(
    value: &Bound<'_, PyAny>,
    expected: &str,
    field: &str,
    code: Code,
) -> PyErr {
    match described(value) {
        Ok(found) => {
            let expected = format!("expected shape {expected}");
            error::rejection(value.py(), &Rejection::new(code, field, found, expected))
        }
        Err(error) => error,
    }
}
