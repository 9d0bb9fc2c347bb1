//! The links of an arm as its URDF has them: where each is at given joints, and what is seen of it.

use std::sync::LazyLock;

use nalgebra::{UnitQuaternion, Vector3};
use urdf_rs::{JointType, Robot};

use super::scene::Scene;
use crate::assets::{self, ModelError, Visual};
use crate::sim::frames::Pose;

/// A tree of links. Every joint turns about or slides along its z axis.
#[derive(Debug)]
pub struct Skeleton {
    /// Parents before children.
    links: Vec<Link>,
}

#[derive(Debug)]
struct Link {
    name: String,
    parent: Option<usize>,
    parent_from_joint: Pose,
    drive: Drive,
    visuals: Vec<Visual>,
}

#[derive(Debug)]
enum Drive {
    Fixed,
    /// Turns by so many times the value of a joint.
    Turns(String, f64),
    /// Slides by the value of a joint.
    Slides(String),
}

impl Skeleton {
    /// The PSM Classic with its Large Needle Driver.
    pub fn psm() -> &'static Self {
        static PSM: LazyLock<Skeleton> =
            LazyLock::new(|| Skeleton::read(include_str!("../../../assets/psm/model.urdf")));
        &PSM
    }

    /// The ECM Classic with its straight endoscope.
    pub fn ecm() -> &'static Self {
        static ECM: LazyLock<Skeleton> =
            LazyLock::new(|| Skeleton::read(include_str!("../../../assets/ecm/model.urdf")));
        &ECM
    }

    /// An arm that is part of the program.
    ///
    /// # Panics
    /// Where `urdf` is no arm: tests read them all.
    fn read(urdf: &str) -> Self {
        let robot = urdf_rs::read_from_string(urdf).map_err(ModelError::from);
        robot.and_then(|robot| Self::of(&robot)).unwrap_or_else(|error| panic!("{error}"))
    }

    fn of(robot: &Robot) -> Result<Self, ModelError> {
        let mut links: Vec<Link> = vec![];
        for link in &robot.links {
            let joint = robot.joints.iter().find(|joint| joint.child.link == link.name);
            let wrong = |why: &str| ModelError::NotAModel(format!("{} {why}", link.name));
            let (parent, parent_from_joint, drive) = match joint {
                None => (None, Pose::identity(), Drive::Fixed),
                Some(joint) => {
                    let parent = links.iter().position(|link| link.name == joint.parent.link);
                    let parent = parent.ok_or_else(|| wrong("comes before its parent"))?;
                    let (leader, ratio) = match &joint.mimic {
                        Some(mimic) => (mimic.joint.clone(), mimic.multiplier.unwrap_or(1.0)),
                        None => (joint.name.clone(), 1.0),
                    };
                    let drive = match joint.joint_type {
                        JointType::Revolute => Drive::Turns(leader, ratio),
                        JointType::Prismatic => Drive::Slides(leader),
                        JointType::Fixed => Drive::Fixed,
                        _ => return Err(wrong("hangs on a joint that no arm has")),
                    };
                    (Some(parent), assets::pose(&joint.origin), drive)
                }
            };
            let visuals = if link.visual.is_empty() {
                vec![] // a frame: collision shapes of links without looks are not shown
            } else {
                assets::visuals(&robot.name, link)?
            };
            let name = link.name.clone();
            links.push(Link { name, parent, parent_from_joint, drive, visuals });
        }
        Ok(Self { links })
    }

    /// Adds each link that can be seen to a scene as a body, `arm` and the link's name. `joint` gives the
    /// values of the joints by name, rad or m; `elsewhere` places a link that is not where they say.
    pub fn draw(
        &self,
        scene: &mut Scene,
        arm: &str,
        world_from_base: &Pose,
        joint: impl Fn(&str) -> f64,
        elsewhere: impl Fn(&str) -> Option<Pose>,
    ) {
        let mut poses: Vec<Pose> = Vec::with_capacity(self.links.len());
        for link in &self.links {
            let parent = link.parent.map_or(*world_from_base, |parent| poses[parent]);
            let at = parent * link.parent_from_joint;
            let moved = match &link.drive {
                Drive::Fixed => at,
                Drive::Slides(name) => at * Pose::translation(0.0, 0.0, joint(name)),
                Drive::Turns(name, ratio) => {
                    let turn = ratio * joint(name);
                    at * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)
                }
            };
            let pose = elsewhere(&link.name).unwrap_or(moved);
            poses.push(pose);
            if !link.visuals.is_empty() {
                scene.begin(format!("{arm} {}", link.name));
                scene.draw_visuals(&link.visuals, &pose);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robots::{Ecm, Psm};

    #[test]
    fn links_are_where_the_kinematics_have_them() {
        let base = Pose::translation(0.1, 0.2, 0.3);
        let q = [0.3, -0.2, 0.15, 0.5, 0.4, -0.6];
        let names = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"];
        let value =
            |name: &str| names.iter().position(|other| *other == name).map_or(0.0, |at| q[at]);
        let mut scene = Scene::default();
        Skeleton::psm().draw(&mut scene, "psm1", &base, value, |_| None);
        let at = |scene: &Scene, name: &str| {
            let body = scene.body(name).unwrap();
            scene.instances().iter().find(|each| each.body == body).unwrap().world_from_mesh
        };
        let wrist = base * Psm::CLASSIC.base_from_wrist(&q);
        let axle = at(&scene, "psm1 wrist_yaw_link");
        assert!((axle.translation.vector - wrist.translation.vector).norm() < 1e-9);

        let mut scene = Scene::default();
        Skeleton::ecm().draw(&mut scene, "ecm", &base, value, |_| None);
        let camera = base * Ecm::CLASSIC.base_from_camera(&[q[0], q[1], q[2], q[3]]);
        let roll = at(&scene, "ecm roll_link");
        assert!((roll.translation.vector - camera.translation.vector).norm() < 1e-9);
    }

    #[test]
    fn a_link_can_be_put_elsewhere() {
        let there = Pose::translation(1.0, 2.0, 3.0);
        let mut scene = Scene::default();
        let jaw = |name: &str| (name == "jaw_1_link").then_some(there);
        Skeleton::psm().draw(&mut scene, "psm1", &Pose::identity(), |_| 0.0, jaw);
        let body = scene.body("psm1 jaw_1_link").unwrap();
        let found = scene.instances().iter().find(|each| each.body == body).unwrap();
        assert_eq!(found.world_from_mesh, there);
    }
}
