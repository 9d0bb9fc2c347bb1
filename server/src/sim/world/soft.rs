//! Soft bodies in the world: how rigid ones look to them, and what they do to rigid ones.
//!
//! Soft bodies pass a substep first, in substeps of their own, beside the rigid bodies near them
//! ([`Proxy`]). What they did is handed back before the rigid bodies pass the same substep:
//!
//! - A pair of fingers that touches one soft body and nothing rigid, or a free object that nothing rigid is near, has
//!   passed it already. It is put where it came to.
//! - Other fingers, and those that a second soft body touches, get the torque as a change of their rate of turning. Other
//!   objects get both impulses as a change of their velocities.
//! - What is driven gets nothing: its instrument sees the forces, and skin that has not given way ([`World::push_on`]).

use std::any::Any;

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use rapier3d::math::Vector as EngineVector;
use rapier3d::prelude::{RigidBody, RigidBodyHandle};

use super::hinge;
use super::{BodyId, GRAVITY, JawMotor, NonRigid, Overlap, Part, SUBSTEPS_PER_SECOND, World};
use crate::sim::frames::{self, Aabb, Pose, SCALE};
use crate::sim::soft::SoftBody;
use crate::sim::soft::proxy::{Frame, HingeProxy, Load, Motor, Obstacle, PartProxy, Proxy};

/// Speed above which what moves is looked at by soft bodies that sleep, m/s.
const STIRRING: f64 = 1e-4;

/// Speed of a soft body above which it wakes objects that sleep beside it, m/s.
const WAKING: f64 = 1e-3;

/// A soft body in the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SoftId(usize);

/// What a soft body did to a rigid one in the last substep.
#[derive(Debug, Clone, Copy)]
pub(super) struct SoftTouch {
    pub body: RigidBodyHandle,
    /// The soft body's place among those that are not rigid.
    pub by: usize,
    /// Mean force on the rigid body, N, friction included.
    pub force: Vector3<f64>,
    /// Sum of all normal forces, from whatever side, N.
    pub pressure: f64,
    /// Where, m.
    pub point: Point3<f64>,
    /// Mean pressure over the skin that pressed on it, Pa.
    pub mean_pressure: f64,
}

/// A finger that passed the substep beside a soft body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Passed {
    angle: f64,
    rate: f64,
}

/// A free object that passed it.
#[derive(Debug, Clone, Copy)]
pub(super) struct PassedObject {
    pub body: RigidBodyHandle,
    world_from_body: Pose,
    velocity: Vector3<f64>,
    rate: Vector3<f64>,
}

/// A pair of fingers and what turns it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grip {
    fingers: [RigidBodyHandle; 2],
    motor: JawMotor,
}

impl World {
    /// Puts a soft body into the world.
    pub fn insert_soft(&mut self, body: SoftBody) -> SoftId {
        self.others.push(Box::new(body));
        SoftId(self.others.len() - 1)
    }

    /// A soft body.
    pub fn soft(&self, id: SoftId) -> &SoftBody {
        let body: &dyn Any = &*self.others[id.0];
        body.downcast_ref().expect("bodies stay what they are")
    }

    /// A soft body, to change it.
    pub fn soft_mut(&mut self, id: SoftId) -> &mut SoftBody {
        let body: &mut dyn Any = &mut *self.others[id.0];
        body.downcast_mut().expect("bodies stay what they are")
    }

    /// All soft bodies.
    pub fn soft_bodies(&self) -> impl Iterator<Item = &SoftBody> {
        self.others.iter().filter_map(|body| {
            let body: &dyn Any = &**body;
            body.downcast_ref()
        })
    }

    /// The mean pressure of tissue on that of some bodies on which it was greatest in the last substep, Pa.
    pub fn tissue_pressure(&self, on: &[BodyId]) -> f64 {
        let touches = self.soft_touches.iter();
        let touches = touches.filter(|touch| on.iter().any(|body| body.0 == touch.body));
        touches.map(|touch| touch.mean_pressure).fold(0.0, f64::max)
    }

    /// Attaches those samples of a soft body's skin to a rigid one that `is_attached` chooses by their places, m.
    pub fn attach_skin(
        &mut self,
        soft: SoftId,
        body: BodyId,
        is_attached: impl Fn(&Point3<f64>) -> bool,
    ) {
        let key = body.0.into_raw_parts().0;
        self.soft_mut(soft).attach(key, is_attached);
    }

    /// The force of a soft body on a rigid one in the last substep, N, friction included.
    pub fn soft_force(&self, soft: SoftId, body: BodyId) -> Vector3<f64> {
        self.touches_between(soft, body).map(|touch| touch.force).sum()
    }

    /// How hard a soft body and a rigid one pressed on each other in the last substep, from whatever side, N.
    pub fn soft_pressure(&self, soft: SoftId, body: BodyId) -> f64 {
        self.touches_between(soft, body).map(|touch| touch.pressure).sum()
    }

    fn touches_between(&self, soft: SoftId, body: BodyId) -> impl Iterator<Item = &SoftTouch> {
        self.soft_touches.iter().filter(move |touch| touch.by == soft.0 && touch.body == body.0)
    }

    /// How deep one of its soft bodies is in rigid ones, m.
    pub fn soft_overlap(&self, soft: &SoftBody) -> f64 {
        let (proxies, _) = self.proxies_in(&soft.bounds(), &soft.origin(), None);
        soft.deepest_overlap(proxies)
    }

    /// Makes soft bodies meet a body as profiled jaws.
    pub fn set_profiled(&mut self, body: BodyId) {
        if !self.profiled.contains(&body.0) {
            self.profiled.push(body.0);
        }
    }

    /// Sets what turns a pair of fingers in the substep to come. Only bodies that are not rigid ask.
    pub fn set_grip(&mut self, fingers: [BodyId; 2], motor: JawMotor) {
        if self.others.is_empty() {
            return;
        }
        let fingers = fingers.map(|finger| finger.0);
        match self.grips.iter_mut().find(|grip| grip.fingers == fingers) {
            Some(grip) => grip.motor = motor,
            None => self.grips.push(Grip { fingers, motor }),
        }
    }

    /// Forgets what soft bodies did in the substep before.
    pub(super) fn clear_soft_touches(&mut self) {
        self.soft_touches.clear();
        self.soft_obstacles.clear();
        self.passed.clear();
        for hinge in &mut self.hinges {
            hinge.passed = None;
        }
    }

    /// Whether anything that moves is or will be in `region` at the end of the substep, or any finger is there that
    /// turns.
    pub(in crate::sim) fn stirs_in(&self, region: &Aabb) -> bool {
        let stirring = (STIRRING * SCALE) as f32;
        self.bodies.iter().any(|(handle, body)| {
            if !body.is_enabled() || body.is_fixed() || (body.is_dynamic() && body.is_sleeping()) {
                return false;
            }
            let next = self.next_pose(handle, body);
            let is_driven = next != *body.position();
            let moves =
                is_driven || body.linvel().length() > stirring || body.angvel().length() > stirring;
            moves && self.swept(body, &frames::from_engine(&next)).meets(region)
        })
    }

    /// The rigid bodies that may be in `region` in the substep to come and the one with the key `attached`, in the order of
    /// their keys, and what turns fingers among them.
    pub(in crate::sim) fn proxies_in(
        &self,
        region: &Aabb,
        origin: &Vector3<f64>,
        attached: Option<u32>,
    ) -> (Vec<Proxy>, Vec<Motor>) {
        let near = |body: &RigidBody, next: &Pose| self.swept(body, next).meets(region);
        let mut handles = vec![];
        for (handle, body) in self.bodies.iter().filter(|(_, body)| body.is_enabled()) {
            let is_attached = attached == Some(handle.into_raw_parts().0);
            if is_attached || near(body, &frames::from_engine(&self.next_pose(handle, body))) {
                handles.push(handle);
            }
        }
        // A pair of fingers is turned together.
        for grip in &self.grips {
            if grip.fingers.iter().any(|finger| handles.contains(finger)) {
                for finger in grip.fingers {
                    if !handles.contains(&finger) {
                        handles.push(finger);
                    }
                }
            }
        }
        handles.sort_by_key(|handle| handle.into_raw_parts());
        let mut motors = vec![];
        for grip in &self.grips {
            let place = |finger| handles.iter().position(|handle| *handle == finger);
            let [Some(left), Some(right)] = grip.fingers.map(place) else { continue };
            if !grip
                .fingers
                .iter()
                .any(|finger| self.touches_rigid(*finger) || self.has_passed(*finger))
            {
                motors.push(Motor { fingers: [left, right], motor: grip.motor });
            }
        }
        let turned = |number: usize| motors.iter().any(|motor| motor.fingers.contains(&number));
        let proxy = |(number, handle): (usize, &RigidBodyHandle)| {
            self.proxy(*handle, turned(number), origin)
        };
        let proxies = handles.iter().enumerate().map(proxy).collect();
        (proxies, motors)
    }

    /// Takes over what a soft body with this `origin`, whose fastest node has this speed (m/s), did to `proxies`.
    pub(in crate::sim) fn absorb(
        &mut self,
        proxies: &[Proxy],
        origin: &Vector3<f64>,
        fastest: f64,
    ) {
        for proxy in proxies {
            let (handle, load) = (proxy.handle, proxy.load);
            self.soft_obstacles.extend(load.obstacle.map(|Obstacle { depth, point, into }| {
                let point = Point3::from(origin + point.cast::<f64>());
                (handle, Overlap { depth: f64::from(depth), point, into: into.cast() })
            }));
            if load.pressing > 0.0 || load.attachments > 0 {
                // Where forces are not only those of contacts, in the middle of the attachments.
                let middle = if load.attachments > 0 {
                    load.attached / f64::from(load.attachments)
                } else {
                    load.moment / load.pressing
                };
                self.soft_touches.push(SoftTouch {
                    body: handle,
                    by: self.advancing,
                    force: load.impulse * SUBSTEPS_PER_SECOND,
                    pressure: load.pressing * SUBSTEPS_PER_SECOND,
                    point: Point3::from(origin + middle),
                    mean_pressure: load.pressure,
                });
            }
            if self.is_hinged(handle) {
                self.absorb_finger(proxy, self.is_pair_pressed(handle, proxies));
            } else if self.moving().any(|body| *body == handle) {
                if self.bodies[handle].is_sleeping() {
                    if fastest > WAKING {
                        self.bodies[handle].wake_up(true);
                    }
                } else if load.pressing > 0.0 && self.passes_alone(handle) {
                    let passed = self.passed_object(proxy, origin);
                    self.passed.push(passed);
                } else if load.pressing > 0.0 {
                    self.apply_to_object(handle, &load);
                }
            }
        }
    }

    /// Whether either of the pair of fingers to which this one belongs was pressed.
    fn is_pair_pressed(&self, finger: RigidBodyHandle, proxies: &[Proxy]) -> bool {
        let pair = self.grips.iter().find(|grip| grip.fingers.contains(&finger));
        let pressed = |proxy: &&Proxy| proxy.load.pressing > 0.0;
        let mut pressed = proxies.iter().filter(pressed);
        pair.is_some_and(|grip| pressed.any(|proxy| grip.fingers.contains(&proxy.handle)))
    }

    /// Takes over what a soft body did to a finger. A finger that passed beside one soft body goes with it, and others
    /// change its rate.
    fn absorb_finger(&mut self, proxy: &Proxy, is_pair_pressed: bool) {
        let rotation = *self.bodies[proxy.handle].rotation();
        let hung = self.hinges.iter_mut().find(|hinge| hinge.body == proxy.handle);
        let hung = hung.expect("it hangs on a hinge");
        if let Some(HingeProxy { angle, rate, .. }) = proxy.hinge {
            if is_pair_pressed {
                hung.passed = Some(Passed { angle, rate });
            }
            return;
        }
        let axis = rotation.mul_vec3(hung.axis);
        let inertia = f64::from(hung.inertia) / SCALE.powi(5);
        let turned = f64::from(hinge::unscaled(&proxy.load.angular).dot(axis)) / inertia;
        if let Some(passed) = &mut hung.passed {
            passed.rate += turned;
        } else {
            let body = &mut self.bodies[proxy.handle];
            let rate = body.angvel() + axis * turned as f32;
            body.set_angvel(rate, false);
        }
    }

    /// Changes the velocities of an object by what soft bodies did to it.
    fn apply_to_object(&mut self, object: RigidBodyHandle, load: &Load) {
        let body = &mut self.bodies[object];
        // Impulses are SCALE⁴ of the real ones, angular ones SCALE⁵, as masses are SCALE³.
        let properties = body.mass_properties();
        let inverse_inertia = properties.effective_world_inv_inertia;
        let linear = frames::to_engine_vector(&(load.impulse * SCALE.powi(3)));
        let angular = frames::to_engine_vector(&(load.angular * SCALE.powi(4)));
        let velocity = body.linvel() + properties.effective_inv_mass * linear;
        let rate = body.angvel() + inverse_inertia * angular;
        body.set_linvel(velocity, false);
        body.set_angvel(rate, false);
    }

    /// Where an object came to beside a soft body with this `origin`.
    fn passed_object(&self, proxy: &Proxy, origin: &Vector3<f64>) -> PassedObject {
        let body = &self.bodies[proxy.handle];
        let rotation: UnitQuaternion<f64> = proxy.rotation.cast();
        let now = frames::from_engine(body.position());
        let centre = frames::from_engine_vector(body.center_of_mass());
        let from_centre = now.rotation.inverse() * (now.translation.vector - centre);
        let at = origin + proxy.centre.cast::<f64>() + rotation * from_centre;
        PassedObject {
            body: proxy.handle,
            world_from_body: Pose::from_parts(at.into(), rotation),
            velocity: proxy.velocity.cast(),
            rate: proxy.rate.cast(),
        }
    }

    /// Puts what passed the substep beside soft bodies where it came to; carriers of fingers are where they will be.
    pub(super) fn finish_passed(&mut self) {
        for object in &self.passed {
            let body = &mut self.bodies[object.body];
            body.set_position(frames::to_engine(&object.world_from_body), false);
            body.set_linvel(frames::to_engine_vector(&object.velocity), false);
            body.set_angvel(hinge::unscaled(&object.rate), false);
        }
        for index in 0..self.hinges.len() {
            let Some(Passed { angle, rate }) = self.hinges[index].passed else { continue };
            let hung = self.hinges[index].clone();
            let carrier = &self.bodies[hung.carrier];
            let (linear, carried) = (carrier.linvel(), carrier.angvel());
            let pose = hung.pose(&frames::from_engine(carrier.position()), angle);
            let body = &mut self.bodies[hung.body];
            body.set_position(frames::to_engine(&pose), false);
            let axis = body.rotation().mul_vec3(hung.axis);
            body.set_linvel(linear, false);
            body.set_angvel(carried + axis * rate as f32, false);
        }
    }

    fn is_hinged(&self, body: RigidBodyHandle) -> bool {
        self.hinges.iter().any(|hinge| hinge.body == body)
    }

    /// Whether a free object has only soft bodies near it, and has not passed the substep beside another of them.
    fn passes_alone(&self, body: RigidBodyHandle) -> bool {
        self.free.contains(&body)
            && !self.passed.iter().any(|passed| passed.body == body)
            && self.attachments_of(body).next().is_none()
            && !self.is_near_rigid(body)
    }

    /// Whether a finger has passed this substep beside another soft body.
    fn has_passed(&self, finger: RigidBodyHandle) -> bool {
        self.hinges.iter().any(|hinge| hinge.body == finger && hinge.passed.is_some())
    }

    fn touches_rigid(&self, body: RigidBodyHandle) -> bool {
        self.impulses.iter().any(|touch| touch.impulse > 0.0 && touch.bodies.contains(&body))
    }

    /// Where a driven body will be at the end of the substep; others are where they are.
    fn next_pose(&self, handle: RigidBodyHandle, body: &RigidBody) -> rapier3d::math::Pose {
        let driven = self.driven.iter().find(|(driven, _)| *driven == handle);
        driven.and_then(|(_, next)| *next).unwrap_or(*body.position())
    }

    /// The box around a body where it is and where it will be, m.
    fn swept(&self, body: &RigidBody, next: &Pose) -> Aabb {
        let now = frames::from_engine(body.position());
        let parts = body.colliders().iter().filter_map(|part| self.part(*part));
        let boxes = parts.map(|part| part.aabb(&now).merged(&part.aabb(next)));
        boxes.reduce(|one, other| one.merged(&other)).unwrap_or_else(|| Aabb::around([]))
    }

    /// A body as a soft one with this `origin` meets it; `turned` says that it is a finger that passes the substep
    /// beside it.
    fn proxy(&self, handle: RigidBodyHandle, turned: bool, origin: &Vector3<f64>) -> Proxy {
        let body = &self.bodies[handle];
        let hung = self.hinges.iter().find(|hinge| hinge.body == handle);
        let frame = hung.map_or(handle, |hung| hung.carrier);
        let now = frames::from_engine(body.position());
        // What moves it: the twist of its carrier, or its own.
        let [mut velocity, mut rate] = self.twist(frame);
        let mut hinge = None;
        if let Some(hung) = hung {
            let axis = rate_from_engine(hung.axis);
            let own = rate_from_engine(body.angvel()) - rate;
            let mut turning = own.dot(&(now.rotation * axis));
            if let Some(passed) = hung.passed {
                turning = (passed.angle - self.hung_angle(hung)) * SUBSTEPS_PER_SECOND;
            }
            if turned {
                hinge = Some(HingeProxy {
                    axis: axis.cast(),
                    angle: self.hung_angle(hung),
                    rate: turning,
                    inertia: f64::from(hung.inertia) / SCALE.powi(5),
                    limits: hung.limits.map(f64::from),
                    carrier_rate: rate.cast(),
                    target: 0.0,
                    motor: [hinge::STIFFNESS, hinge::DAMPING],
                });
            }
            rate += now.rotation * axis * turning;
        }
        let is_free = self.moving().any(|moving| *moving == handle);
        let is_asleep = is_free && body.is_sleeping();
        let (mut centre, mut inverse_mass, mut inverse_inertia) =
            (now.translation.vector, 0.0, Matrix3::zeros());
        let mut gravity = Vector3::zeros();
        if is_free && !is_asleep {
            centre = frames::from_engine_vector(body.center_of_mass());
            let properties = body.mass_properties();
            let scale = SCALE.powi(3) as f32;
            inverse_mass = properties.effective_inv_mass.x * scale;
            let tensor = properties.effective_world_inv_inertia;
            let (scale, [a, b, c]) = (
                SCALE.powi(5) as f32,
                [EngineVector::X, EngineVector::Y, EngineVector::Z].map(|axis| tensor * axis),
            );
            inverse_inertia = Matrix3::new(a.x, b.x, c.x, a.y, b.y, c.y, a.z, b.z, c.z) * scale;
            if inverse_mass > 0.0 {
                gravity = Vector3::new(0.0, 0.0, -(GRAVITY as f32));
            }
        }
        let is_static = body.is_fixed() || is_asleep;
        if is_static {
            (velocity, rate) = (Vector3::zeros(), Vector3::zeros());
        }
        let rotation: UnitQuaternion<f32> = now.rotation.cast();
        let offset = now.rotation.inverse() * (now.translation.vector - centre);
        let parts = body.colliders().iter().filter_map(|part| self.part(*part));
        let part = |Part { body_from_part, shape }: Part| PartProxy {
            centre_from_part: (offset + body_from_part.translation.vector).cast(),
            rotation: body_from_part.rotation.cast(),
            shape: (&shape).into(),
            at: Frame::default(),
        };
        let parts: Vec<_> = parts.map(part).collect();
        Proxy {
            handle,
            is_profiled: self.profiled.contains(&handle),
            is_static,
            centre: (centre - origin).cast(),
            rotation,
            velocity: velocity.cast(),
            rate: rate.cast(),
            inverse_mass,
            inverse_inertia,
            gravity,
            hinge,
            radius: parts.iter().map(PartProxy::radius).fold(0.0, f32::max),
            parts,
            moved: 0.0,
            load: Load::default(),
        }
    }

    /// Velocity of a body, and its rate of turning, with which it passes the substep to come.
    fn twist(&self, handle: RigidBodyHandle) -> [Vector3<f64>; 2] {
        let body = &self.bodies[handle];
        if !self.driven.iter().any(|(driven, _)| *driven == handle) {
            return [frames::from_engine_vector(body.linvel()), rate_from_engine(body.angvel())];
        }
        let next = self.next_pose(handle, body);
        let turn = frames::rotation_vector(next.rotation * body.position().rotation.inverse());
        let way = next.translation - body.position().translation;
        [frames::from_engine_vector(way), rate_from_engine(turn)]
            .map(|way| way * SUBSTEPS_PER_SECOND)
    }
}

/// A rate of turning, rad/s, or an axis: it has no lengths in it that the engine would scale.
fn rate_from_engine(vector: EngineVector) -> Vector3<f64> {
    Vector3::new(vector.x, vector.y, vector.z).cast()
}
