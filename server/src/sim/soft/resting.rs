//! Samples beside flat faces of what stands still: most of the contacts of tissue that lies on something.
//!
//! The law is that of [`contact`](super::contact). Here nothing turns and the normal stays, so that vectors take the place
//! of rows: the effective mass is 1 / (Σ w²/m) in every direction.

use nalgebra::Vector3;
use wide::f32x4;

use super::candidates::Candidate;
use super::contact::{self, lanes, vector};
use super::proxy::Proxy;

/// How many samples are computed beside each other.
const CHAINS: usize = 4;

/// A sample that may touch a flat face in this step.
#[derive(Debug, Clone)]
pub(super) struct Resting {
    pub sample: Candidate,
    /// Out of the face, axes of the world.
    normal: f32x4,
    /// How far the face is from the lattice's origin along the normal, m.
    offset: f32,
    /// kg; 0, where the sample is held.
    mass: f32,
    /// The impulse of this substep, N·s; the sum of those of this step, and of their parts along the normal.
    impulse: f32x4,
    given: f32x4,
    pressing: f32,
}

/// The product of two vectors, whose fourth numbers are 0, in an order that no processor decides.
#[inline(always)]
fn dot(one: f32x4, other: f32x4) -> f32 {
    let [x, y, z, _] = (one * other).to_array();
    x + y + z
}

/// The order of so many samples in which those that share nodes do not follow each other: no processor has to wait for the
/// one before.
#[inline(always)]
pub(super) fn order(samples: usize) -> impl Iterator<Item = usize> {
    let apart = samples.div_ceil(CHAINS);
    (0..apart).flat_map(move |first| (first..samples).step_by(apart))
}

impl Resting {
    /// A sample at `point`, beside a face to which it has this distance (m).
    pub(super) fn new(
        sample: Candidate,
        point: &Vector3<f32>,
        normal: &Vector3<f32>,
        distance: f32,
    ) -> Self {
        Self {
            normal: lanes(normal),
            offset: normal.dot(point) - distance,
            mass: if sample.corners.is_held() { 0.0 } else { 1.0 / sample.corners.mobility },
            impulse: f32x4::ZERO,
            given: f32x4::ZERO,
            pressing: 0.0,
            sample,
        }
    }

    /// How far it is beyond the face, m.
    #[inline(always)]
    pub(super) fn distance(&self, places: &[f32x4]) -> f32 {
        dot(self.normal, self.sample.corners.mean(places)) - self.offset
    }

    /// Begins a step with the impulse of the step before.
    pub(super) fn begin(&mut self) {
        self.impulse = lanes(&self.sample.impulse);
    }

    /// Begins a substep with the impulse of the one before, `scale` times as large.
    #[inline(always)]
    pub(super) fn start(&mut self, scale: f32, velocities: &mut [f32x4]) {
        self.impulse *= f32x4::splat(scale);
        self.sample.corners.push(self.impulse, velocities);
    }

    /// Changes velocities by what the face does to it.
    ///
    /// There are no branches on what is computed: no processor could tell in time whether they are taken.
    #[inline(always)]
    pub(super) fn solve(&mut self, places: &[f32x4], velocities: &mut [f32x4], seconds: f32) {
        let distance = self.distance(places);
        let least = f32x4::splat(contact::least_velocity(distance, seconds));
        let missing = self.normal * least - self.sample.corners.mean(velocities);
        let wanted = self.impulse + missing * f32x4::splat(self.mass);
        let along = dot(self.normal, wanted);
        let across = wanted - self.normal * f32x4::splat(along);
        let pressing = if distance > contact::REACH { 0.0 } else { along.max(0.0) };
        let (most, size) = (self.sample.friction * pressing, dot(across, across).sqrt());
        let part = (most / size.max(f32::MIN_POSITIVE)).min(1.0);
        let impulse = self.normal * f32x4::splat(pressing) + across * f32x4::splat(part);
        self.sample.corners.push(impulse - self.impulse, velocities);
        self.impulse = impulse;
        self.given += impulse;
        self.pressing += pressing;
    }

    /// Ends a step: keeps what the next begins with, and tells what has the face what was done to it.
    pub(super) fn finish(&mut self, places: &[f32x4], proxies: &mut [Proxy]) {
        self.sample.impulse = vector(self.impulse);
        if self.pressing == 0.0 {
            return;
        }
        let proxy = &mut proxies[self.sample.proxy as usize];
        let point = vector(self.sample.corners.mean(places));
        proxy.load.add(&vector(self.given), &point, &proxy.centre, self.pressing);
    }
}
