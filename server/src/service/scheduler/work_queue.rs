//! Work that is cut into chunks, which threads take until none is left.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// How many long pieces are looked for in work that has some.
const MOST_LONG: usize = 16;

/// Work that can be cut in two anywhere.
pub(crate) trait Splittable: Send + Sized {
    /// How many pieces there are.
    fn len(&self) -> usize;
    /// The first `at` pieces, and the rest.
    fn split_at(self, at: usize) -> (Self, Self);
    /// The first piece that may take much longer than most, where that is known.
    fn first_long(&self) -> Option<usize> {
        None
    }
    /// Does the work.
    fn run(self);
}

/// Work from which threads take chunk by chunk. What a piece takes varies a lot, so only the clock tells when a
/// quantum is over: the work stays here until a thread takes it.
pub(super) struct WorkQueue<W> {
    left: Mutex<Left<W>>,
    /// How many pieces are taken at once, at most.
    chunk: usize,
}

/// What no thread has taken yet.
struct Left<W> {
    /// Single pieces that may take long: a thread that began one last would let all others wait.
    long: Vec<W>,
    /// The pieces that are cut into chunks.
    rest: Option<W>,
    /// What comes after them.
    parts: Vec<W>,
    /// How many pieces all of these have.
    len: usize,
    /// How many threads take from it.
    threads: usize,
}

impl<W: Splittable> WorkQueue<W> {
    /// All of `work`, of which at most `chunk` pieces are taken at once.
    pub(super) fn new(work: W, chunk: usize) -> Self {
        Self { left: Mutex::new(Left::new(work)), chunk }
    }

    /// How many pieces no thread has taken yet.
    pub(super) fn len(&self) -> usize {
        self.lock().len
    }

    /// Says how many threads will take from it.
    pub(super) fn expect(&self, threads: usize) {
        self.lock().threads = threads;
    }

    /// The next chunk, if there is one. The lock is not held while it is worked on.
    pub(super) fn take(&self) -> Option<W> {
        self.lock().take(self.chunk)
    }

    fn lock(&self) -> MutexGuard<'_, Left<W>> {
        // What is left is consistent after every statement, panic or not.
        self.left.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<W: Splittable> Left<W> {
    fn new(work: W) -> Self {
        let len = work.len();
        let (mut long, mut parts, mut rest) = (vec![], vec![], work);
        while long.len() < MOST_LONG
            && let Some(at) = rest.first_long()
        {
            let (before, behind) = rest.split_at(at);
            let (piece, behind) = behind.split_at(1);
            parts.push(before);
            long.push(piece);
            rest = behind;
        }
        Self { long, rest: Some(rest), parts, len, threads: 1 }
    }

    /// The next chunk of at most `most` pieces, if there is one: long pieces first, then less and less where there are
    /// several threads. So all end at about the same time (guided self-scheduling, Polychronopoulos and Kuck 1987).
    fn take(&mut self, most: usize) -> Option<W> {
        let work = loop {
            match self.long.pop().or_else(|| self.rest.take()).or_else(|| self.parts.pop())? {
                nothing if nothing.len() == 0 => {}
                work => break work,
            }
        };
        let fair = if self.threads > 1 { self.len / (2 * self.threads) } else { self.len };
        let chunk = most.min(fair).clamp(1, work.len());
        self.len -= chunk;
        if chunk == work.len() {
            return Some(work);
        }
        let (now, later) = work.split_at(chunk);
        self.rest = Some(later);
        Some(now)
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use super::*;

    /// Pieces by their numbers, of which multiples of 3 are long where that is known.
    struct Numbers {
        range: Range<usize>,
        timed: bool,
    }

    impl Splittable for Numbers {
        fn len(&self) -> usize {
            self.range.len()
        }

        fn split_at(self, at: usize) -> (Self, Self) {
            let Self { range, timed } = self;
            let border = range.start + at;
            (Self { range: range.start..border, timed }, Self { range: border..range.end, timed })
        }

        fn first_long(&self) -> Option<usize> {
            self.range.clone().position(|number| self.timed && number.is_multiple_of(3))
        }

        fn run(self) {}
    }

    #[test]
    fn long_pieces_are_begun_first_and_chunks_get_smaller() {
        let taken = |count: usize, threads: usize| {
            let mut left = Left::new(Numbers { range: 0..count, timed: threads > 1 });
            left.threads = threads;
            let chunks: Vec<_> = std::iter::from_fn(|| left.take(5))
                .map(|chunk| chunk.range.collect::<Vec<_>>())
                .collect();
            assert_eq!(left.len, 0);
            let mut all = chunks.concat();
            all.sort_unstable();
            assert_eq!(all, (0..count).collect::<Vec<_>>(), "each once");
            chunks
        };
        assert_eq!(taken(8, 1), [vec![0, 1, 2, 3, 4], vec![5, 6, 7]]);
        let chunks = taken(8, 2);
        assert_eq!(chunks[..3], [vec![6], vec![3], vec![0]]);
        assert!(chunks[3..].iter().all(|chunk| chunk.len() == 1));
        // Of more than are looked for, the rest is as all others.
        let chunks = taken(100, 2);
        assert_eq!(chunks[0], [3 * (MOST_LONG - 1)]);
        let sizes: Vec<_> = chunks[MOST_LONG..].iter().map(Vec::len).collect();
        assert!(sizes[0] == 5 && sizes.last() == Some(&1), "{sizes:?}");
        assert_eq!(taken(0, 2), Vec::<Vec<usize>>::new());
    }
}
