//! Exit codes: what scripts can tell apart.

use std::error::Error;
use std::io;
use std::process::ExitCode;

use trocar_client::{CallError, Code, ConnectError, Rejection};
use trocar_server::service::ServeError;

const FAILURE: u8 = 1;
const USAGE: u8 = 2;
const NO_SERVER: u8 = 3;
const IN_USE: u8 = 4;

/// An error with an exit code of its own.
#[derive(Debug)]
pub(crate) enum Exit {
    /// The command line asks for something that does not exist or is not allowed.
    Usage(String),
    /// No server runs.
    NoServer(String),
    /// A process uses what should be removed.
    InUse(String),
}

impl std::fmt::Display for Exit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (Self::Usage(text) | Self::NoServer(text) | Self::InUse(text)) = self;
        f.write_str(text)
    }
}

impl Error for Exit {}

/// Says on stderr what went wrong, if anything did, and gives the exit code.
pub(crate) fn report(done: anyhow::Result<()>) -> ExitCode {
    let Err(error) = done else { return ExitCode::SUCCESS };
    if is_broken_pipe(&error) {
        // The reader of our output (`head`, say) has seen enough.
        return ExitCode::SUCCESS;
    }
    eprintln!("error: {error:#}");
    ExitCode::from(code_of(&error))
}

fn code_of(error: &anyhow::Error) -> u8 {
    error.chain().find_map(code_of_cause).unwrap_or(FAILURE)
}

fn code_of_cause(cause: &(dyn Error + 'static)) -> Option<u8> {
    if let Some(exit) = cause.downcast_ref() {
        return Some(match exit {
            Exit::Usage(_) => USAGE,
            Exit::NoServer(_) => NO_SERVER,
            Exit::InUse(_) => IN_USE,
        });
    }
    if let Some(error) = cause.downcast_ref() {
        return match error {
            ConnectError::NoServer { .. } => Some(NO_SERVER),
            ConnectError::Refused(refusal) => Some(code_of_refusal(refusal)),
            _ => None,
        };
    }
    if let Some(error) = cause.downcast_ref() {
        return match error {
            CallError::ServerLost { .. } => Some(NO_SERVER),
            CallError::Refused(refusal) => Some(code_of_refusal(refusal)),
            _ => None,
        };
    }
    if let Some(error) = cause.downcast_ref() {
        return match error {
            ServeError::NameInUse { .. } => Some(IN_USE),
            ServeError::Refused(refusal) => Some(code_of_refusal(refusal)),
            _ => None,
        };
    }
    cause.downcast_ref().map(code_of_refusal)
}

fn code_of_refusal(refusal: &Rejection) -> u8 {
    match refusal.code {
        Code::UnknownTask | Code::UnknownOption | Code::InvalidOption | Code::InvalidEnvCount => {
            USAGE
        }
        _ => FAILURE,
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use anyhow::Context;

    use super::*;

    #[test]
    fn codes_are_found_behind_context() {
        let refusal = Rejection::new(Code::UnknownTask, "task", "x", "y");
        let wrapped = Err::<(), _>(CallError::from(refusal.clone())).context("while opening");
        assert_eq!(code_of(&wrapped.unwrap_err()), USAGE);
        assert_eq!(code_of(&refusal.into()), USAGE);
        let lost = CallError::ServerLost { name: "lab".into(), closed: true };
        assert_eq!(code_of(&lost.into()), NO_SERVER);
        let taken = ServeError::NameInUse { name: "lab".into(), pid: 1 };
        assert_eq!(code_of(&taken.into()), IN_USE);
        assert_eq!(code_of(&anyhow::anyhow!("anything else")), FAILURE);
    }
}
