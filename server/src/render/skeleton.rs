//! The links of an arm as its URDF has them: where each is at given joints, and what is seen of it.

use std::sync::LazyLock;

use nalgebra::{UnitQuaternion, Vector3};
use urdf_rs::{JointType, Robot};

use super::scene::Scene;
use crate::assets::{self, ModelError, Visual};
use crate::robots::ArmModel;
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
    /// A PSM with its Large Needle Driver.
    pub fn psm(model: ArmModel) -> &'static Self {
        static CLASSIC: LazyLock<Skeleton> =
            LazyLock::new(|| Skeleton::read(include_str!("../../../assets/psm/model.urdf")));
        static SI: LazyLock<Skeleton> =
            LazyLock::new(|| Skeleton::read(include_str!("../../../assets/psm_si/model.urdf")));
        match model {
            ArmModel::Classic => &CLASSIC,
            ArmModel::Si => &SI,
        }
    }

    /// An ECM with its straight endoscope.
    pub fn ecm(model: ArmModel) -> &'static Self {
        static CLASSIC: LazyLock<Skeleton> =
            LazyLock::new(|| Skeleton::read(include_str!("../../../assets/ecm/model.urdf")));
        static SI: LazyLock<Skeleton> =
            LazyLock::new(|| Skeleton::read(include_str!("../../../assets/ecm_si/model.urdf")));
        match model {
            ArmModel::Classic => &CLASSIC,
            ArmModel::Si => &SI,
        }
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
                    (Some(parent), assets::pose(&joint.origin)?, drive)
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
    use crate::render::mesh::Form;
    use crate::robots::{Ecm, Endoscope, Psm};

    /// Values of an arm's joints by name, in the order of `q`.
    fn named(q: &[f64]) -> impl Fn(&str) -> f64 {
        let names = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"];
        move |name| names.iter().zip(q).find(|(other, _)| **other == name).map_or(0.0, |(_, q)| *q)
    }

    /// Where a body of a scene is drawn, m.
    fn place(scene: &Scene, name: &str) -> Vector3<f64> {
        let body = scene.body(name).unwrap();
        let found = scene.instances().iter().find(|each| each.body == body).unwrap();
        found.world_from_mesh.translation.vector
    }

    #[test]
    fn links_are_where_the_kinematics_have_them() {
        let base = Pose::translation(0.1, 0.2, 0.3);
        let q = [0.3, -0.2, 0.15, 0.5, 0.4, -0.6];
        for model in [ArmModel::Classic, ArmModel::Si] {
            let mut scene = Scene::default();
            Skeleton::psm(model).draw(&mut scene, "psm1", &base, named(&q), |_| None);
            let wrist = base * Psm::new(model).base_from_wrist(&q);
            let axle = place(&scene, "psm1 wrist_yaw_link");
            assert!((axle - wrist.translation.vector).norm() < 1e-9, "{model:?}");
            // The shaft's frame tells the generations apart: it is as far back as the shaft is long.
            let [_, _, insertion, ..] = Psm::new(model).base_from_links(&q);
            let carriage = place(&scene, "psm1 insertion_link");
            let expected = (base * insertion).translation.vector;
            assert!((carriage - expected).norm() < 1e-9, "{model:?}");

            let mut scene = Scene::default();
            Skeleton::ecm(model).draw(&mut scene, "ecm", &base, named(&q), |_| None);
            let ecm = Ecm::new(model, Endoscope::Straight);
            let camera = base * ecm.base_from_camera(&[q[0], q[1], q[2], q[3]]);
            let roll = place(&scene, "ecm roll_link");
            assert!((roll - camera.translation.vector).norm() < 1e-9, "{model:?}");
        }
    }

    #[test]
    fn nothing_of_an_arm_is_shown_as_its_collision_shapes() {
        for model in [ArmModel::Classic, ArmModel::Si] {
            let links = [Skeleton::psm(model), Skeleton::ecm(model)].map(|arm| &arm.links);
            let mut visuals = links.into_iter().flatten().flat_map(|link| &link.visuals);
            let is_mesh = |visual: &Visual| matches!(visual.form, Form::Embedded(_));
            assert!(visuals.all(is_mesh), "{model:?}");
        }
    }

    #[test]
    fn a_link_can_be_put_elsewhere() {
        let there = Pose::translation(1.0, 2.0, 3.0);
        let mut scene = Scene::default();
        let jaw = |name: &str| (name == "jaw_1_link").then_some(there);
        Skeleton::psm(ArmModel::Classic).draw(&mut scene, "psm1", &Pose::identity(), |_| 0.0, jaw);
        let body = scene.body("psm1 jaw_1_link").unwrap();
        let found = scene.instances().iter().find(|each| each.body == body).unwrap();
        assert_eq!(found.world_from_mesh, there);
    }
}
