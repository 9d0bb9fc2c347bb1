//! One environment without a server, for programs that load C libraries: what
//! `client-py/benches/async_vector_env.py` gives to Gymnasium's worker processes.
//!
//! An environment is used by one thread at a time. Arrays are float32 of the specification's sizes,
//! which [`trocar_dims`] tells; `outcome` is reward, terminated, truncated, success.

#![allow(unsafe_code)]

use std::ffi::{CStr, c_char};
use std::slice::{from_raw_parts, from_raw_parts_mut};

use trocar_server::tasks::Registry;
use trocar_server::{Env, Step};

/// Where what is seen goes: observation, achieved goal, desired goal.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Seen {
    observation: *mut f32,
    achieved: *mut f32,
    desired: *mut f32,
}

impl Seen {
    /// The arrays of an environment like `env`.
    ///
    /// # Safety
    /// They have its sizes, and nobody else uses them meanwhile.
    unsafe fn arrays<'a>(self, env: &Env) -> [&'a mut [f32]; 3] {
        let (observation, goal) = (env.spec().observation_dim(), env.spec().goal_dim());
        // SAFETY: the caller's promise.
        unsafe {
            [
                from_raw_parts_mut(self.observation, observation),
                from_raw_parts_mut(self.achieved, goal),
                from_raw_parts_mut(self.desired, goal),
            ]
        }
    }
}

/// An environment of a task with its default options; null where there is no such task.
///
/// # Safety
/// `task` is a text that ends with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_make(task: *const c_char) -> *mut Env {
    // SAFETY: the caller's promise.
    let task = unsafe { CStr::from_ptr(task) }.to_str().unwrap_or_default();
    let made = Registry::builtin().make(task, &trocar_proto::Options::new());
    made.map_or(std::ptr::null_mut(), |env| Box::into_raw(Box::new(env)))
}

/// Ends an environment.
///
/// # Safety
/// `env` comes from [`trocar_make`] and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_free(env: *mut Env) {
    // SAFETY: the caller's promise.
    drop(unsafe { Box::from_raw(env) });
}

/// Sizes of actions, observations and goals.
///
/// # Safety
/// `env` comes from [`trocar_make`], `dims` has room for three numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_dims(env: *const Env, dims: *mut [u32; 3]) {
    // SAFETY: the caller's promise.
    let (spec, dims) = unsafe { ((*env).spec(), &mut *dims) };
    *dims = [spec.action_dim(), spec.observation_dim(), spec.goal_dim()].map(|dim| dim as u32);
}

/// Begins an episode: the first of `seed`, or the next where `seed` is negative.
///
/// # Safety
/// `env` comes from [`trocar_make`]; `seen` has its sizes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_reset(env: *mut Env, seed: i64, seen: Seen) {
    // SAFETY: the caller's promise.
    let env = unsafe { &mut *env };
    env.reset(u64::try_from(seed).ok());
    // SAFETY: the caller's promise.
    let [observation, achieved, desired] = unsafe { seen.arrays(env) };
    env.observe(observation, achieved, desired);
}

/// Lets one step pass; false where the action is refused or the simulation fails.
///
/// # Safety
/// `env` comes from [`trocar_make`]; `action` and `seen` have its sizes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_step(
    env: *mut Env,
    action: *const f32,
    seen: Seen,
    outcome: *mut [f32; 4],
) -> bool {
    // SAFETY: the caller's promise.
    let (env, outcome) = unsafe { (&mut *env, &mut *outcome) };
    // SAFETY: the caller's promise.
    let action = unsafe { from_raw_parts(action, env.spec().action_dim()) };
    // SAFETY: the caller's promise.
    let [observation, achieved, desired] = unsafe { seen.arrays(env) };
    let Ok(step) = env.step_into(action, observation, achieved, desired) else { return false };
    let Step { reward, terminated, truncated, is_success } = step;
    *outcome = [reward, terminated.into(), truncated.into(), is_success.into()];
    true
}
