//! How an episode shall begin, where a reset asks for it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::error::{Code, Rejection};

/// What shall be otherwise than a reset left it. Lengths are in m under every preset, in the scene frame. A pose is
/// three numbers, its position (the orientation stays as the reset left it), or six: then also roll, pitch and
/// yaw, extrinsic XYZ Euler angles (rad), R = Rz(yaw)·Ry(pitch)·Rx(roll).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Placement {
    /// The desired goal: a position.
    pub goal: Option<Vec<f64>>,
    /// Poses of objects' own frames, by name.
    pub objects: BTreeMap<String, Vec<f64>>,
    /// The true tip of each instrument's closed jaws, PSM1's then PSM2's; angles are those of the wrist link, as
    /// observations show them.
    pub tip: Option<Vec<f64>>,
}

impl Placement {
    /// Most objects that one names.
    pub const MAX_OBJECTS: usize = 16;

    /// Most numbers of one value.
    pub const MAX_NUMBERS: usize = 16;

    /// Longest name of an object, bytes.
    pub const MAX_NAME: usize = 64;

    /// Whether it asks for nothing.
    pub fn is_empty(&self) -> bool {
        self.goal.is_none() && self.objects.is_empty() && self.tip.is_none()
    }

    /// Whether it can be meant at all, whatever the task: nothing is too long, every number is finite.
    pub fn check(&self) -> Result<(), Rejection> {
        let refuse = |field: &str, value: String, allowed: String| {
            Err(Rejection::new(Code::InvalidOption, field, value, allowed))
        };
        if self.objects.len() > Self::MAX_OBJECTS {
            let found = format!("{} objects", self.objects.len());
            return refuse("options.objects", found, format!("at most {}", Self::MAX_OBJECTS));
        }
        if let Some(name) = self.objects.keys().find(|name| name.len() > Self::MAX_NAME) {
            let allowed = format!("a name has at most {} bytes", Self::MAX_NAME);
            return refuse("options.objects", format!("{name:?}"), allowed);
        }
        let objects = self.objects.iter();
        let named = objects.map(|(name, pose)| (format!("options.objects.{name}"), pose));
        let goal = self.goal.iter().map(|goal| ("options.goal".into(), goal));
        let tip = self.tip.iter().map(|tip| ("options.tip".into(), tip));
        for (field, numbers) in named.chain(goal).chain(tip) {
            if numbers.len() > Self::MAX_NUMBERS {
                let allowed = format!("at most {}", Self::MAX_NUMBERS);
                return refuse(&field, format!("{} numbers", numbers.len()), allowed);
            }
            if !numbers.iter().all(|number| number.is_finite()) {
                return refuse(&field, format!("{numbers:?}"), "every number is finite".into());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(placement: &Placement) -> String {
        placement.check().unwrap_err().field
    }

    #[test]
    fn what_is_too_long_or_not_finite_is_refused_by_name() {
        let good = Placement {
            goal: Some(vec![0.5; 3]),
            objects: [("needle".into(), vec![0.5; 6])].into(),
            tip: Some(vec![0.5; 12]),
        };
        assert_eq!(good.check(), Ok(()));
        let goal = Some(vec![0.5, f64::NAN, 0.5]);
        assert_eq!(refused(&Placement { goal, ..good.clone() }), "options.goal");
        let tip = Some(vec![0.5; 17]);
        assert_eq!(refused(&Placement { tip, ..good.clone() }), "options.tip");
        let objects = [("needle".into(), vec![f64::INFINITY; 3])].into();
        assert_eq!(refused(&Placement { objects, ..good.clone() }), "options.objects.needle");
        let objects = [("n".repeat(65), vec![0.5; 3])].into();
        assert_eq!(refused(&Placement { objects, ..good.clone() }), "options.objects");
        let objects = (0..17).map(|number| (number.to_string(), vec![0.5; 3])).collect();
        assert_eq!(refused(&Placement { objects, ..good }), "options.objects");
    }
}
