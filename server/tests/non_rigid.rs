//! Bodies of another kind than rigid join a world: a rope of point masses that falls onto a floor.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_proto::builtin::TaskInfo;
use trocar_proto::spec::{Element, OptionSpec};
use trocar_proto::{Options, Rejection};
use trocar_server::error::StepError;
use trocar_server::render::{Lens, Renderer, Scene, Software};
use trocar_server::sim::frames::{Aabb, Pose};
use trocar_server::sim::random::Rng;
use trocar_server::sim::world::{
    GRAVITY, Motion, NonRigid, Part, RestSurface, Shape, Solver, Surface, World,
};
use trocar_server::tasks::expert::ExpertInput;
use trocar_server::tasks::{Registered, State, options};
use trocar_server::view::message::{self, Message, SceneEncoder};
use trocar_server::view::source::Moment;
use trocar_server::{Env, Registry, Task};

/// Height from which the rope falls, m.
const HEIGHT: f64 = 0.05;

/// Point masses side by side, each falling by itself, that stop on the floor, z = 0.
#[derive(Clone)]
struct Rope {
    points: Vec<Point3<f64>>,
    velocities: Vec<Vector3<f64>>,
}

impl Rope {
    fn new(length: usize) -> Self {
        let point = |index: usize| Point3::new(0.005 * index as f64, 0.0, HEIGHT);
        Self {
            points: (0..length).map(point).collect(),
            velocities: vec![Vector3::zeros(); length],
        }
    }
}

impl NonRigid for Rope {
    fn advance(&mut self, world: &mut World, seconds: f64) {
        assert!(world.others().next().is_none(), "it is not beside itself");
        for (point, velocity) in self.points.iter_mut().zip(&mut self.velocities) {
            // Leapfrog: the height falls by ½·g·t² exactly.
            point.z += (velocity.z - 0.5 * GRAVITY * seconds) * seconds;
            velocity.z -= GRAVITY * seconds;
            if point.z <= 0.0 {
                (point.z, velocity.z) = (0.0, 0.0);
            }
        }
    }

    fn bits(&self) -> Box<dyn Iterator<Item = u32> + '_> {
        let numbers = self
            .points
            .iter()
            .map(|point| point.z)
            .chain(self.velocities.iter().map(|velocity| velocity.z));
        Box::new(numbers.flat_map(|number| {
            let bits = number.to_bits();
            [bits as u32, (bits >> 32) as u32]
        }))
    }

    fn is_finite(&self) -> bool {
        self.points.iter().all(|point| point.z.is_finite())
    }

    fn at_rest(&self) -> bool {
        self.points.iter().all(|point| point.z == 0.0)
    }

    fn bounds(&self) -> Aabb {
        Aabb::around(self.points.iter().copied()).grown(1e-3)
    }

    fn surface(&self) -> Surface {
        let up = [0.0, 0.004].map(|rise| Vector3::z() * rise);
        let vertices = self.points.iter().flat_map(|point| up.map(|rise| point + rise)).collect();
        let strip = |index: u32| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|next| 2 * index + next);
            [[a, c, b], [b, c, d], [a, b, c], [b, d, c]]
        };
        let rest = RestSurface {
            vertices: vec![Point3::origin(); 2 * self.points.len()],
            triangles: (0..self.points.len() as u32 - 1).flat_map(strip).collect(),
        };
        Surface {
            name: "rope",
            vertices,
            normals: vec![-Vector3::y(); 2 * self.points.len()],
            rest: Arc::new(rest),
            colour: [0.9, 0.2, 0.6],
            material: "foam".into(),
        }
    }

    fn memory_bytes(&self) -> u64 {
        (self.points.len() * 48) as u64
    }

    fn boxed_clone(&self) -> Box<dyn NonRigid> {
        Box::new(self.clone())
    }
}

/// A task in which a rope, and a cube 50 mm beside it, fall. The action breaks the rope where it is 1.
#[derive(Clone)]
struct Falls {
    breaks: bool,
}

impl Registered for Falls {
    const INFO: TaskInfo = TaskInfo {
        id: "Falls-v0",
        summary: "Watch a rope fall.",
        steps: 50,
        hertz: 20.0,
        tags: &[],
    };

    fn options() -> Vec<OptionSpec> {
        vec![options::observation()]
    }

    fn new(_: &Options) -> Result<(Self, World), Rejection> {
        let mut world = World::new(Solver::HEAVY);
        let part = |half: f64, z: f64| Part {
            body_from_part: Pose::translation(0.0, 0.0, z),
            shape: Shape::Cuboid(Vector3::repeat(half)),
        };
        world.insert(Motion::Fixed, &Pose::identity(), 1.0, &[part(0.5, -0.5)]);
        let cube = Pose::translation(-0.05, 0.0, HEIGHT);
        world.insert(Motion::Free { mass: 0.01 }, &cube, 1.0, &[part(5e-3, 0.0)]);
        world.add(Box::new(Rope::new(8)));
        Ok((Self { breaks: false }, world))
    }
}

impl Task for Falls {
    fn action(&self) -> Vec<Element> {
        vec![Element::new("break", "", "1", -1.0, 1.0)]
    }

    fn state(&self, world: &World, state: &mut State<'_>) {
        let height = world.others().next().unwrap().bounds().centre().z;
        state.field(|| Element::new("height", "world", "m", -1.0, 1.0), height);
    }

    fn reset(&mut self, world: &mut World, _: &mut Rng) {
        let cube = world.objects().next().unwrap();
        world.wake(cube);
    }

    fn command(&mut self, _: &mut World, action: Option<&[f32]>) {
        self.breaks = action == Some(&[1.0]);
    }

    fn after_step(&mut self, world: &mut World) {
        if self.breaks {
            let mut rope = Rope::new(2);
            rope.points[0].z = f64::NAN;
            world.add(Box::new(rope));
        }
    }

    fn scene(&self, world: &World, scene: &mut Scene) {
        scene.add_world(world);
        scene.look_at(&Aabb::new([-0.05, -0.02, 0.0], [0.05, 0.02, HEIGHT]));
    }

    fn expert(&self, _: &World, _: &ExpertInput<'_>, action: &mut [f32]) {
        action[0] = 0.0;
    }
}

fn env() -> Env {
    let mut registry = Registry::empty();
    registry.register::<Falls>();
    let mut env = registry.make(Falls::INFO.id, &Options::new()).unwrap();
    env.reset(Some(1));
    env
}

fn height(env: &Env) -> f64 {
    env.world().others().next().unwrap().bounds().centre().z
}

#[test]
fn time_passes_for_it_as_for_rigid_bodies_until_both_rest() {
    let mut env = env();
    let cube = env.world().objects().next().unwrap();
    env.step(&[0.0]).unwrap();
    let fallen = 0.5 * GRAVITY * 0.05 * 0.05;
    assert!((height(&env) - (HEIGHT - fallen)).abs() < 1e-9, "{}", height(&env));
    let cube_at = env.world().pose(cube).translation.z;
    assert!((cube_at - (HEIGHT - fallen)).abs() < 1e-4, "{cube_at}");
    assert!(!env.world().at_rest());
    while !env.needs_reset() {
        env.step(&[0.0]).unwrap();
    }
    assert!(env.world().at_rest());
    assert_eq!(height(&env), 0.0);
}

#[test]
fn it_is_in_the_bits_in_copies_and_in_snapshots() {
    let mut env = env();
    env.step(&[0.0]).unwrap();
    let bits = |env: &Env| env.world().bits().collect::<Vec<_>>();
    let mut copies = vec![env.clone(), env.import(&env.export().unwrap()).unwrap()];
    let before = bits(&env);
    env.step(&[0.0]).unwrap();
    // The last 32 words are the rope's: eight heights and velocities.
    assert_ne!(bits(&env)[before.len() - 32..], before[before.len() - 32..]);
    for copy in &mut copies {
        assert_eq!(bits(copy), before, "a copy is another's, not the same");
        copy.step(&[0.0]).unwrap();
        assert_eq!(bits(copy), bits(&env));
    }
}

#[test]
fn it_is_met_drawn_counted_and_ends_the_episode_where_it_is_not_finite() {
    let mut env = env();
    let bounds = env.world().others().next().unwrap().bounds();
    assert!(env.world().object_in(&bounds) && !env.world().object_in(&bounds.shifted_up()));
    assert_eq!(env.memory_bytes(), Env::MEMORY_BYTES + 8 * 48);

    let scene = env.scene();
    let rope = scene.body("rope").unwrap();
    let camera = scene.camera(Lens::Overview, 160, 120).unwrap();
    let picture = Software::default().picture(&scene, &camera);
    let seen = picture.mask.iter().filter(|body| **body == rope).count();
    assert!(seen > 20, "{seen} pixels of the rope");

    let step = env.step(&[1.0]);
    assert!(matches!(step, Err(StepError::Simulation { .. })), "{step:?}");
}

/// The words of 32 bits of a message.
fn words(message: &Message) -> Vec<u32> {
    let Message::Bytes(bytes) = message else { panic!("{message:?} is a text") };
    let (words, []) = bytes.as_chunks::<4>() else { panic!("words of 32 bits") };
    words.iter().map(|word| u32::from_le_bytes(*word)).collect()
}

#[test]
fn the_viewer_is_told_its_form_once_and_then_where_its_skin_is() {
    let mut env = env();
    let mut encoder = SceneEncoder::default();
    let (first, _) = encoder.tell(1, 0, Moment::of(&env, vec![]));
    assert!(first.len() > 2, "meshes, what they are parts of, and a frame");
    env.step(&[0.0]).unwrap();
    let (then, _) = encoder.tell(1, 0, Moment::of(&env, vec![]));
    assert_eq!(then.len(), 1, "it has moved, and is still the same");

    let frame = words(&then[0]);
    let vertices = env.world().others().next().unwrap().surface().vertices;
    let length = 6 + (3 * vertices.len()).div_ceil(2);
    assert_eq!((frame[0], frame[13]), (message::FRAME, length as u32));
    let (skin, places) = frame[frame.len() - length..].split_at(6);
    let [low, step] = [0, 3].map(|first| [0, 1, 2].map(|axis| f32::from_bits(skin[first + axis])));
    let steps: Vec<_> = places.iter().flat_map(|two| [two & 0xffff, two >> 16]).collect();
    for (vertex, steps) in vertices.iter().zip(steps.chunks(3)) {
        let shown = Point3::from(
            [0, 1, 2]
                .map(|axis| f64::from(low[axis]) + f64::from(step[axis]) * f64::from(steps[axis])),
        );
        assert!((shown - vertex).norm() < 1e-6, "{shown} is shown for {vertex}");
    }
}

/// A box far above another.
trait ShiftedUp {
    fn shifted_up(&self) -> Self;
}

impl ShiftedUp for Aabb {
    fn shifted_up(&self) -> Self {
        let up = Vector3::z();
        Self { min: self.min + up, max: self.max + up }
    }
}
