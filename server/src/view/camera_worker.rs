//! Draws what the endoscope sees, on a thread that makes way for all others.

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::process::setpriority_process;
use rustix::thread::gettid;
use tokio::sync::oneshot;

use crate::clock::thread_time;
use crate::render::{Canvas, Lens, Renderer, Scene, Software};

/// Pixels along each side of a picture.
const PIXELS: usize = 192;

/// The least precedence that a thread can have: it runs where no other thread wants to.
const LEAST: i32 = 19;

/// A picture that is wanted.
#[derive(Debug)]
struct Order {
    scene: Arc<Scene>,
    finished: oneshot::Sender<Painting>,
}

/// A picture that was drawn.
#[derive(Debug)]
pub(super) struct Painting {
    pub(super) png: Vec<u8>,
    /// Processor time that it took.
    pub(super) cost: Duration,
}

/// Takes orders; clones give them to the same thread.
#[derive(Debug, Clone)]
pub(super) struct CameraWorker(SyncSender<Order>);

impl CameraWorker {
    /// Starts the thread. It ends with the last clone.
    pub(super) fn start(room: usize) -> io::Result<(Self, JoinHandle<()>)> {
        let (orders, waiting) = sync_channel(room);
        let thread = std::thread::Builder::new().name("trocar-paint".into());
        let thread = thread.spawn(move || work(&waiting))?;
        Ok((Self(orders), thread))
    }

    /// Orders a picture of a scene that has an endoscope. There is none where the answer is closed: the
    /// scene cannot be drawn, or there is no room for more orders.
    pub(super) fn order(&self, scene: Arc<Scene>) -> oneshot::Receiver<Painting> {
        let (finished, answer) = oneshot::channel();
        self.0.try_send(Order { scene, finished }).ok();
        answer
    }
}

fn work(orders: &Receiver<Order>) {
    if let Err(error) = setpriority_process(Some(gettid()), LEAST) {
        tracing::debug!(%error, "the camera worker does not make way for others");
    }
    let mut rgb = vec![0; 3 * PIXELS * PIXELS];
    for order in orders {
        let start = thread_time();
        // The page may be gone.
        if !order.finished.is_closed() && draw(&order.scene, &mut rgb) {
            match to_png(&rgb) {
                Ok(png) => {
                    let cost = thread_time().saturating_sub(start);
                    order.finished.send(Painting { png, cost }).ok();
                }
                Err(error) => tracing::warn!(%error, "a picture could not be written"),
            }
        }
    }
}

/// Draws what the endoscope sees; false where there is no endoscope, or something is nowhere.
fn draw(scene: &Scene, rgb: &mut [u8]) -> bool {
    let is_somewhere = scene.instances().iter().all(|part| {
        let at = &part.world_from_mesh;
        at.translation.vector.iter().chain(at.rotation.coords.iter()).all(|each| each.is_finite())
    });
    let camera = scene.camera(Lens::Endoscope, PIXELS, PIXELS).filter(|_| is_somewhere);
    let Some(camera) = camera else { return false };
    let canvas = Canvas { rgb: Some(rgb), ..Canvas::default() };
    Software::default().render(scene, &camera, canvas);
    true
}

fn to_png(rgb: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = vec![];
    let mut encoder = png::Encoder::new(&mut bytes, PIXELS as u32, PIXELS as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.write_header()?.write_image_data(rgb)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use trocar_proto::Options;

    use super::*;
    use crate::registry::Registry;
    use crate::sim::frames::Pose;

    fn scene() -> Scene {
        let mut env = Registry::builtin().make("NeedleReach-v0", &Options::new()).unwrap();
        env.reset(Some(3));
        env.scene()
    }

    #[test]
    fn a_picture_is_what_the_renderer_draws() {
        let (worker, thread) = CameraWorker::start(1).unwrap();
        let painting = worker.order(Arc::new(scene())).blocking_recv().unwrap();
        assert!(painting.cost > Duration::ZERO);
        let mut reader = png::Decoder::new(std::io::Cursor::new(painting.png)).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut rgb).unwrap();
        let camera = scene().camera(Lens::Endoscope, PIXELS, PIXELS).unwrap();
        assert_eq!(rgb, Software::default().picture(&scene(), &camera).rgb);
        drop(worker);
        thread.join().unwrap();
    }

    #[test]
    fn what_cannot_be_drawn_is_no_picture_and_stops_nothing() {
        let (worker, thread) = CameraWorker::start(1).unwrap();
        let mut lost = scene();
        let (mesh, look) = (Arc::clone(&lost.instances()[0].mesh), lost.instances()[0].material);
        lost.draw(mesh, Pose::translation(f64::NAN, 0.0, 0.0), look);
        assert!(worker.order(Arc::new(lost)).blocking_recv().is_err());
        assert!(worker.order(Arc::new(Scene::default())).blocking_recv().is_err());
        assert!(worker.order(Arc::new(scene())).blocking_recv().is_ok());
        drop(worker);
        thread.join().unwrap();
    }
}
