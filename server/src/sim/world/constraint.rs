//! The constraint solver: what joints and contacts do to an island of bodies within a substep.
//!
//! A joint or contact is some *rows*. A row is one direction in which two bodies move against each other: an impulse
//! along it changes both. Jacobians are computed once a substep and bodies moved once, at its end. In between there
//! are only six numbers of velocity and six of displacement for each body.
//!
//! The scheme is that of small steps with soft contacts (Macklin et al. 2019, *Small steps in physics simulation*;
//! Catto 2023, *Solver2D*, "soft step"). The substep is cut into iterations. Each of them
//! 1. adds what forces give, and the impulses of the iteration before;
//! 2. solves all rows by Gauss–Seidel, where overlaps push bodies apart as springs do;
//! 3. lets bodies move;
//! 4. solves again without that push, so that it leaves no velocity behind, and with friction.
//!
//! Friction of a manifold is a disc of two tangents at the middle of its points, and a torque about the normal.

use rapier3d::math::Vector;

use super::Solver;
use algebra::{inverse, inverse_of, sum, tangents};
use rows::{JointRow, Manifold, Row, STATIC, Step, recovery};

mod algebra;
mod rows;

pub(super) use algebra::Spatial;
pub(super) use rows::{ContactPoint, ContactSide, Friction, Joint, PointImpulse, SolverBody};

/// Bodies and the rows between them; one island.
#[derive(Debug, Default)]
pub(super) struct Constraints {
    bodies: Vec<SolverBody>,
    rows: Vec<Row>,
    joints: Vec<JointRow>,
    manifolds: Vec<Manifold>,
    /// Velocities at the beginning of an iteration.
    before: Vec<Spatial>,
}

impl Constraints {
    /// Removes everything.
    pub(super) fn clear(&mut self) {
        self.bodies.clear();
        self.rows.clear();
        self.joints.clear();
        self.manifolds.clear();
    }

    /// Adds a body, and gives its number.
    pub(super) fn add_body(&mut self, body: SolverBody) -> usize {
        self.bodies.push(body);
        self.bodies.len() - 1
    }

    /// The bodies, in the order in which they were added.
    pub(super) fn bodies(&self) -> &[SolverBody] {
        &self.bodies
    }

    /// Adds a row of a joint between a body and what no row moves, whose velocity along the row is `drift`.
    pub(super) fn add_joint(&mut self, body: usize, jacobian: Spatial, drift: f32, joint: Joint) {
        let impulse = if let Joint::Lock { impulse, .. } = joint { impulse } else { 0.0 };
        let row = self.row([body, STATIC], [jacobian, Spatial::default()], -drift, impulse);
        let row = self.push_row(row);
        self.joints.push(JointRow { row, joint, rate: 0.0, softness: 0.0, mass: 0.0, moved: 0.0 });
    }

    /// The velocity along `normal` that a unit impulse at `point` gives.
    pub(super) fn mobility(&self, sides: &[ContactSide; 2], point: Vector, normal: Vector) -> f32 {
        self.contact_row(sides, point, normal, 0.0).mobility
    }

    /// True if friction at `point` can hold bodies on hinges against any normal force: Coulomb's friction cone contains a
    /// direction along which no impulse turns the hinge.
    pub(super) fn is_self_locking(
        &self,
        sides: &[ContactSide; 2],
        point: Vector,
        normal: Vector,
        coefficient: f32,
    ) -> bool {
        let along = tangents(normal).map(|tangent| self.mobility(sides, point, tangent));
        let tangential: f32 = along.iter().sum();
        coefficient * coefficient * tangential >= self.mobility(sides, point, normal)
    }

    /// Adds the rows of two parts that touch at `points`; `normal` points from the first to the second. An impulse must
    /// be able to move them, at each of the points.
    pub(super) fn add_manifold(
        &mut self,
        sides: [ContactSide; 2],
        normal: Vector,
        coefficient: f32,
        points: &[ContactPoint],
        friction: &Friction,
    ) {
        let apart = -normal;
        let first = self.rows.len();
        let middle = points.iter().map(|point| point.point).sum::<Vector>() / points.len() as f32;
        for point in points {
            let row = self.contact_row(&sides, point.point, apart, point.impulse);
            let lever = (point.point - middle).length();
            self.push_row(Row { distance: point.distance, lever, ..row });
        }
        let twist = (points.len() > 1)
            .then(|| self.push_row(self.twist_row(&sides, apart, friction.twist)));
        let axes = tangents(apart);
        let tangent = self.rows.len();
        for axis in axes {
            self.push_row(self.contact_row(&sides, middle, axis, friction.tangent.dot(axis)));
        }
        let [one, other] = [&self.rows[tangent], &self.rows[tangent + 1]];
        let mixed = (0..2).map(|side| one.jacobians[side].dot(&other.responses[side])).sum();
        let inverse = inverse_of([one.mobility, other.mobility, mixed]);
        let points = points.len();
        self.manifolds.push(Manifold { first, points, twist, tangent, axes, inverse, coefficient });
    }

    fn push_row(&mut self, row: Row) -> usize {
        self.rows.push(row);
        self.rows.len() - 1
    }

    /// A row along `direction`, in which the first body moves, at `point`.
    fn contact_row(
        &self,
        sides: &[ContactSide; 2],
        point: Vector,
        direction: Vector,
        impulse: f32,
    ) -> Row {
        let jacobian = |side: usize, direction: Vector| {
            Spatial::new(direction, (point - sides[side].centre).cross(direction))
        };
        self.row_between(sides, [jacobian(0, direction), jacobian(1, -direction)], impulse)
    }

    /// A row of turning about `axis`.
    fn twist_row(&self, sides: &[ContactSide; 2], axis: Vector, impulse: f32) -> Row {
        let jacobians = [axis, -axis].map(|axis| Spatial::new(Vector::ZERO, axis));
        self.row_between(sides, jacobians, impulse)
    }

    fn row_between(
        &self,
        sides: &[ContactSide; 2],
        mut jacobians: [Spatial; 2],
        impulse: f32,
    ) -> Row {
        let mut drift = 0.0;
        for (side, jacobian) in sides.iter().zip(&jacobians) {
            if side.body.is_none() {
                drift += jacobian.dot(&side.velocity);
            }
        }
        // What moves comes first.
        let mut bodies = sides.map(|side| side.body.unwrap_or(STATIC));
        if bodies[0] == STATIC {
            bodies.swap(0, 1);
            jacobians.swap(0, 1);
        }
        self.row(bodies, jacobians, drift, impulse)
    }

    fn row(&self, bodies: [usize; 2], jacobians: [Spatial; 2], drift: f32, impulse: f32) -> Row {
        let mut responses = [Spatial::default(); 2];
        let mut mobility = 0.0;
        for side in 0..2 {
            if bodies[side] != STATIC {
                let (body, jacobian) = (&self.bodies[bodies[side]], &jacobians[side]);
                responses[side] = Spatial::new(
                    body.inverse_mass * jacobian.linear(),
                    body.inverse_inertia * jacobian.angular(),
                );
                mobility += jacobian.dot(&responses[side]);
            }
        }
        let mass = inverse(mobility);
        let [distance, lever, rate, softness, total] = [0.0; 5];
        Row {
            bodies,
            jacobians,
            responses,
            drift,
            mobility,
            mass,
            distance,
            lever,
            rate,
            softness,
            impulse,
            total,
        }
    }

    /// Lets `dt` (s) pass. One iteration is enough for what touches nothing: it falls, or a motor turns it.
    pub(super) fn solve(&mut self, dt: f32, solver: &Solver) {
        let turns = |joint: &JointRow| {
            matches!(joint.joint, Joint::Motor { per_inertia: true, .. } | Joint::Limit { .. })
        };
        if self.manifolds.is_empty() && self.joints.iter().all(turns) {
            self.iterate(dt, &Solver { iterations: 1, ..*solver });
        } else {
            self.iterate(dt, solver);
        }
    }

    fn iterate(&mut self, dt: f32, solver: &Solver) {
        let step = Step::new(dt, solver);
        for joint in &mut self.joints {
            joint.prepare(step.dt, self.rows[joint.row].mobility);
        }
        for manifold in &self.manifolds {
            for row in &mut self.rows[manifold.first..manifold.first + manifold.points] {
                (row.rate, row.softness) = step.softness(row.mobility);
            }
        }
        self.before.clear();
        self.before.extend(self.bodies.iter().map(|body| body.velocity));
        for row in 0..self.rows.len() {
            self.push(row, self.rows[row].impulse);
        }
        for iteration in 0..solver.iterations {
            let passed = iteration as f32 * step.dt;
            for (body, before) in self.bodies.iter_mut().zip(&mut self.before) {
                let mut velocity = body.velocity;
                // All but the first begin with what the impulses of the one before gave.
                if iteration > 0 {
                    velocity.add_scaled(&body.velocity, 1.0);
                    velocity.add_scaled(before, -1.0);
                    *before = body.velocity;
                }
                velocity.add_scaled(&body.acceleration, step.dt);
                before.add_scaled(&body.acceleration, step.dt);
                body.velocity = velocity;
            }
            for index in 0..self.joints.len() {
                self.joints[index].moved = self.moved(&self.rows[self.joints[index].row], passed);
            }
            for _ in 0..solver.sweeps {
                self.sweep(&step, passed, true);
            }
            for body in &mut self.bodies {
                let velocity = body.velocity;
                body.displacement.add_scaled(&velocity, step.dt);
            }
            for _ in 0..solver.sweeps {
                self.sweep(&step, passed + step.dt, false);
            }
            for row in &mut self.rows {
                row.total += row.impulse;
            }
        }
        for row in &self.rows {
            for body in row.bodies.iter().filter(|body| **body != STATIC) {
                self.bodies[*body].is_pushed |= row.total != 0.0;
            }
        }
    }

    /// Solves all rows one after the other: before bodies move, with what pushes overlaps apart, and after, with friction.
    /// Locks come last, so that locks hold against all other rows.
    fn sweep(&mut self, step: &Step, passed: f32, moves: bool) {
        self.solve_joints(false, moves);
        self.solve_normals(step, passed, moves);
        if !moves {
            for manifold in 0..self.manifolds.len() {
                self.solve_friction(manifold);
            }
        }
        self.solve_joints(true, moves);
    }

    fn solve_joints(&mut self, locks: bool, pushes: bool) {
        for index in 0..self.joints.len() {
            let JointRow { row: number, joint, rate, softness, mass, moved } = self.joints[index];
            if joint.is_lock() != locks {
                continue;
            }
            let row = &self.rows[number];
            let velocity = self.velocity(row);
            let new = match joint {
                Joint::Motor { position, target, .. } => {
                    let error = (position + moved - target) * rate + softness * row.impulse;
                    row.impulse - mass * (velocity + error)
                }
                Joint::Limit { position, limits: [least, most] } => {
                    let at = position + moved;
                    let beyond = (at - most).max(0.0) - (least - at).max(0.0);
                    let push = if pushes { recovery(beyond * rate) } else { 0.0 };
                    let new = row.impulse - mass * (velocity + push);
                    match beyond {
                        beyond if beyond > 0.0 => new.min(0.0),
                        beyond if beyond < 0.0 => new.max(0.0),
                        _ => 0.0,
                    }
                }
                Joint::Lock { position, .. } => {
                    let push = if pushes { (position + moved) * rate } else { 0.0 };
                    row.impulse - mass * (velocity + push)
                }
            };
            self.set_impulse(number, new);
        }
    }

    fn solve_normals(&mut self, step: &Step, passed: f32, pushes: bool) {
        for index in 0..self.manifolds.len() {
            let Manifold { first, points, .. } = self.manifolds[index];
            for number in first..first + points {
                let row = &self.rows[number];
                let distance = row.distance + self.moved(row, passed);
                let (push, softness) = if distance > 0.0 {
                    (distance * step.inverse_dt, 1.0) // it may come as near as to touch
                } else if pushes {
                    (recovery(distance * row.rate), row.softness)
                } else {
                    (0.0, 1.0)
                };
                let new = row.impulse - row.mass * (self.velocity(row) + push);
                self.set_impulse(number, softness * new.max(0.0));
            }
        }
    }

    fn solve_friction(&mut self, index: usize) {
        let Manifold { first, points, twist, tangent, inverse, coefficient, .. } =
            self.manifolds[index];
        let (mut force, mut torque) = (0.0, 0.0);
        for row in first..first + points {
            force += self.rows[row].impulse;
            torque += self.rows[row].impulse * self.rows[row].lever;
        }
        let (force, torque) = (coefficient * force, coefficient * torque);
        let rubs = |row: usize| self.rows[row].impulse != 0.0;
        if force == 0.0 && !rubs(tangent) && !rubs(tangent + 1) && !twist.is_some_and(rubs) {
            return;
        }
        if let Some(number) = twist {
            let row = &self.rows[number];
            let new = row.impulse - row.mass * self.velocity(row);
            self.set_impulse(number, new.clamp(-torque, torque));
        }
        let rows = [&self.rows[tangent], &self.rows[tangent + 1]];
        let [x, y] = rows.map(|row| self.velocity(row));
        let [one, other, mixed] = inverse;
        let new =
            [rows[0].impulse - (one * x + mixed * y), rows[1].impulse - (other * y + mixed * x)];
        let length = (new[0] * new[0] + new[1] * new[1]).sqrt();
        let share = if length > force { force / length } else { 1.0 };
        self.set_impulse(tangent, new[0] * share);
        self.set_impulse(tangent + 1, new[1] * share);
    }

    /// How fast both bodies move along a row.
    fn velocity(&self, row: &Row) -> f32 {
        self.along(row, |body| &body.velocity) + row.drift
    }

    /// How far both have moved along a row since the beginning.
    fn moved(&self, row: &Row, passed: f32) -> f32 {
        self.along(row, |body| &body.displacement) + row.drift * passed
    }

    fn along(&self, row: &Row, what: impl Fn(&SolverBody) -> &Spatial) -> f32 {
        let [first, second] = row.bodies;
        let mut products = row.jacobians[0].products(what(&self.bodies[first]));
        if second != STATIC {
            products += row.jacobians[1].products(what(&self.bodies[second]));
        }
        sum(products)
    }

    fn set_impulse(&mut self, row: usize, impulse: f32) {
        let old = std::mem::replace(&mut self.rows[row].impulse, impulse);
        self.push(row, impulse - old);
    }

    /// Applies an impulse along a row.
    fn push(&mut self, row: usize, impulse: f32) {
        let row = &self.rows[row];
        let [first, second] = row.bodies;
        self.bodies[first].velocity.add_scaled(&row.responses[0], impulse);
        if second != STATIC {
            self.bodies[second].velocity.add_scaled(&row.responses[1], impulse);
        }
    }

    /// The impulses of locks in the last iteration, in the order in which they were added.
    pub(super) fn lock_impulses(&self) -> impl Iterator<Item = f32> + '_ {
        let locks = self.joints.iter().filter(|joint| joint.joint.is_lock());
        locks.map(|joint| self.rows[joint.row].impulse)
    }

    /// What each point bore, in the order in which manifolds were added.
    pub(super) fn point_impulses(&self) -> impl Iterator<Item = PointImpulse> + '_ {
        self.manifolds.iter().flat_map(|manifold| {
            let Manifold { first, points, tangent, twist, axes: [one, other], .. } = *manifold;
            let impulse = |row: usize| self.rows[row].impulse;
            let friction = Friction {
                tangent: one * impulse(tangent) + other * impulse(tangent + 1),
                twist: twist.map_or(0.0, impulse),
            };
            let rows = self.rows[first..first + points].iter();
            rows.map(move |row| PointImpulse { total: row.total, last: row.impulse, friction })
        })
    }
}
