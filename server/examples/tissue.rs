//! A task of one's own with tissue: PSM1 presses on a lobe of liver that lies in the tray.
//!
//! ```sh
//! cargo run --release --example tissue -- own     # serves as "own" until Ctrl-C
//! ```
//!
//! Python then has it after `trocar.register_all(server="own")`, as `gym.make("trocar/PressLiver-v0")`. Its pictures,
//! masks, depths and points show the lobe as it is deformed.

use std::sync::Arc;

use anyhow::Context;
use nalgebra::{Point3, Vector3};
use trocar_proto::builtin::TaskInfo;
use trocar_proto::spec::{Element, OptionSpec};
use trocar_proto::{Options, Rejection};
use trocar_server::assets::Model;
use trocar_server::render::Scene;
use trocar_server::sim::frames::{self, Aabb, Pose};
use trocar_server::sim::instrument::{JAW_CLOSED, TIP_OFFSET};
use trocar_server::sim::random::Rng;
use trocar_server::sim::soft::{Form, Material, MaterialPoint, Skin, SoftBody};
use trocar_server::sim::world::{SoftId, World};
use trocar_server::tasks::expert::{ArmView, ExpertInput};
use trocar_server::tasks::options::{self, Preset};
use trocar_server::tasks::psm_scene::{PaperAction, PsmArm, Station, Turn};
use trocar_server::tasks::{Arms, Registered, State, theatre, tray};
use trocar_server::{Registry, ServerConfig, StopSignal, Task, serve};

/// Half the lobe's lengths, m.
const HALF: Vector3<f64> = Vector3::new(0.022, 0.016, 0.008);

/// Edge of an element, m.
const SPACING: f64 = 4e-3;

/// Where the top of the lobe is observed, m.
const THEATRE: Aabb = Aabb::new([0.4, -0.2, 0.6], [0.7, 0.2, 0.8]);

/// How far the expert presses, m.
const DEPTH: f64 = 4e-3;

/// A lobe of liver with its middle at `at`.
fn insert_lobe(world: &mut World, at: &Pose) -> (SoftId, MaterialPoint) {
    let distance = |point: &Point3<f64>| {
        let shrunk = point.coords.component_div(&HALF);
        (shrunk.norm() - 1.0) * HALF.min()
    };
    let bounds = Aabb { min: -HALF, max: HALF };
    let liver = Material::named("liver").expect("it is in assets/materials.csv");
    let form = Form::carved(&bounds, SPACING, liver, distance).expect("4 mm suit liver");
    let skin = Skin::new(&form, &bounds, SPACING, distance);
    let top = MaterialPoint::of(&form, &Point3::new(0.0, 0.0, HALF.z));
    let body = SoftBody::new("liver", [0.52, 0.16, 0.13], Arc::new(form), Arc::new(skin), at);
    (world.insert_soft(body), top)
}

/// The task.
#[derive(Clone)]
struct PressLiver {
    arm: PsmArm,
    lobe: SoftId,
    /// The point of its skin on which the expert presses, and where that is at rest, m.
    top: MaterialPoint,
    rest: Vector3<f64>,
}

impl Registered for PressLiver {
    const INFO: TaskInfo = TaskInfo {
        id: "PressLiver-v0",
        summary: "Press on a lobe of liver.",
        steps: 15,
        hertz: 5.0,
        tags: &[],
    };

    fn options() -> Vec<OptionSpec> {
        vec![options::action(), options::observation(), options::domain()]
    }

    fn new(options: &Options) -> Result<(Self, World), Rejection> {
        let mut world = tray::bare_table(Preset::Paper);
        tray::furnish(&mut world, Model::tray(), tray::scene_from_tray().translation.vector.into());
        let floor = tray::pad().min.z;
        let (lobe, top) =
            insert_lobe(&mut world, &frames::pose([0.55, 0.0, floor + HALF.z], [0.0; 3]));
        while !world.at_rest() {
            world.advance();
        }
        let rest = world.soft(lobe).lattice().point(&top).coords;
        let paper = PaperAction { turn: Turn::Nothing, jaw: false };
        let station = Station::psm1([0.53, 0.02, 0.72 + TIP_OFFSET], floor);
        let arm = PsmArm::insert(&mut world, options, paper, station)?;
        Ok((Self { arm, lobe, top, rest }, world))
    }
}

impl Task for PressLiver {
    fn action(&self) -> Vec<Element> {
        self.arm.action_elements()
    }

    fn reset(&mut self, world: &mut World, rng: &mut Rng) {
        self.arm.reset(world, rng);
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.arm.command(action);
    }

    fn arms(&mut self) -> Arms<'_> {
        [&mut self.arm].into_iter().collect()
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        self.arm.state(world, state);
        let top = world.soft(self.lobe).lattice().point(&self.top).coords;
        state.position("top", "scene", &THEATRE, Preset::Paper, &top);
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        theatre::draw(scene, self.arm.model());
        tray::draw_tray(scene);
        self.arm.draw(world, scene);
    }

    fn expert(&self, world: &World, input: &ExpertInput<'_>, action: &mut [f32]) {
        let [arm] = ArmView::of([&self.arm], world, input);
        let tip = (arm.aim * Pose::translation(0.0, 0.0, TIP_OFFSET)).translation.vector;
        let mut way = self.rest - Vector3::z() * DEPTH - tip;
        if way.xy().norm() > 1e-3 {
            way.z = 0.0;
        }
        arm.act(&(Pose::from(way) * arm.aim), JAW_CLOSED, action);
    }
}

fn main() -> anyhow::Result<()> {
    let name = std::env::args().nth(1).context("usage: tissue SERVER_NAME")?;
    let mut registry = Registry::builtin();
    registry.register::<PressLiver>();
    let stop = StopSignal::default();
    let on_signal = stop.clone();
    ctrlc::set_handler(move || on_signal.set())?;
    serve(registry, &ServerConfig::new(name.parse()?), &stop, || {
        eprintln!("PressLiver-v0 is served as {name:?}; Ctrl-C ends it");
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use trocar_proto::OptionValue;
    use trocar_server::Env;
    use trocar_server::env::Pictures;
    use trocar_server::render::Lens;
    use trocar_server::sim::world::NonRigid;

    use super::*;

    fn env() -> Env {
        let mut registry = Registry::empty();
        registry.register::<PressLiver>();
        let words = ["state", "depth", "mask", "points"].map(String::from).to_vec();
        let options = Options::new().with("observation", OptionValue::Texts(words));
        let mut env = registry.make(PressLiver::INFO.id, &options).unwrap();
        env.reset(Some(1));
        env
    }

    fn press(env: &mut Env) {
        let mut action = vec![0.0; env.spec().action_dim()];
        while !env.needs_reset() {
            env.expert(&mut action);
            env.step(&action).unwrap();
        }
    }

    fn skin(env: &Env) -> Vec<Point3<f64>> {
        env.world().others().next().unwrap().surface().vertices
    }

    #[test]
    fn the_lobe_gives_way_and_all_pictures_show_it_where_it_then_is() {
        let mut env = env();
        let (before, pictures) = (skin(&env), Pictures::of(&env));
        press(&mut env);
        let sunk =
            before.iter().zip(skin(&env)).map(|(from, to)| from.z - to.z).fold(0.0, f64::max);
        assert!((1e-3..2.0 * DEPTH).contains(&sunk), "{sunk} m");

        let images = env.spec().images.clone().unwrap();
        let liver = images.bodies.iter().position(|body| body == "liver").unwrap() as i32 + 1;
        let seen = Pictures::of(&env);
        assert_ne!(seen.depth, pictures.depth);
        let camera = env.scene().camera(Lens::Endoscope, images.width, images.height).unwrap();
        let skin = skin(&env);
        let mut pixels = 0;
        for (point, _) in seen.points.chunks(3).zip(&seen.mask).filter(|(_, body)| **body == liver)
        {
            let [x, y, z] = [0, 1, 2].map(|axis| f64::from(point[axis]));
            let at = camera.world_from_camera * Point3::new(x, y, z);
            let nearest = skin.iter().map(|vertex| (vertex - at).norm()).fold(1.0, f64::min);
            assert!(nearest < SPACING, "{nearest} m from the nearest vertex");
            pixels += 1;
        }
        assert!(pixels > 200, "{pixels} pixels of the lobe");
    }

    #[test]
    fn a_snapshot_goes_on_with_the_same_bits() {
        let mut env = env();
        let mut action = vec![0.0; env.spec().action_dim()];
        for _ in 0..8 {
            env.expert(&mut action);
            env.step(&action).unwrap();
        }
        let mut copy = env.import(&env.export().unwrap()).unwrap();
        [&mut env, &mut copy].into_iter().for_each(press);
        assert!(env.world().bits().eq(copy.world().bits()));
        assert!(env.world().others().all(NonRigid::is_finite));
    }
}
