//! One heap for all threads.
//!
//! The allocator of the C library gives each thread a cache, which is never given back, and groups of threads a heap of
//! their own. A daemon has a thread for each gauge, which allocates little and seldom: what was free in those caches and
//! heaps took as much memory as what was in use. Here no thread has anything of its own.

#![allow(unsafe_code, reason = "an allocator cannot be written without; it only passes on to two others")]

use std::alloc::{GlobalAlloc, Layout, System};

use dlmalloc::GlobalDlmalloc;

/// From this size on the C library maps an allocation by itself: it is zero without being touched, and is given back
/// at once.
const LARGE: usize = 128 * 1024;

/// Small allocations come from one heap, large ones from the C library.
pub(crate) struct Heap;

// SAFETY: the size of an allocation alone decides which allocator it belongs to.
unsafe impl GlobalAlloc for Heap {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's.
        unsafe {
            match layout.size() < LARGE {
                true => GlobalDlmalloc.alloc(layout),
                false => System.alloc(layout),
            }
        }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's.
        unsafe {
            match layout.size() < LARGE {
                true => GlobalDlmalloc.alloc_zeroed(layout),
                false => System.alloc_zeroed(layout),
            }
        }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's; the allocator that it came from.
        unsafe {
            match layout.size() < LARGE {
                true => GlobalDlmalloc.dealloc(pointer, layout),
                false => System.dealloc(pointer, layout),
            }
        }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller's; an allocation that changes sides is copied.
        unsafe {
            match (layout.size() < LARGE, size < LARGE) {
                (true, true) => GlobalDlmalloc.realloc(pointer, layout, size),
                (false, false) => System.realloc(pointer, layout, size),
                _ => {
                    let new = self.alloc(Layout::from_size_align_unchecked(size, layout.align()));
                    if !new.is_null() {
                        new.copy_from_nonoverlapping(pointer, layout.size().min(size));
                        self.dealloc(pointer, layout);
                    }
                    new
                }
            }
        }
    }
}
