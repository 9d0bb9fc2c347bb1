//! Words in shared memory: a file that each process maps when it opens it.

use std::fmt;
use std::fs::{self, OpenOptions};
use std::io;
use std::ops::Deref;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::ptr::{self, NonNull};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::retry_on_intr;
use rustix::mm::{MapFlags, ProtFlags};

/// What may lie in memory that others write to at any time.
///
/// # Safety
/// It consists of atomics only, of which every value is valid, all bits 0 is how it begins, and it needs no
/// more than a page's alignment.
#[allow(unsafe_code)]
pub(crate) unsafe trait SharedLayout: fmt::Debug + Send + Sync + 'static {}

/// Words as they lie in shared memory. The process that made them removes them.
pub(crate) struct Shm<L: SharedLayout> {
    words: NonNull<L>,
    /// Where they are to be removed.
    made: Option<PathBuf>,
}

#[allow(unsafe_code)]
// SAFETY: all that can be reached are atomics; the mapping belongs to no thread.
unsafe impl<L: SharedLayout> Send for Shm<L> {}
#[allow(unsafe_code)]
// SAFETY: as above.
unsafe impl<L: SharedLayout> Sync for Shm<L> {}

impl<L: SharedLayout> Shm<L> {
    /// Makes them at `path`, where nothing may be yet. They are removed when this is dropped.
    pub(crate) fn make(path: PathBuf) -> io::Result<Self> {
        let file =
            OpenOptions::new().read(true).write(true).create_new(true).mode(0o600).open(&path)?;
        // Memory that is only promised would end the process when it is first written to.
        let allocate = || fallocate(&file, FallocateFlags::empty(), 0, Self::BYTES as u64);
        let mapped =
            retry_on_intr(allocate).map_err(io::Error::from).and_then(|()| Self::map(&file));
        match mapped {
            Ok(mut mapping) => {
                mapping.made = Some(path);
                Ok(mapping)
            }
            Err(error) => {
                fs::remove_file(path).ok();
                Err(error)
            }
        }
    }

    /// Opens those at `path`.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        if file.metadata()?.len() < Self::BYTES as u64 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        Self::map(&file)
    }

    const BYTES: usize = size_of::<L>();

    #[allow(unsafe_code)]
    fn map(file: &fs::File) -> io::Result<Self> {
        const { assert!(align_of::<L>() <= 4096) };
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: the kernel chooses the place, so nothing that is there is replaced.
        let place = unsafe {
            rustix::mm::mmap(ptr::null_mut(), Self::BYTES, protection, MapFlags::SHARED, file, 0)
        }?;
        let words = NonNull::new(place.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Self { words, made: None })
    }
}

impl<L: SharedLayout> Deref for Shm<L> {
    type Target = L;

    #[allow(unsafe_code)]
    fn deref(&self) -> &L {
        // SAFETY: the mapping is as long as the words, aligned to a page, and stays until this is
        // dropped; what lies there may be written to by others, as `SharedLayout` promises.
        unsafe { self.words.as_ref() }
    }
}

impl<L: SharedLayout> fmt::Debug for Shm<L> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Shm").field("words", &**self).field("made", &self.made).finish()
    }
}

impl<L: SharedLayout> Drop for Shm<L> {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        if let Some(path) = &self.made {
            // What cannot be removed now goes with all else of this endpoint.
            fs::remove_file(path).ok();
        }
        // SAFETY: it was mapped by `map`, as long as that, and nothing refers to it any more.
        unsafe { rustix::mm::munmap(self.words.as_ptr().cast(), Self::BYTES) }.ok();
    }
}
