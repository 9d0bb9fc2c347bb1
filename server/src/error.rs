//! Why an environment could not be stepped.

use trocar_proto::Rejection;

/// Why a step did not happen.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StepError {
    /// The environment has no episode: it was never reset, or its episode ended.
    #[error("the environment needs a reset before it can be stepped")]
    ResetNeeded,
    /// The action has the wrong length or an element that is no finite number. Nothing changed.
    #[error("invalid action: {0}")]
    InvalidAction(#[from] Rejection),
    /// The state of the simulation is no longer finite. This environment needs a reset.
    #[error("the simulation of this environment failed: {what} is not finite after step {step}")]
    Simulation {
        /// What was found.
        what: &'static str,
        /// Steps since the episode began.
        step: u32,
    },
}
