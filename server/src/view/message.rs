//! What the page and its server say to each other.
//!
//! The page sends short texts, see [`Command`]. The server sends texts, each a JSON object with its kind as
//! `type`: `hello`, `sessions`, `scene`, `gone`, `error`, `bye`; and bytes, little-endian words of 32 bits of
//! which the first is the kind:
//!
//! | kind | words |
//! |---|---|
//! | [`MESH`] | number of the mesh, v, t, c; positions 3·v f32 (m), normals 3·v f32, triangles 3·t u32, colours of the vertices 3·c f32 (red, green, blue, linear; c is v or 0) |
//! | [`FRAME`] | scene, flags, steps, seed (2), episode (2), stage, the numbers of parts, contacts, jaws and marks, and of words of skins; endoscope: pose, view (rad); parts: pose each; contacts: point (m) and force (N) each; jaws: opening, asked (rad), two pressures (N) each; marks: reward f32, flags u32 each; skins |
//! | [`PICTURE`] | session (2), environment, then a PNG: what the endoscope sees |
//!
//! A *pose* is x, y, z (m) and a unit quaternion x, y, z, w, seven f32 in the world frame. A frame names the
//! `scene` whose parts it moves; meshes come before the first scene that names them, and once a connection.
//!
//! A *skin* is where the vertices of a part that deforms are now; there is one for each such part, in their order. It has
//! the least corner of a box around them (m) and the edges of a step in it (m), six f32, and for each vertex the steps
//! along x, y and z, three u16, filled up to a whole word.

use std::sync::Arc;

use bytemuck::cast_slice;
use serde::{Deserialize, Serialize};

use super::source::{About, Moment, Pace, SessionCard, Wish};
use crate::render::light::Lamp;
use crate::render::mesh::Mesh;
use crate::render::scene::Instance;
use crate::render::{Scene, Viewpoint};
use crate::sim::frames::Pose;

/// The form of something.
pub const MESH: u32 = 1;
/// Where everything is.
pub const FRAME: u32 = 2;
/// What the endoscope sees.
pub const PICTURE: u32 = 3;

/// Flag of a frame: the scene has an endoscope.
pub const HAS_ENDOSCOPE: u32 = 1;

/// Flag of a mark: it was a step; else an episode began, or a state was restored.
pub const STEP: u32 = 1;
/// Flag of a mark: the episode ended.
pub const ENDED: u32 = 2;
/// Flag of a mark: the goal was reached.
pub const SUCCESS: u32 = 4;

/// Most contacts that a frame shows: those that press hardest.
pub const MOST_CONTACTS: usize = 64;

/// Longest command, bytes.
pub const LONGEST_COMMAND: usize = 512;

/// What the page may ask for.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// To watch this environment, and no other any more.
    Watch {
        /// Its session.
        session: u64,
        /// Its number there.
        env: u32,
        /// How its moments are to follow each other.
        #[serde(default)]
        pace: Pace,
    },
    /// To watch nothing.
    Leave,
    /// The next episode, where episodes are watched.
    More,
    /// No moments for now (true), or again.
    Pause(bool),
    /// To drive an arm of a live world.
    Drive(Wish),
    /// To drive no arm any more.
    LetGo,
}

/// What the server says as text.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
#[expect(clippy::large_enum_variant, reason = "it is written and gone")]
pub enum Notice<'a> {
    /// The first message.
    Hello {
        /// What serves the page: a server, or recordings.
        #[serde(flatten)]
        about: &'a About,
    },
    /// What can be watched.
    Sessions {
        /// All of them.
        list: &'a [SessionCard],
    },
    /// What frames with this number are made of.
    Scene(SceneCard<'a>),
    /// The session that was watched has ended.
    Gone {
        /// Which.
        session: u64,
    },
    /// A command was not understood or cannot be carried out.
    Error {
        /// Why.
        message: &'a str,
    },
    /// The server ends.
    Bye,
}

impl Notice<'_> {
    /// Its text.
    pub fn text(&self) -> String {
        serde_json::to_string(self).expect("names and numbers are JSON")
    }
}

/// What does not move in a scene.
#[derive(Debug, Serialize)]
pub struct SceneCard<'a> {
    number: u32,
    session: u64,
    env: u32,
    /// All meshes before this message are forgotten but for those that were sent since the scene before.
    forget: bool,
    bodies: Vec<&'a str>,
    parts: Vec<PartCard>,
    jaws: Vec<&'a str>,
    light: LightCard,
    background: [f32; 3],
    stage: [[f64; 3]; 2],
    overview: ViewCard,
}

#[derive(Debug, Serialize)]
struct PartCard {
    mesh: u32,
    size: f64,
    body: i32,
    colour: [f32; 3],
    metallic: f32,
    roughness: f32,
    /// Frames have a skin of it.
    deforms: bool,
}

#[derive(Debug, Serialize)]
struct LightCard {
    /// Towards the lamp; none where that is at the endoscope.
    direction: Option<[f64; 3]>,
    lamp: [f32; 3],
    sky: [f32; 3],
    ground: [f32; 3],
}

#[derive(Debug, Serialize)]
struct ViewCard {
    pose: [f32; 7],
    view: f64,
}

/// What one page has been told of what there is to see.
#[derive(Debug, Default)]
pub struct SceneEncoder {
    meshes: Vec<Arc<Mesh>>,
    scene: Option<Arc<Scene>>,
    number: u32,
}

/// A message to the page.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// A [`Notice`].
    Text(String),
    /// A mesh, frame or picture.
    Bytes(Vec<u8>),
}

impl SceneEncoder {
    /// Most meshes that a page is told to remember.
    const MOST_MESHES: usize = 1024;

    /// What is to be sent so that the page shows `moment` of an environment: a frame, and before it what is
    /// new in its scene. Returns the scene too.
    pub fn tell(&mut self, session: u64, env: u32, moment: Moment) -> (Vec<Message>, Arc<Scene>) {
        let mut messages = vec![];
        let is_known = self.scene.as_ref().is_some_and(|known| is_like(known, &moment.scene));
        let scene = Arc::new(moment.scene);
        if !is_known {
            self.introduce(session, env, &scene, &mut messages);
        }
        self.scene = Some(Arc::clone(&scene));
        let moment = Moment { scene: Scene::default(), ..moment };
        messages.push(Message::Bytes(frame(self.number, &scene, &moment)));
        (messages, scene)
    }

    /// Something else is watched from now on; it has a scene of its own.
    pub fn forget(&mut self) {
        self.scene = None;
    }

    fn introduce(&mut self, session: u64, env: u32, scene: &Scene, messages: &mut Vec<Message>) {
        let forget = self.meshes.len() + scene.instances().len() > Self::MOST_MESHES;
        if forget {
            self.meshes.clear();
        }
        let parts = scene.instances().iter().map(|part| {
            let is_it = |known: &Arc<Mesh>| Arc::ptr_eq(known, &part.mesh) || **known == *part.mesh;
            // What deforms has a mesh of its own, which frames change.
            let known = self.meshes.iter().position(is_it).filter(|_| part.rest.is_none());
            let number = known.unwrap_or_else(|| {
                messages.push(Message::Bytes(mesh(self.meshes.len() as u32, part)));
                self.meshes.push(Arc::clone(&part.mesh));
                self.meshes.len() - 1
            });
            PartCard {
                mesh: number as u32,
                size: part.size,
                body: part.body,
                colour: part.material.colour,
                metallic: part.material.metallic,
                roughness: part.material.roughness,
                deforms: part.rest.is_some(),
            }
        });
        let parts = parts.collect();
        self.number = self.number.wrapping_add(1);
        let light = &scene.light;
        let card = SceneCard {
            number: self.number,
            session,
            env,
            forget,
            bodies: scene.bodies().iter().map(AsRef::as_ref).collect(),
            parts,
            jaws: scene.jaws.iter().map(|jaws| jaws.arm).collect(),
            light: LightCard {
                direction: match light.place {
                    Lamp::Far(direction) => Some(direction.into()),
                    Lamp::AtEndoscope => None,
                },
                lamp: light.lamp,
                sky: light.sky,
                ground: light.ground,
            },
            background: scene.background,
            stage: [scene.stage.min.into(), scene.stage.max.into()],
            overview: ViewCard {
                pose: pose(&scene.overview.world_from_camera),
                view: scene.overview.view,
            },
        };
        messages.push(Message::Text(Notice::Scene(card).text()));
    }
}

/// Whether two scenes differ only in where their parts are, and in how they are deformed.
fn is_like(one: &Scene, other: &Scene) -> bool {
    let same_part = |(one, other): (&Instance, &Instance)| {
        let same_form = match (&one.rest, &other.rest) {
            (Some(one), Some(other)) => Arc::ptr_eq(one, other) || one == other,
            (None, None) => Arc::ptr_eq(&one.mesh, &other.mesh) || one.mesh == other.mesh,
            _ => false,
        };
        (one.size, one.body, one.material) == (other.size, other.body, other.material)
            && one.paint == other.paint
            && same_form
    };
    let arms = |scene: &Scene| scene.jaws.iter().map(|jaws| jaws.arm).collect::<Vec<_>>();
    one.instances().len() == other.instances().len()
        && one.instances().iter().zip(other.instances()).all(same_part)
        && one.bodies() == other.bodies()
        && arms(one) == arms(other)
        && (one.light, one.background, one.stage) == (other.light, other.background, other.stage)
        && one.overview == other.overview
}

fn mesh(number: u32, part: &Instance) -> Vec<u8> {
    let mesh = &part.mesh;
    let (vertices, triangles) = (mesh.vertices().count(), mesh.triangles());
    let colours = part.vertex_colours();
    let mut bytes = Vec::with_capacity(20 + 36 * vertices + 12 * triangles.len());
    let head = [MESH, number, vertices as u32, triangles.len() as u32, colours.len() as u32];
    bytes.extend_from_slice(cast_slice(&head));
    mesh.vertices().for_each(|at| bytes.extend_from_slice(cast_slice(at.coords.as_slice())));
    mesh.normals().for_each(|normal| bytes.extend_from_slice(cast_slice(normal.as_slice())));
    bytes.extend_from_slice(cast_slice(triangles));
    bytes.extend_from_slice(cast_slice(&colours));
    bytes
}

/// The words of a skin.
fn skin(mesh: &Mesh) -> Vec<u32> {
    /// Steps along each edge of the box.
    const STEPS: f32 = 65535.0;
    let bounds = mesh.vertices().fold([[f32::MAX; 3], [f32::MIN; 3]], |[low, high], at| {
        let along = |axis: usize| (low[axis].min(at[axis]), high[axis].max(at[axis]));
        let both = [0, 1, 2].map(along);
        [both.map(|(low, _)| low), both.map(|(_, high)| high)]
    });
    let [low, high] = if mesh.is_empty() { [[0.0; 3]; 2] } else { bounds };
    let step: [f32; 3] = std::array::from_fn(|axis| (high[axis] - low[axis]) / STEPS);
    let steps = mesh.vertices().flat_map(|at| {
        [0, 1, 2].map(|axis: usize| {
            let along = if step[axis] > 0.0 { (at[axis] - low[axis]) / step[axis] } else { 0.0 };
            (along + 0.5) as u16
        })
    });
    let mut halves: Vec<u16> = steps.collect();
    halves.resize(halves.len().next_multiple_of(2), 0);
    let places = halves.chunks_exact(2).map(|two| u32::from(two[0]) | u32::from(two[1]) << 16);
    low.into_iter().chain(step).map(f32::to_bits).chain(places).collect()
}

/// The bytes of a frame; the scene is not `moment`'s, but beside it.
fn frame(number: u32, scene: &Scene, moment: &Moment) -> Vec<u8> {
    let parts = scene.instances();
    let mut contacts: Vec<_> = moment.contacts.iter().collect();
    contacts.sort_by(|one, other| other.force.norm().total_cmp(&one.force.norm()));
    contacts.truncate(MOST_CONTACTS);
    let deforming = parts.iter().filter(|part| part.rest.is_some());
    let skins: Vec<_> = deforming.flat_map(|part| skin(&part.mesh)).collect();
    let flags = if scene.endoscope.is_some() { HAS_ENDOSCOPE } else { 0 };
    let halves = |number: u64| [number as u32, (number >> 32) as u32];
    let ([seed, seed_high], [episode, episode_high]) =
        (halves(moment.seed), halves(moment.episode));
    let mut words = vec![
        FRAME,
        number,
        flags,
        moment.steps,
        seed,
        seed_high,
        episode,
        episode_high,
        moment.stage as u32,
        parts.len() as u32,
        contacts.len() as u32,
        scene.jaws.len() as u32,
        moment.marks.len() as u32,
        skins.len() as u32,
    ];
    let mut put = |numbers: &[f32]| words.extend(numbers.iter().map(|number| number.to_bits()));
    let (at, view) = match &scene.endoscope {
        Some(Viewpoint { world_from_camera, view, .. }) => (pose(world_from_camera), *view as f32),
        None => ([0.0; 7], 0.0),
    };
    put(&at);
    put(&[view]);
    for part in parts {
        put(&pose(&part.world_from_mesh));
    }
    for contact in contacts {
        put(contact.point.coords.cast::<f32>().as_slice());
        put(contact.force.cast::<f32>().as_slice());
    }
    for jaws in &scene.jaws {
        let [one, other] = jaws.pressures;
        put(&[jaws.opening, jaws.asked, one, other].map(|number| number as f32));
    }
    for mark in &moment.marks {
        let flags = [(mark.is_step, STEP), (mark.ended, ENDED), (mark.is_success, SUCCESS)];
        let flags = flags.into_iter().filter(|(is_set, _)| *is_set).map(|(_, flag)| flag);
        words.extend([mark.reward.to_bits(), flags.sum()]);
    }
    words.extend(skins);
    cast_slice(&words).to_vec()
}

/// A picture in PNG's format as a message.
pub fn picture(session: u64, env: u32, png: &[u8]) -> Vec<u8> {
    let head = [PICTURE, session as u32, (session >> 32) as u32, env];
    let mut bytes = cast_slice(&head).to_vec();
    bytes.extend_from_slice(png);
    bytes
}

fn pose(pose: &Pose) -> [f32; 7] {
    let at = pose.translation.vector;
    let turn = pose.rotation.coords;
    [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w].map(|number| number as f32)
}

/// The command of a text; an error says what is wrong with it.
pub fn parse(text: &str) -> Result<Command, String> {
    serde_json::from_str(text).map_err(|error| format!("no command: {error}"))
}
