//! Trocar's own tasks: what is known of each without making it, so that clients have it without a server.

/// What is fixed of a task, under all of its options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaskInfo {
    /// Name with version, e.g. `NeedleReach-v0`.
    pub id: &'static str,
    /// One sentence for people.
    pub summary: &'static str,
    /// Steps of an episode at the nominal rate.
    pub steps: u32,
    /// The nominal rate, at which the task's numbers are those of its description, Hz.
    pub hertz: f64,
    /// What kind of task it is; tests choose tasks by these. See [`TAGS`].
    pub tags: &'static [&'static str],
}

impl TaskInfo {
    /// Whether the task has a tag.
    pub fn has(&self, tag: &str) -> bool {
        self.tags.contains(&tag)
    }
}

/// The tags that Trocar's own tasks have, and what they mean.
pub const TAGS: [(&str, &str); 6] = [
    ("psm", "moves instruments"),
    ("grasp", "an object is held in the jaws"),
    ("tissue", "what is held is soft"),
    ("bimanual", "two arms work together"),
    ("camera", "moves the endoscope"),
    ("endless", "has no goal: its reward is a function of the state"),
];

/// The nominal rate of tasks that move instruments, Hz.
pub const PSM_HERTZ: f64 = 5.0;

/// The nominal rate of tasks that move the endoscope, Hz.
pub const ECM_HERTZ: f64 = 10.0;

macro_rules! builtin {
    ($($name:ident: $id:literal, $summary:literal, $steps:literal at $hertz:ident, [$($tag:literal),*];)*) => {
        $(
            #[doc = $summary]
            pub const $name: TaskInfo = TaskInfo {
                id: $id,
                summary: $summary,
                steps: $steps,
                hertz: $hertz,
                tags: &[$($tag),*],
            };
        )*

        /// All of them.
        pub const ALL: &[TaskInfo] = &[$($name),*];
    };
}

builtin! {
    NEEDLE_REACH: "NeedleReach-v0", "Move the closed jaw tip to a point just above a needle.",
        50 at PSM_HERTZ, ["psm"];
    NEEDLE_PICK: "NeedlePick-v0", "Pick up a needle and bring the middle of its arc to a point.",
        50 at PSM_HERTZ, ["psm", "grasp"];
    GAUZE_RETRIEVE: "GauzeRetrieve-v0", "Pick up a gauze and bring its middle to a point.",
        50 at PSM_HERTZ, ["psm", "grasp"];
    PEG_TRANSFER: "PegTransfer-v0", "Take a block from its peg to another one.",
        50 at PSM_HERTZ, ["psm", "grasp"];
    NEEDLE_REGRASP: "NeedleRegrasp-v0", "Hand a needle from one arm to the other, which brings it to a point.",
        50 at PSM_HERTZ, ["psm", "grasp", "bimanual"];
    BI_PEG_TRANSFER: "BiPegTransfer-v0", "Take a block to the other arm, which puts it onto a peg.",
        50 at PSM_HERTZ, ["psm", "grasp", "bimanual"];
    ECM_REACH: "EcmReach-v0", "Move the endoscope to a position.", 50 at ECM_HERTZ, ["camera"];
    MIS_ORIENT: "MisOrient-v0", "Roll the endoscope until its picture is level.", 50 at ECM_HERTZ, ["camera"];
    STATIC_TRACK: "StaticTrack-v0", "Centre a cube among others in the endoscope's picture.",
        50 at ECM_HERTZ, ["camera"];
    ACTIVE_TRACK: "ActiveTrack-v0", "Follow a moving cube with the endoscope.",
        500 at ECM_HERTZ, ["camera", "endless"];
    CYLINDER_PICK: "CylinderPick-v0", "Pick up a standing cylinder and bring it to a point.",
        50 at PSM_HERTZ, ["psm", "grasp"];
    CYLINDER_REACH: "CylinderReach-v0", "Move the closed jaw tip to a point just above a standing cylinder.",
        50 at PSM_HERTZ, ["psm"];
    TISSUE_RETRACT: "TissueRetract-v0", "Lift the edge of a sheet of fat and expose what lies under it.",
        60 at PSM_HERTZ, ["psm", "tissue"];
    TISSUE_POINT: "TissuePoint-v0", "Bring a marked point of a sheet of fat to a place.",
        60 at PSM_HERTZ, ["psm", "tissue"];
    GAUZE_PLACE: "GauzePlace-v0", "Lay a soft gauze on a spot and let go of it.",
        60 at PSM_HERTZ, ["psm", "tissue"];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_are_those_that_are_explained_and_each_is_some_tasks() {
        let known = TAGS.map(|(tag, _)| tag);
        assert!(ALL.iter().flat_map(|task| task.tags).all(|tag| known.contains(tag)));
        assert!(known.iter().all(|tag| ALL.iter().any(|task| task.has(tag))));
    }
}
