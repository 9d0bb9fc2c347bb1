//! The generator of everything random: ChaCha8, keyed by seed and episode.
//!
//! ChaCha8 is named and portable, and the draws below are written out, so that a seed means the
//! same episode on every machine and under every version of the libraries.

use rand::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Marks the streams of [`Rng::aside`]; the others have numbers below it.
const ASIDE: u64 = 1 << 8;

/// Random numbers of one episode.
#[derive(Debug, Clone)]
pub struct Rng(ChaCha8Rng);

impl Rng {
    /// The generator of episode `episode` under `seed`; different pairs are independent.
    pub fn new(seed: u64, episode: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&episode.to_le_bytes());
        Self(ChaCha8Rng::from_seed(key))
    }

    /// The generator of the same episode for what sensors and links do to it, independent of
    /// [`Self::new`]'s: randomising them leaves the episode itself as it was.
    pub fn sensor(seed: u64, episode: u64) -> Self {
        let mut rng = Self::new(seed, episode);
        rng.0.set_stream(1);
        rng
    }

    /// The generator of the same episode for what actuators do to commands, independent of the others.
    pub fn actuator(seed: u64, episode: u64) -> Self {
        let mut rng = Self::new(seed, episode);
        rng.0.set_stream(3);
        rng
    }

    /// The generator of the same episode for what things look like, independent of the others.
    pub fn appearance(seed: u64, episode: u64) -> Self {
        let mut rng = Self::new(seed, episode);
        rng.0.set_stream(4);
        rng
    }

    /// The generator with which the `index`-th prepared start is made, the same for every seed.
    pub fn start(index: u64) -> Self {
        let mut rng = Self::new(index, 0);
        rng.0.set_stream(2);
        rng
    }

    /// The generator of the same episode for the variation of its prepared start, independent of the others.
    pub fn variation(seed: u64, episode: u64) -> Self {
        let mut rng = Self::new(seed, episode);
        rng.0.set_stream(5);
        rng
    }

    /// A generator for a few numbers that an episode draws besides, independent of this one, which goes on as
    /// if it had never been asked: randomising what they are for leaves the rest of the episode as it was.
    #[must_use]
    pub fn aside(&self) -> Self {
        let mut rng = self.clone();
        rng.0.set_stream(rng.0.get_stream() | ASIDE);
        rng
    }

    /// Uniform in [0, 1), a multiple of 2⁻⁵³.
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [`low`, `high`]; `low` where both are equal.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform among 0, 1, …, `count` − 1.
    pub fn index(&mut self, count: usize) -> usize {
        // The bias of this multiplication is below count / 2⁶⁴.
        ((u128::from(self.0.next_u64()) * count as u128) >> 64) as usize
    }

    /// Normal with mean 0 and standard deviation 1 (Box–Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.unit())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.unit())
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_of_a_seed_is_fixed_for_good() {
        let mut rng = Rng::new(7, 3);
        let first = [rng.0.next_u64(), rng.0.next_u64()];
        assert_eq!(first, FIRST_WORDS);
    }

    /// The first output of seed 7, episode 3: if this changes, so does every recorded episode.
    const FIRST_WORDS: [u64; 2] = [4_140_881_248_777_258_056, 2_706_257_457_796_370_635];

    #[test]
    fn episodes_and_seeds_have_their_own_sequences() {
        let first = |seed, episode| Rng::new(seed, episode).unit();
        assert_eq!(first(1, 0).to_bits(), first(1, 0).to_bits());
        assert!(first(1, 0) != first(1, 1) && first(1, 0) != first(0, 1));
    }

    #[test]
    fn what_is_drawn_aside_is_something_else_and_leaves_the_episode_alone() {
        let ten = |rng: &mut Rng| [(); 10].map(|()| rng.unit());
        for rng in [Rng::new(7, 3), Rng::sensor(7, 3), Rng::start(7)] {
            let (mut alone, mut asked) = (rng.clone(), rng.clone());
            let aside = ten(&mut asked.aside());
            assert_eq!(aside, ten(&mut asked.aside()));
            assert_eq!(ten(&mut asked), ten(&mut alone));
            assert!(aside != ten(&mut rng.clone()) && aside != ten(&mut asked.aside()));
        }
        assert!(Rng::new(7, 3).aside().unit() != Rng::start(7).aside().unit());
    }

    #[test]
    fn draws_have_the_moments_they_should() {
        let mut rng = Rng::new(0, 0);
        let count = 100_000;
        let (mut sum, mut squares, mut low) = (0.0, 0.0, 0);
        for _ in 0..count {
            let normal = rng.normal();
            assert!(normal.is_finite());
            sum += normal;
            squares += normal * normal;
            assert!((2.0..=5.0).contains(&rng.uniform(2.0, 5.0)));
            low += usize::from(rng.index(3) == 0);
        }
        // Standard errors are 0.003, 0.0045 and 0.0015.
        let n = f64::from(count);
        assert!((sum / n).abs() < 0.02);
        assert!((squares / n - 1.0).abs() < 0.03);
        assert!((low as f64 / n - 1.0 / 3.0).abs() < 0.01);
    }
}
