//! Eight numbers that are computed with at once, whatever the processor has: the order of sums depends on their count.
//!
//! Code in lanes is compiled twice: for the registers of 128 bits that every processor of the kind has, and for those of
//! 256 bits (AVX2), which [`with_widest_registers`] takes where the processor has them. Each lane is computed alike in both,
//! and no multiplication is fused with an addition, so the bits are the same.

use std::ops::{Add, Div, Mul, Neg, Sub};

use nalgebra::Vector3;
use wide::f32x8;

/// How many there are.
pub(super) const LANES: usize = 8;

/// The length of a vector, with the bits of its `norm`. That one takes the root by an instruction for narrow registers,
/// which has to wait where wide ones are in use.
#[inline(always)]
pub(super) fn length(vector: &Vector3<f32>) -> f32 {
    vector.norm_squared().sqrt()
}

/// Eight numbers.
pub(super) trait Lanes:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    fn new(numbers: [f32; LANES]) -> Self;
    fn numbers(self) -> [f32; LANES];
    fn splat(number: f32) -> Self;
    /// The greater of two, which are no NaN.
    fn max(self, other: Self) -> Self;
    /// The lesser of two, which are no NaN.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        -(-self).max(-other)
    }
    fn abs(self) -> Self;
    fn sqrt(self) -> Self;
    /// These numbers where those are above 0, and 0 elsewhere.
    fn where_positive(self, those: Self) -> Self;

    /// The first eight numbers.
    #[inline(always)]
    fn load(numbers: &[f32]) -> Self {
        let lanes: &[f32; LANES] = numbers[..LANES].try_into().expect("eight lanes");
        Self::new(*lanes)
    }

    /// The first `count` numbers, at most eight; the others are 0.
    #[inline(always)]
    fn first(numbers: &[f32], count: usize) -> Self {
        if count >= LANES {
            return Self::load(numbers);
        }
        let mut lanes = [0.0; LANES];
        lanes[..count].copy_from_slice(&numbers[..count]);
        Self::new(lanes)
    }

    #[inline(always)]
    fn store(self, numbers: &mut [f32]) {
        numbers[..LANES].copy_from_slice(&self.numbers());
    }

    /// Each number a lane further on, and 0 in the first; and the last number.
    #[inline(always)]
    fn shifted(self) -> (Self, f32) {
        let [a, b, c, d, e, f, g, last] = self.numbers();
        (Self::new([0.0, a, b, c, d, e, f, g]), last)
    }

    #[inline(always)]
    fn times(self, number: f32) -> Self {
        self * Self::splat(number)
    }

    #[inline(always)]
    fn plus(self, number: f32) -> Self {
        self + Self::splat(number)
    }
}

impl Lanes for f32x8 {
    #[inline(always)]
    fn new(numbers: [f32; LANES]) -> Self {
        Self::from(numbers)
    }

    #[inline(always)]
    fn numbers(self) -> [f32; LANES] {
        self.to_array()
    }

    #[inline(always)]
    fn splat(number: f32) -> Self {
        Self::splat(number)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.fast_max(other)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn where_positive(self, those: Self) -> Self {
        those.simd_gt(Self::splat(0.0)) & self
    }
}

/// Whether the processor has registers of 256 bits, and no test does without them.
#[cfg(target_arch = "x86_64")]
pub(super) fn are_wide() -> bool {
    #[cfg(test)]
    if NARROW.get() {
        return false;
    }
    std::arch::is_x86_feature_detected!("avx2")
}

#[cfg(test)]
thread_local! {
    /// Whether this thread does without registers of 256 bits.
    pub(super) static NARROW: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Calls a function that takes the kind of lanes as its type parameter, with the widest registers of the processor.
macro_rules! with_widest_registers {
    ($function:ident($($name:ident: $type:ty),*) -> $result:ty) => {{
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide($($name: $type),*) -> $result {
                $function::<$crate::sim::soft::lanes::Avx2>($($name),*)
            }
            if $crate::sim::soft::lanes::are_wide() {
                // SAFETY: the processor has what the function was compiled for.
                #[allow(unsafe_code)]
                return unsafe { wide($($name),*) };
            }
        }
        $function::<wide::f32x8>($($name),*)
    }};
}
pub(super) use with_widest_registers;

/// Calls a function with the instructions that come with the widest registers of the processor. What it calls has them where
/// it is inlined.
macro_rules! with_widest_instructions {
    ($function:ident($($name:ident: $type:ty),*)) => {{
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide($($name: $type),*) {
                $function($($name),*);
            }
            if $crate::sim::soft::lanes::are_wide() {
                // SAFETY: the processor has what the function was compiled for.
                #[allow(unsafe_code)]
                return unsafe { wide($($name),*) };
            }
        }
        $function($($name),*);
    }};
}
pub(super) use with_widest_instructions;

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2;

/// The instructions are unsafe where a processor may not have them. The type says why this one has, for all blocks.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
mod avx2 {
    use std::arch::x86_64::{
        __m256, _CMP_GT_OQ, _mm256_add_ps, _mm256_and_ps, _mm256_andnot_ps, _mm256_cmp_ps,
        _mm256_div_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_mul_ps, _mm256_set1_ps,
        _mm256_setzero_ps, _mm256_sqrt_ps, _mm256_storeu_ps, _mm256_sub_ps, _mm256_xor_ps,
    };

    use super::{Add, Div, LANES, Lanes, Mul, Neg, Sub};

    /// Eight numbers in a register. Only functions that `with_widest_registers` calls make any, once the processor has
    /// been seen to have AVX2. Arrays of eight numbers are as large as a register.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(__m256);

    /// Defines methods that are one instruction each.
    macro_rules! instruction {
        ($($trait:ident $method:ident $instruction:ident),*) => {$(
            impl $trait for Avx2 {
                type Output = Self;

                #[inline(always)]
                fn $method(self, other: Self) -> Self {
                    Self(unsafe { $instruction(self.0, other.0) })
                }
            }
        )*};
    }

    instruction!(Add add _mm256_add_ps, Sub sub _mm256_sub_ps, Mul mul _mm256_mul_ps, Div div _mm256_div_ps);

    impl Neg for Avx2 {
        type Output = Self;

        #[inline(always)]
        fn neg(self) -> Self {
            Self(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
        }
    }

    impl Lanes for Avx2 {
        #[inline(always)]
        fn new(numbers: [f32; LANES]) -> Self {
            Self(unsafe { _mm256_loadu_ps(numbers.as_ptr()) })
        }

        #[inline(always)]
        fn numbers(self) -> [f32; LANES] {
            let mut numbers = [0.0; LANES];
            unsafe { _mm256_storeu_ps(numbers.as_mut_ptr(), self.0) };
            numbers
        }

        #[inline(always)]
        fn splat(number: f32) -> Self {
            Self(unsafe { _mm256_set1_ps(number) })
        }

        #[inline(always)]
        fn max(self, other: Self) -> Self {
            Self(unsafe { _mm256_max_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn abs(self) -> Self {
            Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
        }

        #[inline(always)]
        fn sqrt(self) -> Self {
            Self(unsafe { _mm256_sqrt_ps(self.0) })
        }

        #[inline(always)]
        fn where_positive(self, those: Self) -> Self {
            let positive = unsafe { _mm256_cmp_ps::<_CMP_GT_OQ>(those.0, _mm256_setzero_ps()) };
            Self(unsafe { _mm256_and_ps(positive, self.0) })
        }
    }
}
