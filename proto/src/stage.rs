//! Stages of a task: what its scripted expert is about, in words that all tasks share.

/// What is done next in a state, seen from that state alone. Demonstrations are labelled with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
#[repr(u8)]
pub enum Stage {
    /// Go to the goal and stay there: all there is to tasks in which nothing is picked up.
    #[default]
    Reach = 0,
    /// Bring open jaws about the object.
    Approach = 1,
    /// Close the jaws on it.
    Pick = 2,
    /// Lift it.
    Lift = 3,
    /// Bring it to where it is to be, or to be handed over; stay there if that is the goal.
    Carry = 4,
    /// Give it from one arm to the other.
    HandOver = 5,
    /// Let it down, let it go and leave.
    Place = 6,
}

impl Stage {
    /// All of them, by number.
    pub const ALL: [Self; 7] = [
        Self::Reach,
        Self::Approach,
        Self::Pick,
        Self::Lift,
        Self::Carry,
        Self::HandOver,
        Self::Place,
    ];

    /// Its name in data, e.g. `hand_over`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reach => "reach",
            Self::Approach => "approach",
            Self::Pick => "pick",
            Self::Lift => "lift",
            Self::Carry => "carry",
            Self::HandOver => "hand_over",
            Self::Place => "place",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_numbered_in_order_and_named_apart() {
        for (number, stage) in Stage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, number);
            assert_eq!(Stage::ALL.iter().filter(|other| other.name() == stage.name()).count(), 1);
        }
    }
}
