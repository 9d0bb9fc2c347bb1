//! What there is to see: bodies made of meshes at their places, light, and from where to look.

use std::borrow::Cow;
use std::f64::consts::FRAC_PI_3;
use std::sync::{Arc, LazyLock};

use nalgebra::{Point3, Vector3};
use trocar_proto::spec::STEREO_BASELINE;

use super::camera::{self, Camera, Viewpoint};
use super::light::{Light, Look};
use super::material::Material;
use super::mesh::Mesh;
use super::tissue::{Paint, Tissue};
use crate::assets::{Model, Scaled, Visual};
use crate::sim::frames::{Aabb, Pose};
use crate::sim::random::Rng;
use crate::sim::world::{Motion, RestSurface, World};

/// Which body a pixel shows: 0 is none, n the n-th that was added to the scene. A task adds its bodies in
/// the same order every time.
pub type BodyNumber = i32;

/// Half the distance of a stereo endoscope's lenses, m; as in `assets/ecm`.
const HALF_BASELINE: f64 = STEREO_BASELINE / 2.0;

/// A mesh at its place.
#[derive(Debug, Clone)]
pub struct Instance {
    /// Its form.
    pub mesh: Arc<Mesh>,
    /// Where it is.
    pub world_from_mesh: Pose,
    /// How many times as large as the mesh it is.
    pub size: f64,
    /// The body of which it is a part.
    pub body: BodyNumber,
    /// Its look.
    pub material: Material,
    /// The body at rest, if it deforms: as many vertices as its mesh has.
    pub rest: Option<Arc<RestSurface>>,
    /// What lies on its colour, if it is tissue; it is bound to the body at rest.
    pub paint: Option<Paint>,
}

impl Instance {
    /// Red, green, blue of its vertices, linear, each as the mean of what is near it; none where it has one colour.
    pub fn vertex_colours(&self) -> Vec<[f32; 3]> {
        /// About the distance of neighbouring vertices, m.
        const WIDTH: f32 = 2e-3;
        let Some((paint, rest)) = self.paint.as_ref().zip(self.rest.as_ref()) else {
            return vec![];
        };
        let colour = |at: &Point3<f32>| {
            let factors = paint.colour_at(at.coords.into(), WIDTH);
            std::array::from_fn(|channel| self.material.colour[channel] * factors[channel])
        };
        rest.vertices.iter().map(colour).collect()
    }

    /// Middle, in the axes of the mesh, and radius of a ball around it, m.
    pub(super) fn ball(&self) -> (Point3<f64>, f64) {
        (self.mesh.centre * self.size, self.mesh.radius * self.size)
    }
}

/// The state of an arm's jaws, to be shown in numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jaws {
    /// The arm, as its bodies' names begin: `psm1` or `psm2`.
    pub arm: &'static str,
    /// Opening between the fingers, rad.
    pub opening: f64,
    /// Opening that is asked for, rad: less where something is between the fingers.
    pub asked: f64,
    /// How hard everything together presses on each finger, N.
    pub pressures: [f64; 2],
}

/// What there is to see at one moment.
#[derive(Debug, Clone)]
pub struct Scene {
    instances: Vec<Instance>,
    bodies: Vec<Cow<'static, str>>,
    /// Of the arms that have jaws, in the order in which they are drawn.
    pub jaws: Vec<Jaws>,
    /// The lights.
    pub light: Light,
    /// Red, green, blue of where nothing is; linear.
    pub background: [f32; 3],
    /// Where shadows are worth drawing, m.
    pub stage: Aabb,
    /// The endoscope's middle between both lenses, where there is an endoscope.
    pub endoscope: Option<Viewpoint>,
    /// Joints of the endoscope's arm beside PSMs where a live world moves it, rad; index 2 in m.
    pub endoscope_joints: Option<[f64; 4]>,
    /// From where all is seen.
    pub overview: Viewpoint,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            instances: Vec::with_capacity(64),
            bodies: Vec::with_capacity(32),
            jaws: Vec::new(),
            light: Look::Bench.light(),
            background: Look::Bench.background(),
            stage: Aabb::new([-0.5; 3], [0.5; 3]),
            endoscope: None,
            endoscope_joints: None,
            overview: Viewpoint::towards([1.0, 0.6, 0.8], [0.0; 3], FRAC_PI_3 * 0.75),
        }
    }
}

impl Scene {
    /// Begins a body; what is drawn from now on belongs to it.
    pub fn begin(&mut self, name: impl Into<Cow<'static, str>>) -> BodyNumber {
        self.bodies.push(name.into());
        self.bodies.len() as BodyNumber
    }

    /// Draws a mesh as a part of the body begun last.
    ///
    /// # Panics
    /// Where no body was begun.
    pub fn draw(&mut self, mesh: Arc<Mesh>, world_from_mesh: Pose, material: Material) {
        self.draw_sized(mesh, 1.0, world_from_mesh, material);
    }

    /// The same, `size` times as large.
    ///
    /// # Panics
    /// Where no body was begun.
    pub fn draw_sized(
        &mut self,
        mesh: Arc<Mesh>,
        size: f64,
        world_from_mesh: Pose,
        material: Material,
    ) {
        let body = self.bodies.len() as BodyNumber;
        assert!(body > 0, "what is drawn belongs to a body");
        self.instances.push(Instance {
            mesh,
            world_from_mesh,
            size,
            body,
            material,
            rest: None,
            paint: None,
        });
    }

    /// Adds a body that looks as its model.
    pub fn add_model(
        &mut self,
        name: impl Into<Cow<'static, str>>,
        model: &Model,
        world_from_body: &Pose,
    ) -> BodyNumber {
        let body = self.begin(name);
        self.draw_visuals(&model.visuals, world_from_body);
        body
    }

    /// Draws a model in its size as a part of the body begun last, with `look` for its materials.
    pub fn draw_scaled(
        &mut self,
        form: &Scaled,
        world_from_body: &Pose,
        look: impl Fn(Material) -> Material,
    ) {
        for (visual, body_from_visual) in form.visuals() {
            let at = world_from_body * body_from_visual;
            self.draw_sized(visual.form.mesh(), form.size(), at, look(visual.material));
        }
    }

    /// Draws what is seen of a body as a part of the body begun last.
    pub fn draw_visuals(&mut self, visuals: &[Visual], world_from_body: &Pose) {
        for visual in visuals {
            let at = world_from_body * visual.body_from_visual;
            self.draw(visual.form.mesh(), at, visual.material);
        }
    }

    /// Adds a floor at this height, m.
    pub fn add_floor(&mut self, height: f64) {
        static FLOOR: LazyLock<Arc<Mesh>> =
            LazyLock::new(|| Arc::new(Mesh::cuboid(&Vector3::new(4.0, 4.0, 0.01))));
        self.begin("floor");
        let at = Pose::translation(0.0, 0.0, height - 0.01);
        self.draw(Arc::clone(&FLOOR), at, Material::named("floor"));
    }

    /// Adds a ball of this radius (m) that marks a goal.
    pub fn add_goal(&mut self, centre: &Vector3<f64>, radius: f64) {
        self.begin("goal");
        let ball = Mesh::capsule(&Point3::origin(), &Point3::origin(), radius);
        self.draw(Arc::new(ball), Pose::from(*centre), Material::named("marker"));
    }

    /// Adds every body of a world as its collision shapes, in plain colours: what a task gets that does
    /// not say how it looks.
    pub fn add_world(&mut self, world: &World) {
        const FREE: [[f32; 3]; 4] =
            [[0.84, 0.24, 0.20], [0.13, 0.46, 0.78], [0.94, 0.72, 0.20], [0.24, 0.62, 0.38]];
        let (mut free, mut region) = (0, None::<Aabb>);
        for (number, body) in world.bodies().enumerate() {
            let (kind, material) = match body.motion {
                Motion::Fixed => ("fixed", Material::named("tray")),
                Motion::Driven => ("driven", Material::named("steel")),
                Motion::Free { .. } => {
                    free += 1;
                    ("free", Material::named("foam").coloured(FREE[(free - 1) % FREE.len()]))
                }
            };
            self.begin(format!("{kind} {number}"));
            for part in &body.parts {
                let at = body.world_from_body * part.body_from_part;
                self.draw(Arc::new(Mesh::of_shape(&part.shape)), at, material);
                let part = part.aabb(&body.world_from_body);
                region = Some(region.map_or(part, |region| region.merged(&part)));
            }
        }
        if let Some(region) = region {
            self.look_at(&region);
        }
    }

    /// Adds the bodies of a world that are not rigid. Each has other vessels and lobules, which `rng` draws.
    pub fn add_others(&mut self, world: &World, rng: &mut Rng) {
        for other in world.others() {
            let skin = other.surface();
            self.begin(skin.name);
            let mesh = Mesh::new(&skin.vertices, &skin.normals, skin.rest.triangles.clone());
            let material =
                Material::find(&skin.material).unwrap_or_else(|| Material::named("foam"));
            self.draw(Arc::new(mesh), Pose::identity(), material.coloured(skin.colour));
            let instance = self.instances.last_mut().expect("it was drawn");
            instance.paint = Tissue::of(&skin.material).map(|tissue| Paint::new(tissue, rng));
            instance.rest = Some(skin.rest);
        }
    }

    /// Shows the scene in this light.
    pub fn set_look(&mut self, look: Look) {
        (self.light, self.background) = (look.light(), look.background());
    }

    /// Makes `region` (m) the stage, and lets the overview and the endoscope look at it.
    pub fn look_at(&mut self, region: &Aabb) {
        let (centre, size) = (region.centre(), 0.5 * region.extents().norm());
        self.stage = *region;
        let from = |direction: [f64; 3], distance: f64, view: f64| {
            let eye = centre + Vector3::from(direction).normalize() * distance;
            Viewpoint::towards(eye.into(), centre.into(), view)
        };
        let overview = from([1.0, 0.5, 0.7], 2.8 * size, 0.75 * FRAC_PI_3);
        self.overview = Viewpoint { is_fixed: false, ..overview };
        self.endoscope = Some(Viewpoint {
            near: 0.01,
            far: 10.0,
            is_fixed: false,
            ..from([1.0, 0.0, 1.2], 2.0 * size, FRAC_PI_3)
        });
    }

    /// Lets the endoscope look from where dVRK's camera frame (left, up, forward) is, or for the moment is: 60°
    /// high, from 10 mm to 10 m. Source: the original.
    pub fn look_through(&mut self, world_from_camera: &Pose, is_fixed: bool) {
        self.endoscope = Some(Viewpoint {
            world_from_camera: camera::from_dvrk(world_from_camera),
            view: FRAC_PI_3,
            near: 0.01,
            far: 10.0,
            is_fixed,
        });
    }

    /// All that is drawn.
    pub fn instances(&self) -> &[Instance] {
        &self.instances
    }

    /// The names of the bodies: number n of a mask is the name at n − 1.
    pub fn bodies(&self) -> &[Cow<'static, str>] {
        &self.bodies
    }

    /// The number of the body `name`.
    pub fn body(&self, name: &str) -> Option<BodyNumber> {
        let index = self.bodies.iter().position(|body| body == name)?;
        Some(index as BodyNumber + 1)
    }

    /// Number of all triangles.
    pub fn triangles(&self) -> usize {
        self.instances.iter().map(|instance| instance.mesh.len()).sum()
    }

    /// The camera that a lens gives; none where the scene has no endoscope.
    pub fn camera(&self, lens: Lens, width: usize, height: usize) -> Option<Camera> {
        Some(self.viewpoint(lens)?.camera(width, height))
    }

    /// From where a lens looks; none where the scene has no endoscope.
    pub fn viewpoint(&self, lens: Lens) -> Option<Viewpoint> {
        Some(match lens {
            Lens::Overview => self.overview,
            Lens::Endoscope => self.endoscope?,
            Lens::Left => self.endoscope?.moved_right(-HALF_BASELINE),
            Lens::Right => self.endoscope?.moved_right(HALF_BASELINE),
        })
    }
}

/// Through what a scene is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lens {
    /// The endoscope, from between its lenses.
    Endoscope,
    /// The left lens of the endoscope.
    Left,
    /// The right lens of the endoscope, 4.2 mm beside the left one.
    Right,
    /// A camera that sees all of the theatre.
    Overview,
}
