//! The columns of a reply as NumPy arrays, and as Gymnasium's infos.

use numpy::PyArray1;
use pyo3::exceptions::PyKeyError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use trocar_client::proto::columns::Width;

use crate::array::{flags, matrix};
use crate::session::Reply;

/// A column as an array: (rows) of Python's own kinds of numbers, or (rows, width).
macro_rules! array {
    ($reply:ident, $copy:expr, $name:ident Flag One) => {
        flags($reply.py(), $reply.get().inner().$name()).into_any()
    };
    // Seeds fit Gymnasium's signed integers.
    ($reply:ident, $copy:expr, $name:ident u64 One) => {{
        let inner = $reply.get().inner();
        PyArray1::from_iter($reply.py(), inner.$name().iter().map(|number| *number as i64))
            .into_any()
    }};
    ($reply:ident, $copy:expr, $name:ident f32 Tissue) => {
        array!($reply, $copy, $name f32 One)
    };
    ($reply:ident, $copy:expr, $name:ident $element:ident One) => {
        PyArray1::from_slice($reply.py(), $reply.get().inner().$name()).into_any()
    };
    ($reply:ident, $copy:expr, $name:ident $element:ident $width:ident) => {{
        let width = Width::$width.of($reply.get().inner().spec());
        matrix($reply, trocar_client::Reply::$name, width, $copy)?.into_any()
    }};
}

/// Row 0 of a column: a number, or an array of them.
macro_rules! first {
    ($reply:ident, $name:ident Flag One) => {
        $reply.get().inner().$name().first().is_some_and(|byte| *byte != 0)
    };
    ($reply:ident, $name:ident f32 Tissue) => {
        first!($reply, $name f32 One)
    };
    ($reply:ident, $name:ident $element:ident One) => {
        $reply.get().inner().$name().first().copied().unwrap_or_default()
    };
    ($reply:ident, $name:ident $element:ident $width:ident) => {
        array!($reply, true, $name $element $width).get_item(0)?
    };
}

/// Tells the macro `$then` of a column that infos have: its key, then what comes after the role.
macro_rules! if_told {
    ({expert $key:ident}, [$expert:ident, $tissue:ident], $then:ident!($($column:tt)*)) => {
        if $expert {
            $then!($key, $($column)*);
        }
    };
    ({tissue $key:ident}, [$expert:ident, $tissue:ident], $then:ident!($($column:tt)*)) => {
        if $tissue {
            $then!($key, $($column)*);
        }
    };
    ({$role:ident $key:ident}, $wanted:tt, $then:ident!($($column:tt)*)) => {
        $then!($key, $($column)*)
    };
    ({$($role:ident)?}, $wanted:tt, $then:ident!($($column:tt)*)) => {};
}

/// A column as an array of infos: numbers are Python's own, as Gymnasium makes arrays of single environments' infos.
macro_rules! info_array {
    ($reply:ident, $name:ident f32 One) => {{
        let inner = $reply.get().inner();
        PyArray1::from_iter($reply.py(), inner.$name().iter().copied().map(f64::from)).into_any()
    }};
    ($reply:ident, $name:ident f32 Tissue) => {
        info_array!($reply, $name f32 One)
    };
    ($reply:ident, $($column:ident)*) => {
        array!($reply, true, $($column)*)
    };
}

/// The kind of numbers that [`info_array`] gives, as NumPy names it.
macro_rules! dtype {
    (Flag One) => {
        "bool"
    };
    (u64 One) => {
        "int64"
    };
    (f32 One) => {
        "float64"
    };
    (f32 Tissue) => {
        "float64"
    };
    (f32 $width:ident) => {
        "float32"
    };
    (u8 One) => {
        "uint8"
    };
    ($element:ident $width:ident) => {
        concat!(stringify!($element), " is told in no info")
    };
}

/// What there is to know of a column that infos have.
macro_rules! info {
    ({$role:ident $key:ident} $name:ident $element:ident $width:ident) => {
        Some((stringify!($role), stringify!($key), stringify!($name), dtype!($element $width)))
    };
    ({$($role:ident)?} $name:ident $element:ident $width:ident) => {
        None
    };
}

/// Of a column that infos have: its role, its key, its name, the kind of its numbers.
pub(crate) type Info = (&'static str, &'static str, &'static str, &'static str);

macro_rules! tell_all {
    ($key:ident, $reply:ident, $tell:ident, $($column:ident)*) => {{
        let key = intern!($reply.py(), stringify!($key));
        let mask = intern!($reply.py(), concat!("_", stringify!($key)));
        $tell(key, mask, info_array!($reply, $($column)*))?;
    }};
}

macro_rules! tell_first {
    ($key:ident, $reply:ident, $infos:ident, $($column:ident)*) => {
        $infos.set_item(intern!($reply.py(), stringify!($key)), first!($reply, $($column)*))?
    };
}

macro_rules! columns {
    ($($(#[$doc:meta])* $name:ident: $element:ident [$width:ident] $role:tt;)*) => {
        /// The column of that name; where its rows have several numbers, `copy` decides as in [`matrix`].
        pub(crate) fn array<'py>(
            reply: &Bound<'py, Reply>,
            name: &str,
            copy: bool,
        ) -> PyResult<Bound<'py, PyAny>> {
            match name {
                $(stringify!($name) => Ok(array!(reply, copy, $name $element $width)),)*
                _ => Err(PyKeyError::new_err(name.to_string())),
            }
        }

        /// The columns that infos have, in their order.
        pub(crate) fn all_infos() -> Vec<Info> {
            [$(info!($role $name $element $width)),*].into_iter().flatten().collect()
        }

        /// Tells the columns that infos have: key, key of the mask, array. With `expert`, also the expert's.
        pub(crate) fn infos<'py>(
            reply: &Bound<'py, Reply>,
            expert: bool,
            mut tell: impl FnMut(&Bound<'py, PyString>, &Bound<'py, PyString>, Bound<'py, PyAny>) -> PyResult<()>,
        ) -> PyResult<()> {
            let tissue = reply.get().inner().spec().has_tissue;
            $(if_told!($role, [expert, tissue], tell_all!(reply, tell, $name $element $width));)*
            Ok(())
        }

        /// The same of row 0, as plain numbers.
        pub(crate) fn first_infos<'py>(
            reply: &Bound<'py, Reply>,
            expert: bool,
        ) -> PyResult<Bound<'py, PyDict>> {
            let infos = PyDict::new(reply.py());
            let tissue = reply.get().inner().spec().has_tissue;
            $(if_told!($role, [expert, tissue], tell_first!(reply, infos, $name $element $width));)*
            Ok(infos)
        }
    };
}

trocar_client::proto::reply_columns!(columns);
