//! Errors as the exceptions of `trocar.errors`, whose names are those of the Rust client.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use trocar_client::{CallError, Code, ConnectError, Rejection};

/// An exception of the class `trocar.errors.<class>`.
pub(crate) fn new(py: Python<'_>, class: &str, message: impl Into<String>) -> PyErr {
    let message = message.into();
    match instance(py, class, &message) {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => {
            let wrapped = PyRuntimeError::new_err(message);
            wrapped.set_cause(py, Some(error));
            wrapped
        }
    }
}

/// The exception of a failed connection.
pub(crate) fn connect(py: Python<'_>, error: ConnectError) -> PyErr {
    let class = match error {
        ConnectError::Refused(refusal) => return rejection(py, &refusal),
        ConnectError::NoServer { .. } => "NoServer",
        ConnectError::Timeout { .. } => "ConnectTimeout",
        ConnectError::Launch { .. } => "LaunchError",
        ConnectError::Transport(_) => "TransportError",
    };
    new(py, class, error.to_string())
}

/// The exception of a failed request.
pub(crate) fn call(py: Python<'_>, error: CallError) -> PyErr {
    let class = match error {
        CallError::Refused(refusal) => return rejection(py, &refusal),
        CallError::ServerLost { .. } => "ServerLost",
        CallError::Timeout { .. } => "CallTimeout",
        CallError::Forked { .. } => "ForkedError",
        CallError::NothingInFlight => "NothingInFlight",
        CallError::TooManyInFlight => "TooManyInFlight",
        CallError::TooManyHeld => "TooManyHeld",
        CallError::Malformed(_) => "Malformed",
        CallError::Transport(_) => "TransportError",
    };
    new(py, class, error.to_string())
}

/// The exception of a refusal, which also carries `field`, `value` and `allowed`.
pub(crate) fn rejection(py: Python<'_>, refusal: &Rejection) -> PyErr {
    // What the request has as its view is an argument of another name in Python.
    if let Some(name) = refusal.field.strip_prefix("view.") {
        let field = format!("render_options.{name}");
        return rejection(py, &Rejection { field, ..refusal.clone() });
    }
    let mut message = refusal.to_string();
    // What libraries look for that try a keyword and go on without it.
    if refusal.code == Code::UnknownOption
        && let Some(name) = refusal.field.strip_prefix("options.")
    {
        message = format!("unexpected keyword argument '{name}': {message}");
    }
    let exception = match instance(py, class_of(refusal.code), &message) {
        Ok(exception) => exception,
        Err(error) => return error,
    };
    let parts =
        [("field", &refusal.field), ("value", &refusal.value), ("allowed", &refusal.allowed)];
    for (name, part) in parts {
        if let Err(error) = exception.setattr(name, part) {
            return error;
        }
    }
    PyErr::from_value(exception)
}

/// The name of the exception class of a refusal.
pub(crate) fn class_of(code: Code) -> &'static str {
    match code {
        Code::UnknownTask => "UnknownTask",
        Code::UnknownOption => "UnknownOption",
        Code::InvalidOption => "InvalidOption",
        Code::InvalidEnvCount => "InvalidEnvCount",
        Code::MemoryBudget => "MemoryBudget",
        Code::VersionMismatch => "VersionMismatch",
        Code::StaleSession => "StaleSession",
        Code::UnknownSession => "UnknownSession",
        Code::Malformed => "Malformed",
        Code::TooManySessions => "TooManySessions",
        Code::ShuttingDown => "ShuttingDown",
        Code::ResetNeeded => "ResetNeeded",
        Code::InvalidAction => "InvalidAction",
        Code::InvalidEnvIds => "InvalidEnvIds",
        Code::Unsupported => "Unsupported",
        Code::Simulation => "SimulationError",
        Code::Internal => "Internal",
        Code::UnknownSnapshot => "UnknownSnapshot",
        Code::InvalidSnapshot => "InvalidSnapshot",
        Code::UnknownArm => "UnknownArm",
        Code::InvalidCommand => "InvalidCommand",
        Code::ArmIsDriven => "ArmIsDriven",
    }
}

fn instance<'py>(py: Python<'py>, class: &str, message: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("trocar.errors")?.getattr(class)?.call1((message,))
}
