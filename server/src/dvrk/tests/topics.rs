//! The list of topics against what clients of dVRK look for, and against the commands and events.

use std::collections::BTreeSet;

use super::*;
use crate::dvrk::topics::{Arms, Direction, Need, TOPICS, Topic};

/// What `dvrk.psm` and `dvrk.ecm` need, and what else a real arm has: subscribed, published, services.
const REQUIRED: [&str; 3] = [
    "state_command hold free servo_jp servo_jr servo_jf move_jp move_jr servo_cp move_cp spatial/servo_cf \
     body/servo_cf body/set_cf_orientation_absolute use_gravity_compensation trajectory_j/set_ratio \
     emulate_tool_present jaw/servo_jp jaw/move_jp jaw/servo_jf",
    "operating_state measured_js setpoint_js measured_cp setpoint_cp local/measured_cp local/setpoint_cp \
     measured_cv spatial/measured_cf spatial/jacobian body/measured_cf body/jacobian trajectory_j/ratio \
     jaw/measured_js jaw/setpoint_js",
    "forward_kinematics local/forward_kinematics inverse_kinematics",
];
const OPTIONAL: [&str; 3] = [
    "set_base_frame servo_cs servo_ci trajectory_j/set_ratio_v trajectory_j/set_ratio_a set_tool_type \
     emulate_adapter_present set_endoscope_type",
    "goal_reached desired_state error warning status trajectory_j/ratio_v trajectory_j/ratio_a measured_cs \
     local/measured_cv setpoint_cv period_statistics tool_type tool_type_request arm_clutch IO/adapter IO/tool \
     IO/arm_clutch IO/SUJ_clutch endoscope_type",
    "operating_state crtk_version actuator_to_joint_position",
];

/// What dVRK's component for arms of others (`psm_from_ros`) needs to teleoperate one.
const FROM_ROS: [&str; 2] = [
    "hold free state_command servo_cp servo_jp body/servo_cf use_gravity_compensation jaw/servo_jp",
    "operating_state measured_js setpoint_js measured_cp setpoint_cp measured_cv jaw/measured_js \
     jaw/setpoint_js period_statistics error warning status",
];

const DIRECTIONS: [Direction; 3] = [Direction::Subscribes, Direction::Publishes, Direction::Serves];

fn names(is_meant: impl Fn(&Topic) -> bool) -> BTreeSet<&'static str> {
    TOPICS.iter().filter(|topic| is_meant(topic)).map(|topic| topic.name).collect()
}

#[test]
fn the_list_is_that_of_a_real_arm() {
    for (index, direction) in DIRECTIONS.into_iter().enumerate() {
        for (need, expected) in [(Need::Required, REQUIRED), (Need::Optional, OPTIONAL)] {
            let expected: BTreeSet<&str> = expected[index].split_whitespace().collect();
            let listed = names(|topic| topic.direction == direction && topic.need == need);
            assert_eq!(listed, expected, "{direction:?}, {need:?}");
        }
    }
    for (direction, needed) in DIRECTIONS.into_iter().zip(FROM_ROS) {
        let listed = names(|topic| topic.direction == direction && topic.arms != Arms::Ecm);
        assert!(needed.split_whitespace().all(|name| listed.contains(name)));
    }
    let all: BTreeSet<_> = TOPICS.iter().map(|topic| (topic.name, topic.direction as u8)).collect();
    assert_eq!(all.len(), TOPICS.len(), "a name is listed twice");
}

#[test]
fn every_subscribed_topic_has_a_command_and_every_event_a_topic() {
    use crate::dvrk::Effort::{
        BodyServoCf, BodySetCfOrientationAbsolute, ServoCs, SpatialServoCf, UseGravityCompensation,
    };
    let mut rng = Rng::new(11, 0);
    let mut commands = BTreeSet::new();
    let mut events = BTreeSet::new();
    for mechanism in [Mechanism::Psm(Psm::CLASSIC), Mechanism::Ecm(Ecm::CLASSIC)] {
        let mut script = Script::new(&mechanism);
        for _ in 0..20_000 {
            let command = super::fuzz::command(&mut rng, &mechanism);
            commands.insert(command.topic());
            script.arm.command(&command);
            script.arm.tick();
            script.listen();
        }
        events.extend(script.heard.iter().map(|event| event.what.topic()));
    }
    let rest = [
        BodyServoCf,
        BodySetCfOrientationAbsolute,
        ServoCs,
        SpatialServoCf,
        UseGravityCompensation,
    ];
    commands.extend(rest.map(|effort| Command::Effort(effort).topic()));
    assert_eq!(commands, names(|topic| topic.direction == Direction::Subscribes));
    let published = names(|topic| topic.direction == Direction::Publishes);
    assert!(events.is_subset(&published), "{events:?}");
    assert!(events.len() == 9, "{events:?}");
}
