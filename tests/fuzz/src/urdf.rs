//! URDFs of objects: models, scenes, and a world with them.

use trocar_server::assets::{Model, Scene};
use trocar_server::sim::frames::Pose;
use trocar_server::sim::world::{Solver, World};

/// A URDF.
pub(crate) fn run(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    let model = Model::from_urdf(&text);
    let scene = match Scene::from_urdf(&text) {
        Ok(scene) => scene,
        Err(error) => {
            assert!(model.is_err(), "a model is a scene of one body");
            return assert!(!error.to_string().is_empty());
        }
    };
    let mut world = World::new(Solver::HEAVY);
    let bodies = scene.insert(&mut world, 0.5).len();
    assert!(bodies > 0);
    if let Ok(model) = model {
        let bounds = model.aabb(&Pose::identity());
        assert!(bounds.extents().iter().all(|extent| extent.is_finite()));
        if model.mass > 0.0 {
            model.insert(&mut world, model.mass, &Pose::translation(0.0, 0.0, 1.0));
        }
    }
    for _ in 0..3 {
        world.advance();
    }
    assert!(world.is_finite(), "what is read can be simulated");
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let models = [
        include_str!("../../../assets/needle/model.urdf"),
        include_str!("../../../assets/gauze/model.urdf"),
        include_str!("../../../assets/block/model.urdf"),
        include_str!("../../../assets/cube/model.urdf"),
        include_str!("../../../assets/tray/model.urdf"),
        include_str!("../../../assets/ecm/model.urdf"),
    ];
    models.iter().chain(&[SCENE]).map(|text| text.as_bytes().to_vec()).collect()
}

/// Every sort of joint, shape and colour in one scene.
const SCENE: &str = r#"<robot name="bench">
<link name="top"><collision><origin xyz="0 0 1" rpy="0 0.1 0"/><geometry><box size="1 1 .1"/></geometry></collision></link>
<link name="ball"><inertial><origin xyz="0 0 .1"/><mass value="0.02"/><inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/></inertial>
<visual><geometry><box size=".02 .02 .02"/></geometry><material name="steel"><color rgba="1 0 0 1"/></material></visual>
<collision><geometry><capsule radius=".01" length=".02"/></geometry></collision></link>
<link name="grip"/>
<joint name="a" type="floating"><parent link="top"/><child link="ball"/><origin xyz="0 0 1.2"/></joint>
<joint name="b" type="fixed"><parent link="ball"/><child link="grip"/><origin xyz="0 0 .01"/></joint>
</robot>"#;
