//! The one place that knows about instruction sets, and, beside the registers of `avx2` and `avx512`, the one with `unsafe`: a generic run
//! is instantiated inside functions compiled for different instruction sets, and the choice between
//! them is made at run time, once per run.
#![allow(unsafe_code)]

use super::Real;
#[cfg(target_arch = "x86_64")]
use super::{Fused, Wide, Wide512};

/// Instruction set that a run is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// The baseline of the target: runs everywhere, no fused multiply-add.
    Portable,
    /// x86-64 with AVX2 and FMA.
    Avx2,
    /// The same, with lanes in registers of AVX-512. One problem alone runs as at [`Level::Avx2`]: it would not fill them.
    Avx512,
}

/// A computation that is generic over its scalar. Its body must be `#[inline(always)]` all the way
/// down, or the inner functions are compiled for the baseline.
pub trait Run {
    /// What it computes.
    type Output;
    /// Runs it on one scalar type.
    fn run<T: Real<Mask = bool>>(self) -> Self::Output;
}

/// A computation on eight lanes that are eight separate problems.
pub trait RunWide {
    /// What it computes.
    type Output;
    /// Runs it on one type of lanes.
    fn run<T: Real<Pack = T>>(self) -> Self::Output;
}

impl Level {
    /// The widest level this processor has.
    pub fn best() -> Self {
        [Self::Avx512, Self::Avx2].into_iter().find(|level| level.available()).unwrap_or(Self::Portable)
    }

    /// Whether this processor has the level.
    pub fn available(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                Self::Avx2.available()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
            }
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 | Self::Avx512 => false,
        }
    }

    /// Runs `job` at this level, or at the baseline where the processor does not have it.
    pub fn run<R: Run>(self, job: R) -> R::Output {
        #[cfg(target_arch = "x86_64")]
        if self != Self::Portable && self.available() {
            // SAFETY: the processor has the features, checked in the line above; each level has those of the one before it.
            return unsafe { avx2(job) };
        }
        job.run::<f64>()
    }

    /// Whether eight problems side by side are faster here than one after the other: only vector registers make
    /// them so, and each is one more copy of a whole filter.
    pub fn has_lanes(self) -> bool {
        self != Self::Portable && self.available()
    }

    /// Runs `job` on the lanes of this level; None where it has none.
    pub fn run_wide<R: RunWide>(self, job: R) -> Option<R::Output> {
        #[cfg(target_arch = "x86_64")]
        if self.has_lanes() {
            // SAFETY: the processor has the features, checked in the line above.
            return Some(unsafe { if self == Self::Avx512 { avx512_wide(job) } else { avx2_wide(job) } });
        }
        let _ = job;
        None
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2_wide<R: RunWide>(job: R) -> R::Output {
    job.run::<Wide>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,avx512f,avx512dq,avx512vl")]
fn avx512_wide<R: RunWide>(job: R) -> R::Output {
    job.run::<Wide512>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn avx2<R: Run>(job: R) -> R::Output {
    job.run::<Fused>()
}

/// How a job is compiled: for every instruction set, or, where that is not worth the compiling, for one.
pub(crate) trait Runner {
    /// Runs a job.
    fn run<R: Run>(self, job: R) -> R::Output;
}

impl Runner for Level {
    fn run<R: Run>(self, job: R) -> R::Output {
        Level::run(self, job)
    }
}

/// The baseline of the target alone: for filters of wild starts, not of years of telemetry.
pub(crate) struct Baseline;

impl Runner for Baseline {
    fn run<R: Run>(self, job: R) -> R::Output {
        job.run::<f64>()
    }
}
