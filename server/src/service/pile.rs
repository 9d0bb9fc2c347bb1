//! Work that is cut into bites: what a turn's threads take from until it is done.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// How many long pieces are looked for in work that has some.
pub(super) const MOST_LONG: usize = 16;

/// Work that can be cut in two anywhere.
pub(crate) trait Divisible: Send + Sized {
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

/// Work from which threads take bite by bite. What a piece takes varies a lot, so only the clock tells when a
/// turn is over: the work stays here until a thread takes it. Of its long pieces, the first `LONG` are laid
/// aside to be taken first; room for none is worth having where there are none, since work is large.
pub(super) struct Pile<W, const LONG: usize> {
    rest: Mutex<Rest<W, LONG>>,
    /// How many pieces are taken at once, at most.
    bite: usize,
}

impl<W: Divisible, const LONG: usize> Pile<W, LONG> {
    /// A pile of `work`, from which at most `bite` pieces are taken at once.
    pub(super) fn new(work: W, bite: usize) -> Self {
        Self { rest: Mutex::new(Rest::new(work)), bite }
    }

    /// How many pieces no thread has taken yet.
    pub(super) fn len(&self) -> usize {
        self.lock().len
    }

    /// Says how many threads will take from it.
    pub(super) fn expect(&self, threads: usize) {
        self.lock().threads = threads;
    }

    /// The next bite, if there is one. The lock is not held while it is worked on.
    pub(super) fn take(&self) -> Option<W> {
        self.lock().take(self.bite)
    }

    fn lock(&self) -> MutexGuard<'_, Rest<W, LONG>> {
        // What is left is consistent after every statement, panic or not.
        self.rest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What no thread has taken yet.
struct Rest<W, const LONG: usize> {
    /// Pieces that may take long: a thread that began one last would let all others wait.
    long: [Option<W>; LONG],
    /// What lies before and between them.
    short: [Option<W>; LONG],
    /// What lies behind them.
    behind: Option<W>,
    /// How many pieces all of these have.
    len: usize,
    /// How many threads take from it.
    threads: usize,
}

impl<W: Divisible, const LONG: usize> Rest<W, LONG> {
    fn new(work: W) -> Self {
        let len = work.len();
        let (mut long, mut short) = ([const { None }; LONG], [const { None }; LONG]);
        let (mut behind, mut found) = (work, 0);
        while found < LONG
            && let Some(at) = behind.first_long()
        {
            let (before, rest) = behind.split_at(at);
            let (piece, rest) = rest.split_at(1);
            (short[found], long[found]) = (Some(before), Some(piece));
            (behind, found) = (rest, found + 1);
        }
        Self { long, short, behind: Some(behind), len, threads: 1 }
    }

    /// The next bite of at most `most` pieces, if there is one: less and less where there are several
    /// threads, so that all end at about the same time (guided self-scheduling, Polychronopoulos and
    /// Kuck 1987).
    fn take(&mut self, most: usize) -> Option<W> {
        if let Some(piece) = self.long.iter_mut().find_map(Option::take) {
            self.len -= 1;
            return Some(piece);
        }
        let fair = if self.threads > 1 { self.len / (2 * self.threads) } else { self.len };
        let mut parts = self.short.iter_mut().chain([&mut self.behind]);
        let part = parts.find(|part| part.as_ref().is_some_and(|work| work.len() > 0))?;
        let work = part.take()?;
        let bite = most.min(fair).clamp(1, work.len());
        let (now, left) = work.split_at(bite);
        *part = Some(left);
        self.len -= bite;
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

    impl Divisible for Numbers {
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
    fn long_pieces_are_begun_first_and_bites_get_smaller() {
        let taken = |count: usize, threads: usize| {
            let mut rest =
                Rest::<_, MOST_LONG>::new(Numbers { range: 0..count, timed: threads > 1 });
            rest.threads = threads;
            let bites: Vec<_> = std::iter::from_fn(|| rest.take(5))
                .map(|bite| bite.range.collect::<Vec<_>>())
                .collect();
            assert_eq!(rest.len, 0);
            let mut all = bites.concat();
            all.sort_unstable();
            assert_eq!(all, (0..count).collect::<Vec<_>>(), "each once");
            bites
        };
        assert_eq!(taken(8, 1), [vec![0, 1, 2, 3, 4], vec![5, 6, 7]]);
        assert_eq!(
            taken(8, 2),
            [vec![0], vec![3], vec![6], vec![1], vec![2], vec![4], vec![5], vec![7]]
        );
        // Of more than are looked for, the rest is as all others.
        let bites = taken(100, 2);
        assert_eq!(bites[MOST_LONG - 1], [3 * (MOST_LONG - 1)]);
        let sizes: Vec<_> = bites[2 * MOST_LONG - 1..].iter().map(Vec::len).collect();
        assert!(sizes.contains(&5) && sizes.is_sorted_by(|a, b| a >= b), "{sizes:?}");
        assert_eq!(taken(0, 2), Vec::<Vec<usize>>::new());
    }
}
