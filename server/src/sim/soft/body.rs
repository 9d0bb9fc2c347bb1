//! A soft body in the world: its lattice, its skin, what it touches, and whether it sleeps.

use std::ops::AddAssign;
use std::sync::{Arc, OnceLock};

use nalgebra::{Matrix3, Point3, Vector3};

use super::attachment::Attachments;
use super::contact::Contacts;
use super::lattice::{Form, Lattice};
use super::material::{Friction, Material, MaterialError};
use super::proxy::{Motor, Proxy};
use super::skin::{MaterialPoint, Skin};
use crate::sim::frames::{Aabb, Pose};
use crate::sim::world::{NonRigid, Surface, World};

/// Speed of the fastest node below which a body may fall asleep, m/s.
const STILL: f64 = 1e-3;

/// Time that counts as none, s: more than rounding.
const LEAST_STEP: f64 = 1e-8;

/// Time after which a body that hardly moves falls asleep, s.
const SLEEP_AFTER: f64 = 0.02;

/// Distance at which bodies are looked at in a step, m, beyond what the body itself covers: from 0.3 mm on there are
/// contacts, and instruments cover 0.4.
const REACH: f64 = 0.7e-3;

/// Distance at which what moves wakes a body that sleeps, m, beyond what it covers in this step: a finger that begins to
/// turn covers less.
const WAKE: f32 = 0.1e-3;

/// A soft body.
#[derive(Clone)]
pub struct SoftBody {
    name: &'static str,
    colour: [f32; 3],
    pub(super) lattice: Lattice,
    skin: Arc<Skin>,
    friction: Friction,
    ultimate_strain: Option<f64>,
    contacts: Contacts,
    attachments: Attachments,
    /// For how long it has hardly moved, s.
    still: f64,
    /// What is known of it while it is asleep.
    asleep: Option<Asleep>,
    /// How often its nodes have moved.
    moves: u64,
}

/// What does not change of a body that is asleep.
#[derive(Debug, Clone)]
struct Asleep {
    /// The box around it.
    bounds: Aabb,
    /// What was done to it where no element is between jaws, once that was asked for.
    damage: OnceLock<Damage>,
}

impl Asleep {
    fn new(lattice: &Lattice) -> Self {
        Self { bounds: lattice.bounds(), damage: OnceLock::new() }
    }
}

impl SoftBody {
    /// A body at rest with its frame at `world_from_body`, that has this name in masks and this colour (as pictures
    /// store it).
    pub fn new(
        name: &'static str,
        colour: [f32; 3],
        form: Arc<Form>,
        skin: Arc<Skin>,
        world_from_body: &Pose,
    ) -> Self {
        let Material { friction, ultimate_strain, .. } = form.material;
        let lattice = Lattice::new(form, world_from_body);
        let contacts = Contacts::default();
        Self {
            name,
            colour,
            lattice,
            skin,
            friction,
            ultimate_strain,
            contacts,
            attachments: Attachments::default(),
            still: 0.0,
            asleep: None,
            moves: 0,
        }
    }

    /// How often its nodes have moved: as long as that is the same, it has the same shape.
    pub fn moves(&self) -> u64 {
        self.moves
    }

    /// Its nodes.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Where the coordinates of its lattice begin, m.
    pub(in crate::sim) fn origin(&self) -> Vector3<f64> {
        self.lattice.origin
    }

    /// Its skin.
    pub fn skin(&self) -> &Skin {
        &self.skin
    }

    /// Puts it somewhere, undeformed, at rest and awake.
    pub fn place(&mut self, world_from_body: &Pose) {
        self.lattice.place(world_from_body);
        self.moves += 1;
        self.contacts.clear();
        self.detach();
        self.wake();
    }

    /// Moves it as it is, deformed and asleep or not, by a motion of the world.
    pub fn carry(&mut self, motion: &Pose) {
        self.lattice.carry(motion);
        self.moves += 1;
        self.asleep = self.asleep.take().map(|_| Asleep::new(&self.lattice));
        self.contacts.clear();
        self.detach();
    }

    /// Attaches the samples of the skin that `is_attached` chooses by their places (m) to a rigid body, by its key, in
    /// place of what was attached.
    pub(in crate::sim) fn attach(&mut self, body: u32, is_attached: impl Fn(&Point3<f64>) -> bool) {
        let samples = self.skin.fine.places.iter().copied();
        self.attachments = Attachments::new(
            body,
            samples.filter(|sample| is_attached(&self.lattice.point(sample))),
        );
        if self.is_attached() {
            self.wake();
        }
    }

    /// Whether anything of it is attached to a rigid body.
    pub fn is_attached(&self) -> bool {
        !self.attachments.are_none()
    }

    /// Lets go what is attached.
    pub fn detach(&mut self) {
        self.attachments = Attachments::default();
    }

    /// Sets its friction coefficients.
    pub fn set_friction(&mut self, friction: Friction) {
        self.friction = friction;
    }

    /// Makes it `thickness` times as thick along its z axis as its first form, and puts it somewhere, undeformed, at rest
    /// and awake.
    pub fn thicken(&mut self, thickness: f64, world_from_body: &Pose) -> Result<(), MaterialError> {
        self.lattice.reform(Arc::new(self.lattice.form.thickened(thickness)?));
        self.place(world_from_body);
        Ok(())
    }

    /// Sets the greatest principal strain that it bears; none, where that is not known.
    pub fn set_ultimate_strain(&mut self, strain: Option<f64>) {
        self.ultimate_strain = strain;
        self.asleep = self.asleep.take().map(|_| Asleep::new(&self.lattice));
    }

    /// Makes its moduli `stiffness` times those of its material, at most as large.
    pub fn soften(&mut self, stiffness: f64) {
        self.lattice.soften(stiffness);
        self.wake();
    }

    /// Lets it move again.
    pub fn wake(&mut self) {
        (self.still, self.asleep) = (0.0, None);
    }

    /// Where points of it are, m.
    pub fn points<'a>(
        &'a self,
        places: &'a [MaterialPoint],
    ) -> impl Iterator<Item = Point3<f64>> + 'a {
        places.iter().map(|place| self.lattice.point(place))
    }

    /// What was done to its elements. One is between jaws if its middle or a corner is, as `is_between` says: whether a
    /// point is between jaws, or up to a distance (m) from there.
    pub fn damage(&self, is_between: impl Fn(&Point3<f64>, f64) -> bool) -> Damage {
        let Some(ultimate) = self.ultimate_strain else { return Damage::default() };
        let form = self.lattice.form();
        let offsets = form.grid.corner_offsets();
        // The corners of an element that is stretched to twice its length are as near to its middle.
        let near = 2.0 * form.grid.spacing;
        let bounds = self.bounds();
        if !is_between(&bounds.centre().into(), 0.5 * bounds.extents().norm() + near) {
            let find = || self.damage_where(ultimate, |_| false);
            return self
                .asleep
                .as_ref()
                .map_or_else(find, |asleep| *asleep.damage.get_or_init(find));
        }
        // Nodes lie outside of the skin, where fingers are that press on it.
        let outside = 0.25 * form.grid.spacing;
        self.damage_where(ultimate, |element| {
            let middle = MaterialPoint { element: element as u32, at: [0.5; 3] };
            let middle = self.lattice.point(&middle);
            let mut corners = offsets.iter().map(|offset| self.lattice.node(element + offset));
            is_between(&middle, near)
                && (is_between(&middle, outside)
                    || corners.any(|corner| is_between(&corner, outside)))
        })
    }

    /// What was done to its elements, which bear this strain, where `is_gripped` says which of them are between jaws.
    fn damage_where(&self, ultimate: f64, is_gripped: impl Fn(usize) -> bool) -> Damage {
        let mut damage = Damage::default();
        for element in self.lattice.form().elements() {
            // Its eigenvalues are the squares of the principal stretches.
            let gradient = self.lattice.deformation_gradient(element);
            let squares = gradient.tr_mul(&gradient);
            if is_gripped(element) {
                let least = (1.0 - ultimate).max(0.0);
                let above = squares - Matrix3::identity() * (least * least);
                damage.gripped += 1;
                damage.crushed += u32::from(!is_positive_definite(&above));
            } else {
                let most = 1.0 + ultimate;
                let below = Matrix3::identity() * (most * most) - squares;
                damage.free += 1;
                damage.overstretched += u32::from(!is_positive_definite(&below));
            }
        }
        damage
    }

    /// Lets `seconds` pass beside these rigid bodies, whose fingers `motors` turn in pairs.
    pub(in crate::sim) fn pass(&mut self, seconds: f64, proxies: &mut [Proxy], motors: &[Motor]) {
        self.moves += 1;
        proxies.iter_mut().for_each(Proxy::settle);
        let reach = (REACH + self.lattice.fastest() * seconds) as f32;
        let Self { lattice, skin, friction, contacts, attachments, .. } = self;
        contacts.begin(lattice, skin, friction, proxies, reach);
        lattice.begin();
        let mut left = seconds;
        while left > LEAST_STEP {
            let dt = lattice.find_forces(1.0, left);
            left -= f64::from(dt);
            lattice.kick(dt);
            for motor in motors {
                motor.begin(proxies);
            }
            for proxy in &mut *proxies {
                proxy.begin(dt);
            }
            if contacts.are_possible() {
                contacts.solve(lattice, proxies, dt, !attachments.are_none());
            }
            if !attachments.are_none() {
                attachments.solve(lattice, proxies, dt);
            }
            lattice.drift(dt);
            for proxy in &mut *proxies {
                proxy.finish(dt);
            }
        }
        contacts.finish(proxies, seconds);
        let may_sleep =
            !contacts.touches_moving && attachments.are_none() && lattice.fastest() < STILL;
        self.still = if may_sleep { self.still + seconds } else { 0.0 };
        if self.still > SLEEP_AFTER {
            self.lattice.stop();
            self.asleep = Some(Asleep::new(&self.lattice));
        }
    }

    /// Whether one of these rigid bodies that moves may touch a sample of its skin within `seconds`.
    fn is_neared(&self, mut proxies: Vec<Proxy>, seconds: f64) -> bool {
        proxies.retain(|proxy| !proxy.is_static);
        let seconds = seconds as f32;
        let covered = proxies.iter().map(|proxy| proxy.reach(seconds)).fold(0.0, f32::max);
        self.beside(proxies, WAKE + covered, |contacts, proxies| {
            contacts.are_approached(proxies, seconds, WAKE)
        })
    }

    /// How deep samples of its skin are in these rigid bodies, m: the deepest.
    pub(in crate::sim) fn deepest_overlap(&self, proxies: Vec<Proxy>) -> f64 {
        self.beside(proxies, 0.0, Contacts::deepest)
    }

    /// What `found` tells of the samples within `reach` (m) of these rigid bodies, where all are now.
    fn beside<T>(
        &self,
        mut proxies: Vec<Proxy>,
        reach: f32,
        found: impl FnOnce(&Contacts, &[Proxy]) -> T,
    ) -> T {
        proxies.iter_mut().for_each(Proxy::settle);
        let mut contacts = Contacts::default();
        contacts.begin(&self.lattice, &self.skin, &self.friction, &proxies, reach);
        let told = found(&contacts, &proxies);
        contacts.finish(&mut proxies, 1.0);
        told
    }
}

/// Whether a symmetric matrix is positive definite, by Sylvester's criterion. One that is not finite is not.
fn is_positive_definite(matrix: &Matrix3<f64>) -> bool {
    let second = matrix.m11 * matrix.m22 - matrix.m12 * matrix.m21;
    matrix.m11 > 0.0 && second > 0.0 && matrix.determinant() > 0.0
}

/// What was done to the elements of soft bodies.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Damage {
    /// Elements between jaws, and those of them that are compressed beyond the ultimate strain of their material: no source
    /// has another in compression than in tension.
    pub gripped: u32,
    /// See `gripped`.
    pub crushed: u32,
    /// Other elements, and those of them that are stretched beyond the ultimate strain.
    pub free: u32,
    /// See `free`.
    pub overstretched: u32,
}

impl Damage {
    /// The share of the elements that are not between jaws that are overstretched.
    pub fn overstretched_share(&self) -> f64 {
        f64::from(self.overstretched) / f64::from(self.free.max(1))
    }

    /// The share of the elements between jaws that are crushed.
    pub fn crushed_share(&self) -> f64 {
        f64::from(self.crushed) / f64::from(self.gripped.max(1))
    }
}

impl AddAssign for Damage {
    /// Goes on to another body.
    fn add_assign(&mut self, other: Self) {
        self.gripped += other.gripped;
        self.crushed += other.crushed;
        self.free += other.free;
        self.overstretched += other.overstretched;
    }
}

impl NonRigid for SoftBody {
    fn advance(&mut self, world: &mut World, seconds: f64) {
        let bounds = self.bounds();
        if self.asleep.is_some() {
            let region = bounds.grown(REACH);
            if !world.stirs_in(&region) {
                return;
            }
            let (proxies, _) = world.proxies_in(&region, &self.lattice.origin, None);
            if !self.is_neared(proxies, seconds) {
                return;
            }
            // It falls asleep again at once, unless it is touched.
            self.asleep = None;
        }
        let region = bounds.grown(REACH + self.lattice.fastest() * seconds);
        let (mut proxies, motors) =
            world.proxies_in(&region, &self.lattice.origin, self.attachments.body());
        self.pass(seconds, &mut proxies, &motors);
        world.absorb(&proxies, &self.lattice.origin, self.lattice.fastest());
    }

    fn bits(&self) -> Box<dyn Iterator<Item = u32> + '_> {
        let Lattice { x, v, tangents, .. } = &self.lattice;
        let numbers = x.iter().chain(v).flatten().chain(tangents).map(|number| number.to_bits());
        let still = self.still.to_bits();
        let sleep = [still as u32, (still >> 32) as u32, u32::from(self.asleep.is_some())];
        Box::new(numbers.chain(self.contacts.bits()).chain(self.attachments.bits()).chain(sleep))
    }

    fn is_finite(&self) -> bool {
        self.lattice.is_finite()
    }

    fn at_rest(&self) -> bool {
        self.asleep.is_some()
    }

    fn bounds(&self) -> Aabb {
        self.asleep.as_ref().map_or_else(|| self.lattice.bounds(), |asleep| asleep.bounds)
    }

    fn surface(&self) -> Surface {
        let (vertices, normals) = self.skin.surface(&self.lattice);
        Surface {
            name: self.name,
            vertices,
            normals,
            rest: Arc::clone(&self.skin.rest),
            colour: self.colour,
            material: self.lattice.form().material.name.clone(),
        }
    }

    fn memory_bytes(&self) -> u64 {
        size_of::<Self>() as u64
            + self.lattice.memory_bytes()
            + self.contacts.memory_bytes()
            + self.attachments.memory_bytes()
    }

    fn boxed_clone(&self) -> Box<dyn NonRigid> {
        Box::new(self.clone())
    }
}
