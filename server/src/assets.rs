//! Models of `assets/`, embedded in the binary: collision shapes, mass, friction and named frames.
//!
//! Each is read once in the life of the process and shared.

use std::sync::LazyLock;

use urdf_rs::{Geometry, Robot};

use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::world::{Part, Shape};
use nalgebra::{Point3, Vector3};

/// One rigid object; lengths in m.
#[derive(Debug, Clone)]
pub struct Model {
    /// Its collision shapes.
    pub parts: Vec<Part>,
    /// Its mass, kg.
    pub mass: f64,
    /// Friction coefficient of what it is made of.
    pub friction: f64,
    frames: Vec<(String, Pose)>,
}

impl Model {
    /// The 40 mm suture needle: an arc of wire in the xy plane about the origin.
    pub fn needle() -> &'static Self {
        static NEEDLE: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/needle/model.urdf")));
        &NEEDLE
    }

    /// The gauze: a small folded swab with a standing pleat along x; its origin is its middle.
    pub fn gauze() -> &'static Self {
        static GAUZE: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/gauze/model.urdf")));
        &GAUZE
    }

    /// The block of the peg transfer: a triangular ring about z; its origin is its middle.
    pub fn block() -> &'static Self {
        static BLOCK: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/block/model.urdf")));
        &BLOCK
    }

    /// The board of the peg transfer with its pegs; its origin is the middle of the board.
    pub fn pegboard() -> &'static Self {
        static PEGBOARD: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/pegboard/model.urdf")));
        &PEGBOARD
    }

    /// The pad; its origin is that of the tray in which it lies.
    pub fn pad() -> &'static Self {
        static PAD: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/pad/model.urdf")));
        &PAD
    }

    /// The tray; its origin is the middle of its underside.
    pub fn tray() -> &'static Self {
        static TRAY: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/tray/model.urdf")));
        &TRAY
    }

    /// The table; its origin is on the floor below its middle.
    pub fn table() -> &'static Self {
        static TABLE: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/table/model.urdf")));
        &TABLE
    }

    /// The frame `name`, fixed to the body.
    ///
    /// # Panics
    /// Where the model has no such frame.
    pub fn body_from(&self, name: &str) -> Pose {
        let found = self.frames.iter().find(|(frame, _)| frame == name);
        found.unwrap_or_else(|| panic!("the model has no frame {name:?}")).1
    }

    /// The box around the collision shapes of the model when it is at `world_from_body`, m.
    pub fn aabb(&self, world_from_body: &Pose) -> Aabb {
        let boxes = self.parts.iter().map(|part| part.aabb(world_from_body));
        boxes.reduce(|one, other| one.merged(&other)).expect("a model has collision shapes")
    }

    /// Reads a model of one body; its other links are frames fixed to it.
    ///
    /// # Panics
    /// Where `urdf` is not such a model: the models are part of the program, and tests read them.
    fn read(urdf: &str) -> Self {
        let robot: Robot = urdf_rs::read_from_string(urdf).expect("an embedded model is a URDF");
        let [body, frames @ ..] = robot.links.as_slice() else {
            panic!("a model has a body");
        };
        let material = body.visual.first().and_then(|visual| visual.material.as_ref());
        let material = &material.expect("a body shows what it is made of").name;
        let parts = body.collision.iter().map(|collision| Part {
            body_from_part: pose(&collision.origin),
            shape: shape(&collision.geometry),
        });
        let frame = |name: &str| {
            let joint = robot.joints.iter().find(|joint| joint.child.link == name);
            let joint = joint.expect("a frame hangs on the body");
            assert_eq!(joint.parent.link, body.name, "a frame hangs on the body");
            (name.to_string(), pose(&joint.origin))
        };
        Self {
            parts: parts.collect(),
            mass: body.inertial.mass.value,
            friction: friction_of(material),
            frames: frames.iter().map(|link| frame(&link.name)).collect(),
        }
    }
}

/// The friction coefficient that the table of materials gives, with its source.
fn friction_of(material: &str) -> f64 {
    /// Column of the table.
    const FRICTION: usize = 5;
    let table = include_str!("../../assets/materials.csv");
    let rows = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let row = rows.skip(1).find(|row| row[0] == material);
    let row = row.unwrap_or_else(|| panic!("no material {material:?}"));
    row[FRICTION].parse().expect("friction is a number")
}

fn pose(origin: &urdf_rs::Pose) -> Pose {
    frames::pose(*origin.xyz, *origin.rpy)
}

fn shape(geometry: &Geometry) -> Shape {
    match geometry {
        Geometry::Box { size } => Shape::Cuboid(Vector3::from(**size) * 0.5),
        Geometry::Capsule { radius, length } => Shape::Capsule {
            a: Point3::new(0.0, 0.0, -0.5 * length),
            b: Point3::new(0.0, 0.0, 0.5 * length),
            radius: *radius,
        },
        other => panic!("collision shapes are boxes and capsules, not {other:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_needle_is_an_arc_of_steel_wire() {
        let needle = Model::needle();
        assert!((0.3e-3..0.42e-3).contains(&needle.mass));
        assert_eq!(needle.body_from("mid_arc").translation.vector, Vector3::new(-0.02, 0.0, 0.0));
        let aabb = needle.aabb(&Pose::identity());
        assert!((aabb.max.z - 0.5e-3).abs() < 1e-9 && (aabb.min.z + 0.5e-3).abs() < 1e-9);
        assert!((0.039..0.042).contains(&(aabb.max.y - aabb.min.y)), "{aabb:?}");
    }

    #[test]
    fn friction_is_that_of_the_table_of_materials() {
        assert!((Model::needle().friction - 1.0).abs() < 1e-12);
        assert!((friction_of("block") - Model::block().friction).abs() < 1e-12);
    }

    #[test]
    fn the_pad_lies_in_the_tray() {
        let (pad, tray) = (Model::pad(), Model::tray());
        let (pad, tray) = (pad.aabb(&Pose::identity()), tray.aabb(&Pose::identity()));
        assert_eq!(pad.merged(&tray), tray);
        assert!((pad.max.z - 0.0062).abs() < 1e-9);
    }
}
