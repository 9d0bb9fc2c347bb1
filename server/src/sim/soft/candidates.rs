//! Samples of the skin that may touch a rigid part before a step of the world ends: found once a step.
//!
//! What moves meets all samples, [`Skin::fine`]. What stands still is mostly large and flat and meets the vertices,
//! [`Skin::coarse`]; all samples, where it has an edge or is narrow. What is beside a flat face of it and counts on few nodes
//! is [`resting`](super::resting).

use std::iter::Copied;
use std::slice::Iter;

use nalgebra::Vector3;
use wide::f32x4;

use super::contact::{lanes, vector};
use super::corners::{Corners, Nodes};
use super::lanes::{length, with_widest_instructions};
use super::lattice::{CORNERS, Lattice};
use super::material::Friction;
use super::proxy::{PartProxy, Proxy};
use super::resting::Resting;
use super::shape::Shape;
use super::skin::{Samples, Skin};

/// Added to the number of a sample between those that meet a static body.
const FINE: usize = 1 << 23;

/// A sample that may touch a part in this step.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    /// Tells the pair of sample and part from others, from step to step.
    pub key: u64,
    pub proxy: u16,
    pub part: u16,
    pub friction: f32,
    /// For how much of the skin it stands, m².
    pub area: f32,
    pub corners: Corners,
    /// The impulse of the substep before, N·s, axes of the world.
    pub impulse: Vector3<f32>,
    /// Whether the part has pressed on it in this step.
    pub pressed: bool,
    /// How far it is from the part, at least, m: until that is used up, nothing has to be computed.
    pub clear: f32,
}

/// The candidates of a step, each kind in the order of keys.
#[derive(Debug, Default)]
pub(super) struct Candidates {
    /// Beside flat faces of what stands still in this step.
    pub resting: Resting,
    /// Beside edges and curved faces of it.
    pub fixed: Vec<Candidate>,
    /// Beside what moves.
    pub moving: Vec<Candidate>,
    pub nodes: Nodes,
    coarse: Regions,
    fine: Regions,
}

impl Candidates {
    /// Whether anything may be touched in this step.
    pub(super) fn are_none(&self) -> bool {
        self.resting.is_empty() && self.fixed.is_empty() && self.moving.is_empty()
    }

    /// Finds the samples that may touch a part before `reach` (m) is covered.
    pub(super) fn find(
        &mut self,
        lattice: &Lattice,
        skin: &Skin,
        friction: &Friction,
        proxies: &[Proxy],
        reach: f32,
    ) {
        let candidates = self;
        with_widest_instructions!(find(
            candidates: &mut Candidates,
            lattice: &Lattice,
            skin: &Skin,
            friction: &Friction,
            proxies: &[Proxy],
            reach: f32
        ));
    }
}

#[inline(always)]
fn find(
    candidates: &mut Candidates,
    lattice: &Lattice,
    skin: &Skin,
    friction: &Friction,
    proxies: &[Proxy],
    reach: f32,
) {
    let Candidates { resting, fixed, moving, nodes, coarse, fine } = candidates;
    resting.clear();
    fixed.clear();
    moving.clear();
    if proxies.is_empty() {
        return;
    }
    nodes.begin(lattice);
    let corners = lattice.form.grid.corner_offsets();
    coarse.find(&skin.coarse, corners, &nodes.places);
    fine.find(&skin.fine, corners, &nodes.places);
    let mass = lattice.form.thickness as f32;
    for (number, proxy) in proxies.iter().enumerate() {
        let friction = if proxy.is_profiled { friction.profiled } else { friction.smooth };
        let found = if proxy.is_static { &mut *fixed } else { &mut *moving };
        for (part_number, part) in proxy.parts.iter().enumerate() {
            let key = u64::from(proxy.key()) << 32 | (part_number as u64) << 24;
            let mut add = |index: usize, corners: &Corners, area: f32| {
                let point = vector(corners.mean(&nodes.places));
                let Some(gap) = part.gap(&point, reach) else { return };
                let is_resting = proxy.is_static
                    && Resting::fits(corners)
                    && part.is_flat_near(&point, 2.0 * reach);
                let sample = Candidate {
                    key: key | index as u64,
                    proxy: number as u16,
                    part: part_number as u16,
                    friction: friction as f32,
                    area,
                    corners: corners.clone().with_mass(mass),
                    impulse: Vector3::zeros(),
                    pressed: false,
                    clear: 0.0,
                };
                if is_resting {
                    resting.push(sample, &point, &gap.normal, gap.distance);
                } else {
                    found.push(sample);
                }
            };
            let near = Region::around(part, reach);
            if proxy.is_static {
                coarse.samples(&near, &skin.coarse, |_| true, &mut add);
                let is_sharp = |element: &Region| part.is_sharp_near(element, skin.spacing);
                let add_fine = |index, corners: &_, area| add(index | FINE, corners, area);
                fine.samples(&near, &skin.fine, is_sharp, add_fine);
            } else {
                let is_near = |element: &Region| part.is_near(element, reach);
                fine.samples(&near, &skin.fine, is_near, add);
            }
        }
    }
    nodes.mark(fixed.iter().chain(&*moving).map(|candidate| &candidate.corners));
}

/// A box, m from the lattice's origin, axes of the world.
#[derive(Debug, Clone, Copy)]
struct Region {
    min: f32x4,
    max: f32x4,
}

impl Region {
    /// Around a part, and up to `reach` (m) from there.
    fn around(part: &PartProxy, reach: f32) -> Self {
        let [centre, half] = part.shape.bounds();
        let centre = part.at.origin + part.at.axes * centre;
        let half = part.at.axes.abs() * half + Vector3::repeat(reach);
        Self { min: lanes(&(centre - half)), max: lanes(&(centre + half)) }
    }

    /// The box around both.
    #[inline(always)]
    fn with(self, other: Self) -> Self {
        Self { min: self.min.fast_min(other.min), max: self.max.fast_max(other.max) }
    }

    #[inline(always)]
    fn meets(&self, other: &Self) -> bool {
        (self.min.simd_le(other.max) & other.min.simd_le(self.max)).all()
    }
}

/// The boxes around elements that have samples, and around every [`GROUP`] of them.
#[derive(Debug, Default)]
struct Regions {
    each: Vec<Region>,
    groups: Vec<Region>,
}

/// Elements that are looked at together at first.
const GROUP: usize = 8;

impl Regions {
    #[inline(always)]
    fn find(&mut self, samples: &Samples, corners: [usize; CORNERS], places: &[f32x4]) {
        self.each.clear();
        self.each.extend(samples.elements.iter().map(|(element, _)| {
            let corner = |offset: &usize| places[*element as usize + offset];
            let points = corners.iter().map(corner).map(|point| Region { min: point, max: point });
            points.reduce(Region::with).expect("an element has corners")
        }));
        self.groups.clear();
        let groups = self.each.chunks(GROUP).map(|group| group.iter().copied());
        let all = |group: Copied<Iter<'_, Region>>| group.reduce(Region::with);
        self.groups.extend(groups.filter_map(all));
    }

    /// Visits the samples in elements that are `near` something and that `counts` does not leave out.
    fn samples(
        &self,
        near: &Region,
        samples: &Samples,
        counts: impl Fn(&Region) -> bool,
        mut visit: impl FnMut(usize, &Corners, f32),
    ) {
        let elements = samples.elements.chunks(GROUP).zip(self.each.chunks(GROUP));
        let groups = elements.zip(&self.groups).filter(|(_, group)| group.meets(near));
        for ((_, range), region) in
            groups.flat_map(|((elements, each), _)| elements.iter().zip(each))
        {
            if region.meets(near) && counts(region) {
                for index in range.clone() {
                    let index = index as usize;
                    visit(index, &samples.corners[index], samples.areas[index]);
                }
            }
        }
    }
}

impl PartProxy {
    /// Whether its surface is within `reach` of a region, or of samples that are a little outside of that.
    fn is_near(&self, region: &Region, reach: f32) -> bool {
        let size = length(&vector(region.max - region.min));
        let middle = vector(region.min + region.max) * 0.5;
        self.gap(&middle, reach + 0.75 * size).is_some()
    }

    /// Whether its surface is a flat face within `reach` of a point that is at it.
    fn is_flat_near(&self, point: &Vector3<f32>, reach: f32) -> bool {
        let local = self.at.axes.tr_mul(&(point - self.at.origin));
        matches!(self.shape, Shape::Cuboid(_)) && !self.shape.is_sharp_near(&local, reach)
    }

    /// Whether its surface has an edge within `reach` of a region, or is curved as narrowly as that.
    fn is_sharp_near(&self, near: &Region, reach: f32) -> bool {
        let middle = vector(near.min + near.max) * 0.5 - self.at.origin;
        let size = length(&vector(near.max - near.min));
        self.shape.is_sharp_near(&self.at.axes.tr_mul(&middle), reach + 0.5 * size)
    }
}
