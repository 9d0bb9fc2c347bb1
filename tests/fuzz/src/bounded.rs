//! Memory that gives no large piece: no input here is worth one.

use std::alloc::{GlobalAlloc, Layout, System};

/// The largest piece, bytes: more than any environment of these targets takes.
const LARGEST: usize = 256 << 20;

/// The system's allocator, up to that.
struct Bounded;

#[global_allocator]
static ALLOCATOR: Bounded = Bounded;

#[allow(unsafe_code)]
// SAFETY: every call goes to the system's allocator as it came, or fails as an allocation may.
unsafe impl GlobalAlloc for Bounded {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if layout.size() > LARGEST {
            return std::ptr::null_mut();
        }
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if layout.size() > LARGEST {
            return std::ptr::null_mut();
        }
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if size > LARGEST {
            return std::ptr::null_mut();
        }
        // SAFETY: as above.
        unsafe { System.realloc(place, layout, size) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(place, layout) }
    }
}
