//! The topics below `console` and `system`. There are no masters: the console keeps what it is told, and nothing follows.

use ros2_client::Publisher;
use trocar_client::proto::dvrk::StateCommand;

use crate::bus::{Bus, Keeps, publish};
use crate::dvrk::Dvrk;
use crate::messages::{Bool, Empty, Float64, Joy, Numbers, Text};

/// dVRK's scale between masters and arms.
const SCALE: f64 = 0.2;

/// What dVRK's loudness is at first.
const VOLUME: f64 = 1.0;

/// The console.
pub(crate) struct Console {
    enabled: Publisher<Bool>,
    scale: Publisher<Float64>,
    selected: Publisher<Text>,
    unselected: Publisher<Text>,
    /// The operator, the clutch and the camera's pedal.
    buttons: [Publisher<Joy>; 3],
}

/// The power of all arms.
pub(crate) struct System {
    volume: Publisher<Float64>,
}

impl Console {
    pub(crate) fn new(bus: &mut Bus<Dvrk>) -> anyhow::Result<Self> {
        bus.subscribe("/console/teleop/enable", |dvrk, is: Bool| {
            publish(&dvrk.console.enabled, is);
        })?;
        bus.subscribe("/console/teleop/set_scale", |dvrk, scale: Float64| {
            publish(&dvrk.console.scale, scale);
        })?;
        bus.subscribe("/console/teleop/select", |dvrk, pair: Text| {
            publish(&dvrk.console.selected, pair);
        })?;
        bus.subscribe("/console/teleop/unselect", |dvrk, pair: Text| {
            publish(&dvrk.console.unselected, pair);
        })?;
        let emulated = ["emulate_operator_present", "emulate_clutch", "emulate_camera"];
        for (place, name) in emulated.into_iter().enumerate() {
            bus.subscribe(&format!("/console/{name}"), move |dvrk, button: Joy| {
                publish(&dvrk.console.buttons[place], button);
            })?;
        }
        let button = |bus: &mut Bus<Dvrk>, name| {
            bus.publisher::<Joy>(&format!("/console/{name}"), Keeps::Latest)
        };
        let console = Self {
            enabled: bus.publisher("/console/teleop/enabled", Keeps::Latest)?,
            scale: bus.publisher("/console/teleop/scale", Keeps::Latest)?,
            selected: bus.publisher("/console/teleop/selected", Keeps::Latest)?,
            unselected: bus.publisher("/console/teleop/unselected", Keeps::Latest)?,
            buttons: [
                button(bus, "operator_present")?,
                button(bus, "clutch")?,
                button(bus, "camera")?,
            ],
        };
        publish(&console.scale, Float64 { data: SCALE });
        publish(&console.enabled, Bool { data: false });
        Ok(console)
    }
}

impl System {
    pub(crate) fn new(bus: &mut Bus<Dvrk>) -> anyhow::Result<Self> {
        bus.subscribe("/system/power_on", |dvrk, _: Empty| {
            dvrk.command_all(&StateCommand::Disable, true);
            dvrk.command_all(&StateCommand::Enable, false);
        })?;
        bus.subscribe("/system/power_off", |dvrk, _: Empty| {
            dvrk.command_all(&StateCommand::Disable, false);
        })?;
        bus.subscribe("/system/home", |dvrk, _: Empty| {
            dvrk.command_all(&StateCommand::Enable, false);
            dvrk.command_all(&StateCommand::Home, false);
        })?;
        bus.subscribe("/system/set_volume", |dvrk, volume: Float64| {
            publish(&dvrk.system.volume, volume);
        })?;
        // There is no loudspeaker.
        bus.subscribe("/system/beep", |_, _: Numbers| ())?;
        bus.subscribe("/system/string_to_speech", |_, _: Text| ())?;
        let system = Self { volume: bus.publisher("/system/volume", Keeps::Latest)? };
        publish(&system.volume, Float64 { data: VOLUME });
        Ok(system)
    }
}
