//! Pictures as observations: which are asked for, and how they are drawn.

use trocar_proto::spec::{ImageKind, ImageSpec};
use trocar_proto::{Code, OptionValue, Options, Rejection};

use crate::render::{Camera, Canvas, Lens, Renderer, Scene, Software};
use crate::tasks::options;

/// The pictures of an environment.
#[derive(Debug, Clone)]
pub(crate) struct Imaging {
    spec: ImageSpec,
    lenses: Vec<Lens>,
    renderer: Software,
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
        let (lenses, views): (_, &[&str]) = match options.text("camera") {
            Some("overview") => (vec![Lens::Overview], &[""]),
            Some("stereo") => (vec![Lens::Left, Lens::Right], &["_left", "_right"]),
            _ => (vec![Lens::Endoscope], &[""]),
        };
        let scene = scene();
        let Some(camera) = scene.camera(lenses[0], width, height) else {
            let allowed = "this task has no endoscope; allowed is overview";
            let given = options.text("camera").unwrap_or_default();
            return Err(Rejection::new(Code::InvalidOption, "options.camera", given, allowed));
        };
        let intrinsics = camera.intrinsics;
        let spec = ImageSpec {
            kinds,
            views: views.iter().map(ToString::to_string).collect(),
            height,
            width,
            intrinsics: [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy],
            far: camera.far as f32,
            bodies: scene.bodies().iter().map(ToString::to_string).collect(),
            with_state: is_wanted("state") || options::perceives(options),
        };
        Ok(Some(Self { spec, lenses, renderer: Software::default() }))
    }

    /// What the pictures are like.
    pub(crate) fn spec(&self) -> &ImageSpec {
        &self.spec
    }

    /// Draws the pictures, one view after the other.
    pub(crate) fn draw(
        &self,
        scene: &Scene,
        rgb: &mut [u8],
        depth: &mut [f32],
        mask: &mut [i32],
        points: &mut [f32],
    ) {
        let pixels = self.spec.height * self.spec.width;
        let has = |kind| self.spec.kinds.contains(&kind);
        // Points are made from the depth, which nobody else may want.
        let mut own_depth = vec![];
        if has(ImageKind::Points) && !has(ImageKind::Depth) {
            own_depth.resize(pixels, 0.0);
        }
        let mut rgb = rgb.chunks_exact_mut(3 * pixels);
        let mut depth = depth.chunks_exact_mut(pixels);
        let mut mask = mask.chunks_exact_mut(pixels);
        let mut points = points.chunks_exact_mut(3 * pixels);
        for lens in &self.lenses {
            let Some(camera) = scene.camera(*lens, self.spec.width, self.spec.height) else {
                return;
            };
            let mut depth = match depth.next() {
                Some(depth) => Some(depth),
                None if own_depth.is_empty() => None,
                None => Some(own_depth.as_mut_slice()),
            };
            let canvas = Canvas { rgb: rgb.next(), depth: depth.as_deref_mut(), mask: mask.next() };
            self.renderer.render(scene, &camera, canvas);
            if let (Some(points), Some(depth)) = (points.next(), depth) {
                back_project(&camera, depth, points);
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

/// Where the surfaces of all pixels are in the camera's axes.
fn back_project(camera: &Camera, depth: &[f32], points: &mut [f32]) {
    let width = camera.intrinsics.width;
    for (index, (point, depth)) in points.chunks_exact_mut(3).zip(depth).enumerate() {
        let ray = camera.ray((index % width) as f64, (index / width) as f64);
        point.copy_from_slice(&[ray.x as f32 * depth, ray.y as f32 * depth, *depth]);
    }
}
