//! Mode of the arm, from its states and from the requests to it: pure.
//!
//! ```
//! use moca_franka::mode::{Asked, Next, Phase, Said};
//! use moca_msgs::ArmMode;
//!
//! let mut phase = Phase::default();
//! assert_eq!(phase.state(Said::Idle, 0, Asked::Drive), Next::Start);
//! phase.started();
//! assert_eq!(phase.state(Said::Reflex, 1 << 6, Asked::Drive), Next::End);
//! assert_eq!(phase.mode(), ArmMode::Reflex);
//! // A reflex stays until somebody asks for its recovery.
//! assert_eq!(phase.state(Said::Reflex, 1 << 6, Asked::Recover), Next::Recover);
//! ```

use moca_msgs::ArmMode;

/// Mode that a state of the arm reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Said {
    /// Something else: brakes closed, no FCI.
    Other,
    /// On its own controller.
    Idle,
    /// Follows orders.
    Moves,
    /// Guided by hand with its buttons pressed.
    Guided,
    /// Stopped itself.
    Reflex,
    /// Its user stop is pressed.
    UserStopped,
    /// Recovers.
    Recovers,
}

impl Said {
    /// Everything that it can say.
    pub const ALL: [Self; 7] =
        [Self::Other, Self::Idle, Self::Moves, Self::Guided, Self::Reflex, Self::UserStopped, Self::Recovers];
}

/// Request of the loop to the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Asked {
    /// Its own controller.
    #[default]
    Brake,
    /// Torque control.
    Drive,
    /// Its own controller, and a recovery if it had a reflex.
    Recover,
}

/// Next action of the thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Read the next state.
    Read,
    /// Start torque control.
    Start,
    /// Recover from a reflex.
    Recover,
    /// In torque control: answer this state with a torque.
    Answer,
    /// In torque control: end it, the arm's own controller takes over.
    End,
}

/// Mode of the arm, as far as this PC knows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Phase {
    mode: ArmMode,
    /// Torque control was refused, or ended while the loop drove, and is not asked for again before the loop has let go of it.
    refused: bool,
}

impl Phase {
    /// Returns the arm's mode.
    pub const fn mode(&self) -> ArmMode {
        self.mode
    }

    /// Torque control has started.
    pub const fn started(&mut self) {
        self.mode = ArmMode::Torque;
    }

    /// The loop has let go: the arm is on its own controller.
    pub const fn ended(&mut self) {
        self.mode = ArmMode::Idle;
    }

    /// Torque control has ended although the loop drove: by the arm, or because the loop did not answer.
    pub const fn cut_off(&mut self) {
        self.refused = true;
        if self.mode.follows() {
            self.mode = ArmMode::Refused;
        }
    }

    /// The arm stopped itself while it was driven.
    pub const fn aborted(&mut self) {
        (self.mode, self.refused) = (ArmMode::Reflex, true);
    }

    /// Torque control or a connection was refused.
    pub const fn refused(&mut self) {
        (self.mode, self.refused) = (ArmMode::Refused, true);
    }

    /// The arm does not answer any more, or did not at all.
    pub fn lost(&mut self) {
        let reached = !matches!(self.mode, ArmMode::Connecting);
        *self = Self { mode: if reached { ArmMode::Lost } else { ArmMode::Connecting }, refused: false };
    }

    /// A state came.
    pub const fn state(&mut self, said: Said, errors: u64, asked: Asked) -> Next {
        let driven = self.mode.follows();
        self.refused = self.refused && matches!(asked, Asked::Drive);
        self.mode = match said {
            Said::UserStopped => ArmMode::UserStopped,
            Said::Recovers => ArmMode::Recovering,
            Said::Reflex => ArmMode::Reflex,
            _ if errors != 0 => ArmMode::Reflex,
            Said::Moves if driven => ArmMode::Torque,
            Said::Idle if !self.refused => ArmMode::Idle,
            // Moved by somebody else, guided by hand, brakes closed, or it has just refused.
            Said::Idle | Said::Moves | Said::Guided | Said::Other => ArmMode::Refused,
        };
        match (self.mode, asked) {
            (ArmMode::Torque, Asked::Drive) => Next::Answer,
            (_, _) if driven => Next::End,
            (ArmMode::Idle, Asked::Drive) => Next::Start,
            (ArmMode::Reflex, Asked::Recover) => Next::Recover,
            _ => Next::Read,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASKED: [Asked; 3] = [Asked::Brake, Asked::Drive, Asked::Recover];

    /// Every error bit in whatever the arm says it does, driven or not: its mode is right after one state.
    #[test]
    fn every_error_in_every_mode_reaches_its_mode_with_one_state() {
        for bit in 0..moca_msgs::arm_errors::ARM_ERRORS.len() {
            for said in Said::ALL {
                for asked in ASKED {
                    for before in ArmMode::ALL {
                        let mut phase = Phase { mode: before, refused: false };
                        let next = phase.state(said, 1 << bit, asked);
                        let expected = match said {
                            Said::UserStopped => ArmMode::UserStopped,
                            Said::Recovers => ArmMode::Recovering,
                            _ => ArmMode::Reflex,
                        };
                        assert_eq!(phase.mode(), expected, "bit {bit}, {said:?}, {asked:?}, {before:?}");
                        assert!(!matches!(next, Next::Answer | Next::Start), "no torque under an error");
                        assert_eq!(next == Next::End, before.follows(), "whoever drives lets go");
                    }
                }
            }
        }
    }

    #[test]
    fn torque_control_starts_only_from_idle() {
        for said in Said::ALL {
            for asked in ASKED {
                for before in ArmMode::ALL {
                    let mut phase = Phase { mode: before, refused: false };
                    let next = phase.state(said, 0, asked);
                    let starts = said == Said::Idle && asked == Asked::Drive && !before.follows();
                    assert_eq!(next == Next::Start, starts, "{said:?}, {asked:?}, {before:?}");
                    let answers = said == Said::Moves && asked == Asked::Drive && before.follows();
                    assert_eq!(next == Next::Answer, answers, "{said:?}, {asked:?}, {before:?}");
                    assert_eq!(phase.mode().follows(), said == Said::Moves && before.follows());
                }
            }
        }
    }

    #[test]
    fn what_was_refused_is_not_asked_for_again_before_it_was_let_go() {
        let mut phase = Phase::default();
        assert_eq!(phase.state(Said::Idle, 0, Asked::Drive), Next::Start);
        phase.refused();
        assert_eq!(phase.state(Said::Idle, 0, Asked::Drive), Next::Read);
        assert_eq!(phase.mode(), ArmMode::Refused);
        assert_eq!(phase.state(Said::Idle, 0, Asked::Brake), Next::Read);
        assert_eq!(phase.mode(), ArmMode::Idle);
        assert_eq!(phase.state(Said::Idle, 0, Asked::Drive), Next::Start);
    }

    #[test]
    fn cut_torque_control_restarts_only_after_release() {
        for cut_off in [Phase::cut_off, Phase::aborted] {
            for said in Said::ALL {
                let mut phase = Phase::default();
                phase.started();
                cut_off(&mut phase);
                assert!(!matches!(phase.mode(), ArmMode::Idle | ArmMode::Torque));
                phase.state(said, 0, Asked::Drive);
                assert!(!matches!(phase.mode(), ArmMode::Idle | ArmMode::Torque), "{said:?}");
                assert_eq!(phase.state(Said::Idle, 0, Asked::Drive), Next::Read, "{said:?}");
                assert_eq!(phase.mode(), ArmMode::Refused);
                phase.state(Said::Idle, 0, Asked::Brake);
                assert_eq!(phase.state(Said::Idle, 0, Asked::Drive), Next::Start);
            }
        }
        let mut phase = Phase::default();
        phase.started();
        phase.state(Said::Reflex, 1, Asked::Drive);
        phase.cut_off();
        assert_eq!(phase.mode(), ArmMode::Reflex, "why it ended stays");
    }

    #[test]
    fn an_arm_that_was_never_reached_is_not_lost() {
        let mut phase = Phase::default();
        phase.lost();
        assert_eq!(phase.mode(), ArmMode::Connecting);
        phase.state(Said::Idle, 0, Asked::Brake);
        phase.lost();
        assert_eq!(phase.mode(), ArmMode::Lost);
    }
}
