//! Pictures of what is simulated: colour, depth and bodies, drawn without a display.
//!
//! | module | holds |
//! |---|---|
//! | [`scene`] | what there is to see: bodies, light, viewpoints |
//! | [`camera`] | intrinsics, extrinsics, projection |
//! | [`picture`] | what was seen |
//! | [`mesh`], [`material`] | forms and looks, from `assets/` |
//! | [`tissue`], [`texture`] | vessels, lobules and spots of soft bodies |
//! | [`light`] | on the bench, or from the endoscope in a dark cavity |
//! | [`skeleton`] | the links of an arm from its URDF |
//! | [`software`] | the renderer: [`project`] and [`raster`] find what each pixel shows, [`shadow`] what the lamp reaches, [`shade`] the colours |
//!
//! The same scene and camera give the same bytes whatever draws them and however many threads do.

pub mod camera;
pub mod light;
pub mod material;
pub mod mesh;
pub mod picture;
mod project;
mod raster;
pub mod scene;
mod shade;
mod shadow;
pub mod skeleton;
pub mod software;
mod texture;
pub mod tissue;

pub use camera::{Camera, Intrinsics, Viewpoint};
pub use light::Look;
pub use picture::{Canvas, Picture};
pub use scene::{Jaws, Lens, Scene};
pub use software::Software;

/// What is to be drawn where.
#[derive(Debug)]
pub struct View<'a> {
    /// What there is to see.
    pub scene: &'a Scene,
    /// From where.
    pub camera: Camera,
    /// Where it is drawn.
    pub canvas: Canvas<'a>,
}

/// What draws pictures.
pub trait Renderer: Send + Sync {
    /// Draws what the camera sees of the scene.
    ///
    /// # Panics
    /// Where the canvas does not have the camera's size.
    fn render(&self, scene: &Scene, camera: &Camera, canvas: Canvas<'_>);

    /// Draws several views. A renderer that draws faster when it is given many at once does so here.
    ///
    /// # Panics
    /// Where a canvas does not have its camera's size.
    fn render_all(&self, views: &mut [View<'_>]) {
        for View { scene, camera, canvas } in views {
            self.render(scene, camera, canvas.again());
        }
    }

    /// A whole picture of it.
    fn picture(&self, scene: &Scene, camera: &Camera) -> Picture {
        let mut picture = Picture::new(camera.intrinsics.width, camera.intrinsics.height);
        self.render(scene, camera, picture.canvas());
        picture
    }
}
