//! Pictures of both lenses of the endoscope, drawn and packed by a thread of its own.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use png::{BitDepth, ColorType, Compression, Encoder, Filter};
use ros2_client::Publisher;
use trocar_client::proto::spec::{ImageSpec, STEREO_BASELINE};
use trocar_client::{Client, LiveWorld, OptionValue, Options, SessionRequest};

use crate::bus::{Bus, Keeps, publish};
use crate::clock;
use crate::dvrk::Dvrk;
use crate::messages::{CameraInfo, CompressedImage, Header, Stamp};

/// Rows and columns of a picture.
pub(crate) const SIZE: [u32; 2] = [240, 320];

/// Both lenses.
const LENSES: [&str; 2] = ["left", "right"];

/// Where a lens's pictures go.
struct Lens {
    frame: String,
    image: Publisher<CompressedImage>,
    info: Publisher<CameraInfo>,
}

/// Draws until it is dropped.
pub(crate) struct Images {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Images {
    /// Publishes pictures of the world of a session, so many times a second.
    pub(crate) fn start(
        bus: &mut Bus<Dvrk>,
        client: &Client,
        request: &SessionRequest,
        session: u64,
        rate: f64,
    ) -> anyhow::Result<Self> {
        let lenses = LENSES.map(|lens| {
            let named = |topic: &str| format!("/endoscope/{lens}/{topic}");
            anyhow::Ok(Lens {
                frame: format!("endoscope_{lens}"),
                image: bus.publisher(&named("image_raw/compressed"), Keeps::Nothing)?,
                info: bus.publisher(&named("camera_info"), Keeps::Nothing)?,
            })
        });
        let [left, right] = lenses;
        let lenses = [left?, right?];
        let mut view = Options::new();
        let numbers = SIZE.iter().map(|number| f64::from(*number)).collect();
        view.0.insert("image_size".into(), OptionValue::Numbers(numbers));
        view.0.insert("camera".into(), OptionValue::Text("stereo".into()));
        let mut live = request.live.context("a live world")?;
        live.world = Some(session);
        let request = request.clone().live(live).view(view);
        let mut world = client.open_live(&request)?;
        let spec = world.info().view.as_deref().cloned().context("a view")?;
        let stop = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&stop);
        let work = move || {
            let period = Duration::from_secs_f64(1.0 / rate);
            while !asked.load(Ordering::Acquire) {
                let began = Instant::now();
                if let Err(error) = draw(&mut world, &spec, &lenses) {
                    tracing::warn!("no more pictures: {error:#}");
                    return;
                }
                std::thread::sleep(period.saturating_sub(began.elapsed()));
            }
        };
        let thread = std::thread::Builder::new().name("images".into()).spawn(work)?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for Images {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// Publishes a picture of each lens. Both have one stamp.
fn draw(world: &mut LiveWorld, spec: &ImageSpec, lenses: &[Lens; 2]) -> anyhow::Result<()> {
    let rgb = world.render()?;
    let stamp = Stamp::of(clock::now());
    let pixels = spec.height * spec.width * 3;
    if rgb.len() != 2 * pixels {
        bail!("{} bytes are no two pictures of {pixels}", rgb.len());
    }
    let aside = [0.0, STEREO_BASELINE];
    for ((lens, picture), aside) in lenses.iter().zip(rgb.chunks_exact(pixels)).zip(aside) {
        let header = Header::new(stamp, &lens.frame);
        publish(&lens.info, info(spec, aside, header.clone()));
        let data = packed(picture, spec.width as u32, spec.height as u32)?;
        publish(
            &lens.image,
            CompressedImage { header, format: "rgb8; png compressed bgr8".into(), data },
        );
    }
    Ok(())
}

fn packed(rgb: &[u8], width: u32, height: u32) -> anyhow::Result<Vec<u8>> {
    let mut data = vec![];
    let mut encoder = Encoder::new(&mut data, width, height);
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(Compression::Fast);
    // One that scripts without a library for pictures can undo at once.
    encoder.set_filter(Filter::Up);
    encoder.write_header()?.write_image_data(rgb)?;
    Ok(data)
}

/// A lens without distortion that lies `aside` of the left one, m.
fn info(spec: &ImageSpec, aside: f64, header: Header) -> CameraInfo {
    let [fx, fy, cx, cy] = spec.intrinsics;
    CameraInfo {
        header,
        height: spec.height as u32,
        width: spec.width as u32,
        distortion_model: "plumb_bob".into(),
        d: vec![0.0; 5],
        k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fx, 0.0, cx, -fx * aside, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraInfo::default()
    }
}
