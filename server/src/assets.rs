//! Models of objects: collision shapes, looks, mass, friction and named frames, read from URDFs. Those of
//! `assets/` are embedded in the program, read once in its life and shared; own tasks bring theirs as
//! [`Scene`].

mod urdf;

use std::collections::BTreeMap;
use std::sync::LazyLock;

use trocar_proto::{Code, Rejection};
use urdf_rs::{Geometry, JointType, Robot};

use crate::render::material::Material;
use crate::render::mesh::{Form, Mesh};
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::world::{BodyId, Inertia, Motion, Part, World};

pub(crate) use urdf::pose;
use urdf::{inertia, part};

/// One rigid object; lengths in m.
#[derive(Debug, Clone)]
pub struct Model {
    /// Its collision shapes.
    pub parts: Vec<Part>,
    /// Its mass, kg.
    pub mass: f64,
    /// How its mass is spread.
    pub inertia: Inertia,
    /// Friction coefficient of what it is made of.
    pub friction: f64,
    /// What is seen of it.
    pub visuals: Vec<Visual>,
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

    /// The cylinder: a steel pin that stands on its end; its origin is its middle, z its axis.
    pub fn cylinder() -> &'static Self {
        static CYLINDER: LazyLock<Model> =
            LazyLock::new(|| Model::read(include_str!("../../assets/cylinder/model.urdf")));
        &CYLINDER
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

    /// The cube of a tracking task with edges of this length (m); its origin is its middle.
    ///
    /// # Panics
    /// Where there is no such cube: edges are 0.1 or 0.08 m long.
    pub fn cube(edge: f64) -> &'static Self {
        static CUBES: LazyLock<[Model; 2]> = LazyLock::new(|| {
            [
                Model::read(include_str!("../../assets/cube/model.urdf")),
                Model::read(include_str!("../../assets/cube/small.urdf")),
            ]
        });
        let has_edge = |cube: &&Model| {
            let width = cube.aabb(&Pose::identity()).extents().x;
            (width - edge).abs() < 1e-6
        };
        CUBES.iter().find(has_edge).unwrap_or_else(|| panic!("no cube of {edge} m"))
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

    /// Puts a free body like this into the world, at rest, but of `mass`, kg.
    pub fn insert(&self, world: &mut World, mass: f64, world_from_body: &Pose) -> BodyId {
        let motion = Motion::Free { mass };
        let body = world.insert(motion, world_from_body, self.friction, &self.parts);
        world.set_inertia(body, &self.inertia.with_mass(mass));
        body
    }

    /// The same model, `size` times as large.
    pub fn scaled(&self, size: f64) -> Scaled<'_> {
        Scaled { model: self, size }
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
        self.scaled(1.0).aabb(world_from_body)
    }

    /// Reads a model of one body; its other links are frames fixed to it.
    pub fn from_urdf(urdf: &str) -> Result<Self, ModelError> {
        let robot = parse(urdf)?;
        let mut placed = placed(&robot)?;
        match placed.pop() {
            Some(only) if placed.is_empty() => Ok(only.model),
            _ => Err(ModelError::NotAModel(format!(
                "{} has several bodies; read it as a scene",
                robot.name
            ))),
        }
    }

    /// A model that is part of the program.
    ///
    /// # Panics
    /// Where `urdf` is no model: tests read them all.
    fn read(urdf: &str) -> Self {
        Self::from_urdf(urdf).unwrap_or_else(|error| panic!("{error}"))
    }
}

/// A model in another size: shapes, frames and inertia are those of a body of the same density.
#[derive(Debug, Clone, Copy)]
pub struct Scaled<'a> {
    model: &'a Model,
    size: f64,
}

impl<'a> Scaled<'a> {
    /// How many times as large as the model it is.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// The model, `size` times as large, whatever the size of this.
    #[must_use]
    pub fn resized(&self, size: f64) -> Self {
        Self { size, ..*self }
    }

    /// Its collision shapes.
    pub fn parts(&self) -> impl Iterator<Item = Part> + use<'a> {
        let size = self.size;
        self.model.parts.iter().map(move |part| part.scaled(size))
    }

    /// What is seen of it, each with where it is in the body.
    pub fn visuals(&self) -> impl Iterator<Item = (&'a Visual, Pose)> + use<'a> {
        let size = self.size;
        let visuals = self.model.visuals.iter();
        visuals.map(move |visual| (visual, frames::scaled(&visual.body_from_visual, size)))
    }

    /// How its mass is spread.
    pub fn inertia(&self) -> Inertia {
        self.model.inertia.with_size(self.size)
    }

    /// The frame `name`, see [`Model::body_from`].
    pub fn body_from(&self, name: &str) -> Pose {
        frames::scaled(&self.model.body_from(name), self.size)
    }

    /// The box around its collision shapes when it is at `world_from_body`, m.
    pub fn aabb(&self, world_from_body: &Pose) -> Aabb {
        let boxes = self.parts().map(|part| part.aabb(world_from_body));
        boxes.reduce(|one, other| one.merged(&other)).expect("a model has collision shapes")
    }
}

/// A part of what is seen of a body.
#[derive(Debug, Clone)]
pub struct Visual {
    /// Its form.
    pub form: Form,
    /// Where it is in the body.
    pub body_from_visual: Pose,
    /// Its look.
    pub material: Material,
}

/// Why a URDF was not read.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// It is no URDF.
    #[error("no URDF: {0}")]
    Urdf(#[from] urdf_rs::UrdfError),
    /// It holds what no model or scene has.
    #[error("URDF: {0}")]
    NotAModel(String),
}

impl From<ModelError> for Rejection {
    fn from(error: ModelError) -> Self {
        Self::new(Code::Internal, "scene", "a URDF of the task", error.to_string())
    }
}

/// Several bodies and where they are at first; lengths in m.
///
/// A link with collision shapes is a body. The first link and those on `fixed` joints never move;
/// those on `floating` joints are free objects of the mass that they state. Other links are frames.
#[derive(Debug, Clone)]
pub struct Scene {
    placed: Vec<Placed>,
}

/// A body of a scene.
#[derive(Debug, Clone)]
struct Placed {
    name: String,
    model: Model,
    is_free: bool,
    scene_from_body: Pose,
}

impl Scene {
    /// Reads a scene.
    pub fn from_urdf(urdf: &str) -> Result<Self, ModelError> {
        Ok(Self { placed: placed(&parse(urdf)?)? })
    }

    /// Puts every body into the world, with the same coefficient of friction; gives them by name.
    pub fn insert(&self, world: &mut World, friction: f64) -> BTreeMap<&str, BodyId> {
        let insert = |placed: &'_ Placed| {
            let motion = if placed.is_free {
                Motion::Free { mass: placed.model.mass }
            } else {
                Motion::Fixed
            };
            world.insert(motion, &placed.scene_from_body, friction, &placed.model.parts)
        };
        let ids: Vec<_> = self.placed.iter().map(insert).collect();
        self.placed.iter().map(|placed| placed.name.as_str()).zip(ids).collect()
    }

    /// The model of the body `name`, and where it is at first.
    ///
    /// # Panics
    /// Where the scene has no such body.
    pub fn body(&self, name: &str) -> (&Model, Pose) {
        let found = self.placed.iter().find(|placed| placed.name == name);
        let found = found.unwrap_or_else(|| panic!("the scene has no body {name:?}"));
        (&found.model, found.scene_from_body)
    }
}

fn parse(urdf: &str) -> Result<Robot, ModelError> {
    Ok(urdf_rs::read_from_string(urdf)?)
}

/// The bodies of a URDF, each with the frames that are fixed to it.
fn placed(robot: &Robot) -> Result<Vec<Placed>, ModelError> {
    let wrong = |what: &str, why: &str| Err(ModelError::NotAModel(format!("{what} {why}")));
    let mut bodies: Vec<Placed> = vec![];
    let mut frames = vec![];
    for link in &robot.links {
        let joint = robot.joints.iter().find(|joint| joint.child.link == link.name);
        let is_free = joint.is_some_and(|joint| joint.joint_type == JointType::Floating);
        if let Some(joint) = joint
            && !matches!(joint.joint_type, JointType::Floating | JointType::Fixed)
        {
            return wrong(&joint.name, "is no joint of a scene: allowed are fixed and floating");
        }
        if link.collision.is_empty() {
            let Some(joint) = joint else { return wrong(&link.name, "has no collision shapes") };
            frames.push((joint.parent.link.clone(), link.name.clone(), pose(&joint.origin)?));
            continue;
        }
        let scene_from_body = match joint {
            None => Pose::identity(),
            Some(joint) => {
                let parent = bodies.iter().find(|body| body.name == joint.parent.link);
                let Some(parent) = parent else { return wrong(&joint.name, "hangs on no body") };
                parent.scene_from_body * pose(&joint.origin)?
            }
        };
        let shapes = link.collision.iter();
        let parts = shapes.map(|shape| part(&shape.geometry, &shape.origin));
        let parts = parts.collect::<Result<Vec<_>, _>>()?;
        let outline = parts.iter().map(|part| part.aabb(&Pose::identity()));
        let outline = outline.reduce(|all, part| all.merged(&part)).expect("it has a shape");
        let inertia = inertia(&link.inertial, outline.extents().max())?;
        let mass = inertia.mass;
        if is_free && mass <= 0.0 {
            return wrong(&link.name, "is free and needs a mass");
        }
        let material = link.visual.first().and_then(|visual| visual.material.as_ref());
        let friction = material.and_then(|material| friction_of(&material.name));
        let friction = friction.unwrap_or(UNKNOWN_FRICTION);
        let visuals = visuals(&robot.name, link)?;
        let model = Model { parts, mass, inertia, friction, visuals, frames: vec![] };
        bodies.push(Placed { name: link.name.clone(), model, is_free, scene_from_body });
    }
    for (body, name, pose) in frames {
        match bodies.iter_mut().find(|placed| placed.name == body) {
            Some(placed) => placed.model.frames.push((name, pose)),
            None => return wrong(&name, "hangs on no body"),
        }
    }
    if bodies.is_empty() { wrong(&robot.name, "has no body") } else { Ok(bodies) }
}

/// What is seen of a link of the URDF in the folder `folder` of `assets/`: its visual parts; its collision
/// shapes where it has none, or where their meshes are not part of the program.
pub(crate) fn visuals(folder: &str, link: &urdf_rs::Link) -> Result<Vec<Visual>, ModelError> {
    let look = |material: Option<&urdf_rs::Material>| {
        let named = material.and_then(|material| Material::find(&material.name));
        let colour =
            material.and_then(|material| material.color.as_ref()).map(|colour| *colour.rgba);
        named.unwrap_or_else(|| match colour {
            Some([red, green, blue, _]) => {
                Material::named("foam").coloured([red, green, blue].map(|part| part as f32))
            }
            None => Material::named("tray"),
        })
    };
    let seen = |visual: &urdf_rs::Visual| -> Option<Visual> {
        let form = match &visual.geometry {
            Geometry::Mesh { filename, scale: None } => {
                Form::embedded(&match filename.strip_prefix("../") {
                    Some(borrowed) => borrowed.into(),
                    None => format!("{folder}/{filename}"),
                })?
            }
            other => {
                let part = part(other, &visual.origin).ok()?;
                return Some(made(&part, look(visual.material.as_ref())));
            }
        };
        let material = look(visual.material.as_ref());
        Some(Visual { form, body_from_visual: pose(&visual.origin).ok()?, material })
    };
    let all: Option<Vec<_>> = link.visual.iter().map(seen).collect();
    if let Some(visuals) = all.filter(|visuals| !visuals.is_empty()) {
        return Ok(visuals);
    }
    let material = look(link.visual.first().and_then(|visual| visual.material.as_ref()));
    let shown = |collision: &urdf_rs::Collision| -> Result<Visual, ModelError> {
        Ok(made(&part(&collision.geometry, &collision.origin)?, material))
    };
    link.collision.iter().map(shown).collect()
}

fn made(part: &Part, material: Material) -> Visual {
    let form = Form::Made(std::sync::Arc::new(Mesh::of_shape(&part.shape)));
    Visual { form, body_from_visual: part.body_from_part, material }
}

/// Friction coefficient of a material that the table does not have.
const UNKNOWN_FRICTION: f64 = 0.5;

/// The friction coefficient that the table of materials gives, with its source.
fn friction_of(material: &str) -> Option<f64> {
    /// Column of the table.
    const FRICTION: usize = 5;
    let table = include_str!("../../assets/materials.csv");
    let mut rows = table.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let row = rows.find(|row| row[0] == material)?;
    Some(row[FRICTION].parse().expect("friction is a number"))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

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
        let block = friction_of("block").unwrap();
        assert!((block - Model::block().friction).abs() < 1e-12);
    }

    #[test]
    fn the_pad_lies_in_the_tray() {
        let (pad, tray) = (Model::pad(), Model::tray());
        let (pad, tray) = (pad.aabb(&Pose::identity()), tray.aabb(&Pose::identity()));
        assert_eq!(pad.merged(&tray), tray);
        assert!((pad.max.z - 0.0062).abs() < 1e-9);
    }

    #[test]
    fn a_scene_has_fixed_and_free_bodies_and_frames() {
        let scene = Scene::from_urdf(SCENE).unwrap();
        let mut world = World::new(crate::sim::world::Solver::LIGHT);
        let bodies = scene.insert(&mut world, 1.0);
        assert_eq!(bodies.keys().collect::<Vec<_>>(), [&"ball", &"floor", &"step"]);
        let (ball, start) = scene.body("ball");
        let off = world.pose(bodies["ball"]).translation.vector - start.translation.vector;
        assert!(off.norm() < 1e-8);
        assert!((start.translation.z - 0.03).abs() < 1e-12);
        assert_eq!(ball.mass, 0.001);
        assert_eq!(ball.body_from("top").translation.z, 0.01);
        world.wake(bodies["ball"]);
        world.advance();
        assert!(world.pose(bodies["ball"]).translation.z < start.translation.z);
        assert!((world.pose(bodies["step"]).translation.z - 0.01).abs() < 1e-8);
    }

    #[test]
    fn what_is_no_model_is_refused_with_a_reason() {
        let refused = |urdf: &str| Model::from_urdf(urdf).unwrap_err().to_string();
        assert!(refused("<robot").contains("no URDF"));
        assert!(refused(SCENE).contains("several bodies"));
        let changed = |from: &str, to: &str| {
            assert!(SCENE.contains(from));
            Scene::from_urdf(&SCENE.replace(from, to)).unwrap_err().to_string()
        };
        assert!(changed("\"floating\"", "\"revolute\"").contains("fixed and floating"));
        assert!(changed("<mass value=\"0.001\"/>", "<mass value=\"0\"/>").contains("a mass"));
        assert!(
            changed("<capsule radius=\"0.005\" length=\"0.002\"", "<sphere radius=\"0.005\"")
                .contains("boxes, capsules and")
        );
        assert!(changed("<parent link=\"ball\"/>", "<parent link=\"top\"/>").contains("no body"));
    }

    #[test]
    fn moments_of_inertia_that_are_next_to_nothing_are_those_of_something_thin() {
        let ball = |inertia: &str| {
            let urdf = format!(
                r#"<robot name="ball"><link name="ball"><inertial><mass value="0.001"/>
                <inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial>
                <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link></robot>"#
            );
            Model::from_urdf(&urdf).unwrap().inertia.moments.diagonal()
        };
        assert_eq!(ball(r#"ixx="1e-6" iyy="2e-6" izz="2e-6""#).x, 1e-6);
        assert!((ball(r#"ixx="5e-32" iyy="2e-6" izz="2e-6""#).x - 2e-10).abs() < 1e-20);
        assert!(
            (ball(r#"ixx="5e-32" iyy="5e-32" izz="5e-32""#) / 1e-11)
                .iter()
                .all(|m| (m - 1.0).abs() < 1e-9)
        );
        assert_eq!(ball(r#"ixx="0" iyy="0" izz="0""#).norm(), 0.0);
    }

    #[test]
    fn numbers_with_which_the_engine_cannot_compute_are_refused_by_what_they_are() {
        let changed = |from: &str, to: &str| {
            assert!(SCENE.contains(from));
            Scene::from_urdf(&SCENE.replace(from, to)).unwrap_err().to_string()
        };
        for (from, to, what) in [
            ("size=\"0.1 0.1", "size=\"0.1 -0.1", "edge of -0.1"),
            ("size=\"0.1 0.1", "size=\"0.1 NaN", "edge of NaN"),
            ("radius=\"0.005\"", "radius=\"1e30\"", "radius of 1"),
            ("length=\"0.002\"", "length=\"inf\"", "length of inf"),
            ("xyz=\"0.04 0", "xyz=\"1e9 0", "place of 1"),
            ("value=\"0.001\"", "value=\"NaN\"", "mass of NaN"),
            ("value=\"0.001\"", "value=\"1e-40\"", "mass of 0.0"),
            ("ixx=\"1\"", "ixx=\"5e208\"", "moment of inertia of 5"),
            ("ixx=\"1\"", "ixx=\"-1\"", "moment of inertia of -1"),
            ("ixy=\"0\"", "ixy=\"3\"", "principal moment"),
        ] {
            let refusal = changed(from, to);
            assert!(refusal.contains(what), "{to}: {refusal}");
        }
    }

    const SCENE: &str = r#"<robot name="test">
      <link name="floor">
        <collision><geometry><box size="0.1 0.1 0.01"/></geometry></collision>
      </link>
      <link name="step">
        <collision><geometry><box size="0.02 0.02 0.01"/></geometry></collision>
      </link>
      <link name="ball">
        <inertial><mass value="0.001"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
        <collision><geometry><capsule radius="0.005" length="0.002"/></geometry></collision>
      </link>
      <link name="top"/>
      <joint name="a" type="fixed">
        <parent link="floor"/><child link="step"/><origin xyz="0.04 0 0.01"/>
      </joint>
      <joint name="b" type="floating">
        <parent link="step"/><child link="ball"/><origin xyz="0 0 0.02"/>
      </joint>
      <joint name="c" type="fixed">
        <parent link="ball"/><child link="top"/><origin xyz="0 0 0.01"/>
      </joint>
    </robot>"#;
}
