//! Compares what Python clients saw with a twin in this process, by checksums.

use std::sync::mpsc::{Receiver, Sender};
use std::thread;

use super::twin::Twin;
use super::worker::Report;

/// What clients say, by their numbers; `None` at the end.
pub(super) type Line = (usize, Option<String>);

/// Passes on what a client says, and also says where its checksums are not those of its twin. The
/// end is passed on when everything was compared.
pub(super) fn start(mut twin: Twin, lines: Receiver<Line>, reports: Sender<Line>) {
    thread::spawn(move || {
        let mut compared = Compared { session: 0, rounds: 0, checksum: 0, differs: false };
        for (number, line) in lines {
            let report: Option<Report> =
                line.as_deref().and_then(|line| serde_json::from_str(line).ok());
            if reports.send((number, line)).is_err() {
                return;
            }
            let Some(report) = report else { continue };
            if let Some(mismatch) = compared.with(&report, &mut twin) {
                let report = Report { mismatch: Some(mismatch), ..Report::default() };
                let line = serde_json::to_string(&report).expect("numbers and text become JSON");
                if reports.send((number, Some(line))).is_err() {
                    return;
                }
            }
        }
    });
}

/// How far a client was followed.
struct Compared {
    session: u64,
    rounds: u64,
    checksum: u32,
    differs: bool,
}

impl Compared {
    /// Follows a client up to what it reports; says what is amiss, once in a session.
    fn with(&mut self, report: &Report, twin: &mut Twin) -> Option<String> {
        let expected = report.checksum?;
        if report.session != self.session {
            twin.reset();
            let checksum = twin.checksum(0);
            *self = Self { session: report.session, rounds: 0, checksum, differs: false };
        }
        if self.differs {
            return None;
        }
        while self.rounds < report.rounds {
            if let Err(error) = twin.step() {
                self.differs = true;
                return Some(format!("the twin failed: {error:#}"));
            }
            self.checksum = twin.checksum(self.checksum);
            self.rounds += 1;
        }
        self.differs = self.checksum != expected;
        self.differs.then(|| format!("the checksum after {} steps differs", self.rounds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_checksum_is_told_once_in_a_session() {
        let twin = || Twin::new("EcmReach-v0", 2, 6).unwrap();
        let mut client = twin();
        client.reset();
        let mut sum = client.checksum(0);
        for _ in 0..3 {
            client.step().unwrap();
            sum = client.checksum(sum);
        }
        let report = |session, rounds, checksum| Report {
            session,
            rounds,
            checksum: Some(checksum),
            ..Report::default()
        };
        let mut compared = Compared { session: 0, rounds: 0, checksum: 0, differs: false };
        let mut twin = twin();
        assert_eq!(compared.with(&Report::default(), &mut twin), None);
        assert_eq!(compared.with(&report(1, 3, sum), &mut twin), None);
        assert_eq!(compared.with(&report(2, 3, sum), &mut twin), None);
        let told = compared.with(&report(3, 3, sum ^ 1), &mut twin);
        assert!(told.unwrap().contains("after 3 steps"));
        assert_eq!(compared.with(&report(3, 4, sum), &mut twin), None);
        assert_eq!(compared.with(&report(4, 3, sum), &mut twin), None);
    }
}
