//! Attachments: samples of the skin that are held where they are to a rigid body, without friction, as simulators do that
//! drag vertices along with a tool. They are for comparison only: real jaws have none.
//!
//! With the velocity u of a sample against the body, and the way e from the sample to its place in the body, an attachment is
//! u = [`UNDONE`] e / Δt, at most [`FASTEST`], with an impulse of any size. What it does to the nodes it does to the body,
//! too. The effective mass is that of a [contact](super::contact). Attachments are solved one after the other, [`SWEEPS`]
//! times.

use nalgebra::Vector3;

use super::contact::LEAST_MOBILITY;
use super::lattice::Lattice;
use super::proxy::Proxy;
use super::skin::MaterialPoint;

/// How often all attachments are solved in a substep.
const SWEEPS: usize = 4;

/// Part of the way to its place that a sample goes in a substep.
const UNDONE: f32 = 0.2;

/// Greatest speed with which it does, m/s.
const FASTEST: f32 = 0.1;

/// A sample that is attached.
#[derive(Debug, Clone, Copy)]
struct Attachment {
    sample: MaterialPoint,
    /// Its place in the body's frame, m from the centre that the body's [`Proxy`] has; none before the first substep.
    place: Option<Vector3<f32>>,
}

/// The attachments of a soft body, all to one rigid body.
#[derive(Debug, Clone, Default)]
pub(super) struct Attachments {
    /// The key of the rigid body's proxy.
    body: u32,
    attachments: Vec<Attachment>,
}

impl Attachments {
    /// Attachments of these samples to the body whose proxies have this key, where both are in the substep to come.
    pub(super) fn new(body: u32, samples: impl Iterator<Item = MaterialPoint>) -> Self {
        let attachments = samples.map(|sample| Attachment { sample, place: None }).collect();
        Self { body, attachments }
    }

    /// Whether there is none.
    pub(super) fn are_none(&self) -> bool {
        self.attachments.is_empty()
    }

    /// The key of the body, where there are attachments.
    pub(super) fn body(&self) -> Option<u32> {
        (!self.attachments.is_empty()).then_some(self.body)
    }

    /// Changes velocities of the nodes by what attachments do in a substep, and takes note of it for the body.
    pub(super) fn solve(&mut self, lattice: &mut Lattice, proxies: &mut [Proxy], seconds: f32) {
        let Some(proxy) = proxies.iter_mut().find(|proxy| proxy.key() == self.body) else { return };
        let offsets = lattice.form.grid.corner_offsets();
        for sweep in 0..SWEEPS {
            for attachment in &mut self.attachments {
                let corners = attachment.sample.weights().into_iter().zip(offsets);
                let corners = corners.map(|(weight, offset)| {
                    let node = attachment.sample.element as usize + offset;
                    (node, weight, weight * lattice.form.inverse_mass[node])
                });
                let mobility: f32 = corners.clone().map(|(_, weight, own)| weight * own).sum();
                if mobility < LEAST_MOBILITY {
                    continue;
                }
                let point = Vector3::from(lattice.local(&attachment.sample));
                let place = *attachment
                    .place
                    .get_or_insert_with(|| proxy.rotation.inverse() * (point - proxy.centre));
                let arm = proxy.rotation * place;
                let mut back = (arm + proxy.centre - point) * (UNDONE / seconds);
                if back.norm() > FASTEST {
                    back *= FASTEST / back.norm();
                }
                let mut velocity = Vector3::zeros();
                for (node, weight, _) in corners.clone() {
                    let at = [0, 1, 2].map(|axis: usize| lattice.v[axis][node]);
                    velocity += weight * Vector3::from(at);
                }
                let wanted = proxy.velocity + proxy.rate.cross(&arm) + back;
                let impulse = (wanted - velocity) / mobility;
                for (node, _, own) in corners {
                    for axis in 0..3 {
                        lattice.v[axis][node] += own * impulse[axis];
                    }
                }
                proxy.load.impulse -= impulse.cast::<f64>();
                proxy.load.angular -= arm.cross(&impulse).cast::<f64>();
                if sweep == 0 {
                    proxy.load.attachments += 1;
                    proxy.load.attached += (arm + proxy.centre).cast::<f64>();
                }
            }
        }
    }

    /// All that decides how they go on, as bits.
    pub(super) fn bits(&self) -> impl Iterator<Item = u32> {
        let attachments = self.attachments.iter().flat_map(|attachment| {
            let place = attachment.place.unwrap_or_else(|| Vector3::repeat(f32::INFINITY));
            let numbers = attachment.sample.at.into_iter().chain(<[f32; 3]>::from(place));
            std::iter::once(attachment.sample.element).chain(numbers.map(f32::to_bits))
        });
        self.body().into_iter().chain(attachments)
    }

    /// Memory that they take, bytes.
    pub(super) fn memory_bytes(&self) -> u64 {
        (self.attachments.capacity() * size_of::<Attachment>()) as u64
    }
}
