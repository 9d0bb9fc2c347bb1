//! Seeds of episodes: any non-negative integer is one.
//!
//! - A number below 2⁶³ is the seed itself.
//! - A larger number is mixed: SplitMix64 runs over its 64-bit words, and the upper 63 bits of the
//!   result are the seed.
//! - Environment `i` of a session with seed `s` has the seed of the number `s + i`.
//!
//! So every seed fits NumPy's signed integers, and a seed that infos and recordings show gives the same
//! episodes as the number that it came from.
//!
//! ```
//! use trocar_proto::seed;
//!
//! assert_eq!(seed::of(7), 7);
//! let mixed = seed::of(u128::from(u64::MAX));
//! assert_eq!(seed::of(mixed.into()), mixed);
//! ```

/// Seeds are below this number, 2⁶³.
pub const LIMIT: u64 = 1 << 63;

/// The seed of a number.
pub fn of(number: u128) -> u64 {
    of_le_bytes(&number.to_le_bytes())
}

/// The seed of a number of any size, given by its bytes, the least significant one first.
pub fn of_le_bytes(number: &[u8]) -> u64 {
    let length = number.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    let words = || number[..length].chunks(8).map(word);
    match words().next() {
        None => 0,
        Some(only) if length <= 8 && only < LIMIT => only,
        Some(_) => words().fold(0, |mixed, word| split_mix(mixed ^ word)) >> 1,
    }
}

fn word(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte))
}

/// The next output of SplitMix64 (Steele, Lea and Flood 2014) in the state `state`.
fn split_mix(state: u64) -> u64 {
    let mut mixed = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_below_the_limit_are_their_own_seeds() {
        for number in [0, 1, 255, 256, 7 << 32, LIMIT - 1] {
            assert_eq!(of(number.into()), number);
        }
    }

    /// As the Python tests have them: if these change, so do episodes that were recorded.
    #[test]
    fn larger_numbers_are_mixed_by_a_fixed_rule() {
        let number = |shift: u32, plus: u128| (1_u128 << shift) + plus;
        let seeds = [number(63, 0), number(64, 0) - 1, number(64, 0), number(127, 5)].map(of);
        assert_eq!(seeds, PINNED);
        assert!(seeds.iter().all(|seed| *seed < LIMIT));
        assert_eq!(of_le_bytes(&[0; 40]), 0);
        let mut long = [0; 40];
        long[32] = 1;
        assert_eq!(of_le_bytes(&long), PINNED_256);
    }

    const PINNED: [u64; 4] = [
        2_598_401_411_181_246_957,
        8_245_168_133_484_221_968,
        313_702_574_736_366_215,
        147_049_417_268_983_529,
    ];
    const PINNED_256: u64 = 5_974_511_739_358_450_099;

    #[test]
    fn the_first_output_of_split_mix_is_the_published_one() {
        assert_eq!(split_mix(0), 0xe220_a839_7b1d_cdaf);
    }
}
