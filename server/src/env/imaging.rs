//! Pictures as observations: which are asked for, and how they are drawn.

use std::sync::Arc;

use nalgebra::Vector3;
use trocar_proto::spec::{ImageKind, ImageSpec};
use trocar_proto::{Code, OptionValue, Options, Rejection};

use super::Env;
use crate::render::camera::extrinsics;
use crate::render::{Camera, Canvas, Lens, Renderer, Scene, Software, View, Viewpoint};
use crate::tasks::options;

/// Least distance of a placed camera from what it looks at, m.
const LEAST_DISTANCE: f64 = 1e-3;

/// Least depth that a placed camera sees, m.
const NEAR: f64 = 0.005;

/// From where a view is seen.
#[derive(Debug, Clone, Copy)]
enum Eye {
    /// What the task has.
    Lens(Lens),
    /// What the options say.
    Placed(Viewpoint),
}

impl Eye {
    fn viewpoint(&self, scene: &Scene) -> Option<Viewpoint> {
        match self {
            Self::Lens(lens) => scene.viewpoint(*lens),
            Self::Placed(viewpoint) => Some(*viewpoint),
        }
    }
}

/// Room for the pictures of one environment, one view after the other; empty what is not asked for. Shapes as
/// in [`trocar_proto::wire::ReplyLayout`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Pictures {
    /// Red, green, blue.
    pub rgb: Vec<u8>,
    /// Depth along the optical axis, m.
    pub depth: Vec<f32>,
    /// Numbers of bodies.
    pub mask: Vec<i32>,
    /// Points in the world frame, m.
    pub points: Vec<f32>,
}

impl Pictures {
    /// What `env` looks like.
    pub fn of(env: &Env) -> Self {
        let length = |kind: ImageKind| env.spec().pixels(kind) * kind.channels();
        let [rgb, depth, mask, points] = ImageKind::ALL.map(length);
        let mut pictures = Self {
            rgb: vec![0; rgb],
            depth: vec![0.0; depth],
            mask: vec![0; mask],
            points: vec![0.0; points],
        };
        pictures.take(env);
        pictures
    }

    /// Takes them again, of an environment of the same task and options.
    pub fn take(&mut self, env: &Env) {
        env.show(&mut self.rgb, &mut self.depth, &mut self.mask, &mut self.points);
    }
}

/// One environment's pictures to be drawn, one view after the other; empty what is not asked for.
pub(crate) struct Shot<'a> {
    /// What there is to see.
    pub(crate) scene: Scene,
    /// Colours.
    pub(crate) rgb: &'a mut [u8],
    /// Depth, m.
    pub(crate) depth: &'a mut [f32],
    /// Numbers of bodies.
    pub(crate) mask: &'a mut [i32],
    /// Points in the axes of the camera, m.
    pub(crate) points: &'a mut [f32],
}

/// How the pictures of an environment are drawn.
#[derive(Clone)]
pub(crate) struct Imaging {
    spec: ImageSpec,
    eyes: Vec<Eye>,
    renderer: Arc<dyn Renderer>,
}

impl Imaging {
    /// What resolved options ask for; nothing where that is the state alone. `scene` is asked for what there
    /// is to see.
    pub(crate) fn of(
        options: &Options,
        scene: impl FnOnce() -> Scene,
    ) -> Result<Option<Self>, Rejection> {
        let is_wanted = |name: &str| options::observes(options, name);
        let kinds: Vec<_> =
            ImageKind::ALL.into_iter().filter(|kind| is_wanted(kind.name())).collect();
        if kinds.is_empty() {
            return Ok(None);
        }
        let [height, width] = size(options)?;
        let lens = Eye::Lens;
        let (eyes, views): (_, &[&str]) = match options.text("camera") {
            Some("overview") => (vec![lens(Lens::Overview)], &[""]),
            Some("stereo") => (vec![lens(Lens::Left), lens(Lens::Right)], &["_left", "_right"]),
            Some("placed") => (vec![Eye::Placed(placed(options)?)], &[""]),
            _ => (vec![lens(Lens::Endoscope)], &[""]),
        };
        let scene = scene();
        let viewpoints: Vec<_> = eyes.iter().filter_map(|eye| eye.viewpoint(&scene)).collect();
        let Some(viewpoint) = viewpoints.first() else {
            let allowed = "this task has no endoscope; allowed are overview and placed";
            let given = options.text("camera").unwrap_or_default();
            return Err(Rejection::new(Code::InvalidOption, "options.camera", given, allowed));
        };
        let camera = viewpoint.camera(width, height);
        let intrinsics = camera.intrinsics;
        let fixed = viewpoints.iter().filter(|viewpoint| viewpoint.is_fixed);
        let spec = ImageSpec {
            kinds,
            views: views.iter().map(ToString::to_string).collect(),
            height,
            width,
            intrinsics: [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy],
            camera_from_world: fixed.map(|each| extrinsics(&each.world_from_camera)).collect(),
            far: camera.far as f32,
            bodies: scene.bodies().iter().map(ToString::to_string).collect(),
            with_state: options::observes_numbers(options),
        };
        Ok(Some(Self { spec, eyes, renderer: Arc::new(Software::default()) }))
    }

    /// The same without jagged edges, for people: that takes four times as long.
    pub(crate) fn fine(self) -> Self {
        Self { renderer: Arc::new(Software::fine()), ..self }
    }

    /// The same of a world whose cameras may have begun to move: the specification has the places of those only that
    /// stand still in `scene`.
    pub(crate) fn in_scene(mut self, scene: &Scene) -> Self {
        let viewpoints = self.eyes.iter().filter_map(|eye| eye.viewpoint(scene));
        let fixed = viewpoints.filter(|viewpoint| viewpoint.is_fixed);
        self.spec.camera_from_world =
            fixed.map(|viewpoint| extrinsics(&viewpoint.world_from_camera)).collect();
        self
    }

    /// What the pictures are like.
    pub(crate) fn spec(&self) -> &ImageSpec {
        &self.spec
    }

    /// Draws the pictures of environments, all of them at once.
    pub(crate) fn draw(&self, shots: &mut [Shot<'_>]) {
        let pixels = self.spec.height * self.spec.width;
        let has = |kind| self.spec.kinds.contains(&kind);
        // Points are made from the depth, which may not be asked for itself.
        let needs_depth = has(ImageKind::Points) && !has(ImageKind::Depth);
        let pictures = shots.len() * self.eyes.len();
        let mut own_depth = vec![0.0; if needs_depth { pictures * pixels } else { 0 }];
        let mut own_depth = own_depth.chunks_exact_mut(pixels);
        let mut views = Vec::with_capacity(pictures);
        let mut clouds = Vec::with_capacity(pictures);
        for Shot { scene, rgb, depth, mask, points } in shots {
            let mut rgb = rgb.chunks_exact_mut(3 * pixels);
            let mut depth = depth.chunks_exact_mut(pixels);
            let mut mask = mask.chunks_exact_mut(pixels);
            let mut points = points.chunks_exact_mut(3 * pixels);
            for eye in &self.eyes {
                let Some(viewpoint) = eye.viewpoint(scene) else { break };
                let camera = viewpoint.camera(self.spec.width, self.spec.height);
                let depth = depth.next().or_else(|| own_depth.next());
                let canvas = Canvas { rgb: rgb.next(), depth, mask: mask.next() };
                views.push(View { scene, camera, canvas });
                clouds.push(points.next());
            }
        }
        self.renderer.render_all(&mut views);
        for (view, points) in views.iter().zip(clouds) {
            if let (Some(points), Some(depth)) = (points, &view.canvas.depth) {
                back_project(&view.camera, depth, points);
            }
        }
    }
}

/// Rows and columns of pictures.
fn size(options: &Options) -> Result<[usize; 2], Rejection> {
    let given = options.0.get("image_size");
    let whole = |number: &f64| (number.fract() == 0.0).then_some(*number as usize);
    let size = match given {
        Some(OptionValue::Numbers(numbers)) => numbers.iter().map(whole).collect(),
        _ => None::<Vec<_>>,
    };
    size.and_then(|size| <[usize; 2]>::try_from(size).ok()).ok_or_else(|| {
        let given = given.map_or(String::new(), ToString::to_string);
        let allowed = "allowed are two whole numbers from 8 to 1024";
        Rejection::new(Code::InvalidOption, "options.image_size", given, allowed)
    })
}

/// The camera that resolved options place.
fn placed(options: &Options) -> Result<Viewpoint, Rejection> {
    let point = |name: &str| match options.0.get(name) {
        Some(OptionValue::Numbers(numbers)) => <[f64; 3]>::try_from(numbers.as_slice()).ok(),
        _ => None,
    };
    let [eye, target] = ["camera_eye", "camera_target"]
        .map(|name| point(name).expect("resolved options have three numbers"));
    if (Vector3::from(eye) - Vector3::from(target)).norm() < LEAST_DISTANCE {
        let allowed = format!("at least {LEAST_DISTANCE} m from camera_target, {target:?}");
        let given = format!("{eye:?}");
        return Err(Rejection::new(Code::InvalidOption, "options.camera_eye", given, allowed));
    }
    let view = options.number("camera_view").expect("resolved options have a number").to_radians();
    Ok(Viewpoint { near: NEAR, ..Viewpoint::towards(eye, target, view) })
}

/// Where the surfaces of all pixels are in the camera's axes.
fn back_project(camera: &Camera, depth: &[f32], points: &mut [f32]) {
    let width = camera.intrinsics.width;
    for (index, (point, depth)) in points.chunks_exact_mut(3).zip(depth).enumerate() {
        let ray = camera.ray((index % width) as f64, (index / width) as f64);
        point.copy_from_slice(&[ray.x as f32 * depth, ray.y as f32 * depth, *depth]);
    }
}
