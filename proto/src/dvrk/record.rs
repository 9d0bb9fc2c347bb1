//! Commands, events and states as fixed-size records, so that a message is a copy.
//!
//! What a client wrote may be anything: [`CommandRecord::command`] and [`QuestionRecord`]'s methods check what they read.

mod command;
mod event;
mod question;
mod state;
mod values;

pub use command::{CommandRecord, TOPICS};
pub use event::EventRecord;
pub use question::{AnswerRecord, MAX_ANSWER, Question, QuestionRecord};
pub use state::{ArmRecord, MAX_AXES, WorldRecord};
pub use values::{MAX_NUMBERS, Numbers, Text};

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;

    use super::*;
    use crate::dvrk::command::{Command, Fault, PoseMessage, StateCommand};
    use crate::dvrk::report::{Event, Report};
    use crate::dvrk::state::{OperatingState, State};
    use crate::error::Code;

    #[test]
    fn commands_survive_the_wire() {
        let pose = PoseMessage {
            frame: "PSM1_base".into(),
            position: [0.1, f64::INFINITY, 0.3],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut commands = vec![
            Command::ServoJp { position: vec![1.0; 8], velocity: vec![2.0; 6] },
            Command::ServoCv([1.0; 6]),
            Command::JawMoveJp(vec![]),
            Command::State(StateCommand::Unknown("dance".into())),
            Command::SetToolType("LARGE_NEEDLE_DRIVER:400006".into()),
            Command::EmulateFault(Fault::StuckJaw),
            Command::EmulateToolPresent(false),
            Command::SetRatio(0.5),
            Command::MoveCp(pose),
        ];
        // Every topic has a command, which goes by its place.
        for topic in TOPICS {
            let few = [1.0; 7];
            let found = [0, 1, 6, 7].into_iter().find_map(|count| {
                Command::of(topic, &few[..count], &[], "a").ok().filter(|c| c.topic() == topic)
            });
            commands.push(found.expect(topic));
        }
        for command in &commands {
            let record = CommandRecord::new(2, command).unwrap();
            assert_eq!(record.command().as_ref(), Ok(command));
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        let refusal = CommandRecord::new(0, &Command::MoveJp(vec![0.0; 100])).unwrap_err();
        assert_eq!(refusal.to_string(), "move_jp = 100 numbers: at most 24");
        let refusal = CommandRecord::new(0, &Command::SetToolType("x".repeat(257))).unwrap_err();
        assert_eq!(refusal.field, "set_tool_type");
        let refusal = Command::of("move_cp", &[0.0; 5], &[], "").unwrap_err();
        assert_eq!(refusal.field, "move_cp");
        let refusal = Command::of("dance", &[], &[], "").unwrap_err();
        assert!(refusal.allowed.contains("servo_jp"), "{refusal}");
        // Nor does what a client writes by itself harm.
        let mut record = CommandRecord::new(0, &Command::Hold).unwrap();
        record.topic = 32;
        assert_eq!(record.command().unwrap_err().code, Code::InvalidCommand);
        record.topic = 3;
        record.numbers.counts = [u32::MAX; 2];
        assert_eq!(record.command().unwrap_err().code, Code::InvalidCommand);
    }

    #[test]
    fn texts_are_cut_between_characters() {
        assert_eq!(Text::new("é").read(), "é");
        assert_eq!(Text::new(&"é".repeat(200)).read(), "é".repeat(128));
    }

    #[test]
    fn events_survive_the_wire() {
        let state = OperatingState { state: State::Fault, is_homed: true, is_busy: false };
        for report in [
            Report::OperatingState(state),
            Report::GoalReached(true),
            Report::Ratio(0.5),
            Report::RatioV(0.25),
            Report::RatioA(1.0),
            Report::ToolType("a".into()),
            Report::EndoscopeType("b".into()),
            Report::Warning("c".into()),
            Report::Error("d".into()),
        ] {
            let event = Event { arm: 1, stamp: 7, report };
            assert_eq!(EventRecord::new(&event).event(), Some(event));
        }
        assert_eq!(EventRecord::zeroed().event(), None);
        assert_eq!(ArmRecord::in_state(state).operating_state(), state);
    }
}
