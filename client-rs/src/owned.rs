//! Values that a forked child must not drop.
//!
//! Objects of the transport are of that kind: dropped by a child, they would remove shared memory
//! that the parent still uses.

use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};

use crate::error::CallError;

/// A value that only the process that made it may drop.
#[derive(Debug)]
pub(crate) struct Owned<T> {
    value: ManuallyDrop<T>,
    process: u32,
}

impl<T> Owned<T> {
    pub(crate) fn new(value: T) -> Self {
        Self { value: ManuallyDrop::new(value), process: std::process::id() }
    }

    /// The value, unless this is a forked child of the process that made it.
    pub(crate) fn get(&self) -> Result<&T, CallError> {
        self.check()?;
        Ok(&self.value)
    }

    /// As [`Self::get`].
    pub(crate) fn get_mut(&mut self) -> Result<&mut T, CallError> {
        self.check()?;
        Ok(&mut self.value)
    }

    fn check(&self) -> Result<(), CallError> {
        if self.process == std::process::id() {
            Ok(())
        } else {
            Err(CallError::Forked { owner: self.process })
        }
    }
}

impl<T> Deref for Owned<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for Owned<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T> Drop for Owned<T> {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        if self.process == std::process::id() {
            // SAFETY: the value is dropped here only, and not touched afterwards.
            unsafe { ManuallyDrop::drop(&mut self.value) }
        }
    }
}
