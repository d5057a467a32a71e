//! Tool and load that the arm reports, as entered in Desk.

use crate::fci::explained;
use franka::{RealtimeConfig, Robot, RobotState};
use moca_msgs::robot::LinkInertial;
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

/// End effector and load, each about its own centre of mass in the flange's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// Tool fixed to the flange.
    pub tool: LinkInertial,
    /// Load that the tool holds.
    pub load: LinkInertial,
}

/// Asks the arm at `host` once; waits for its answer, at most `within`.
///
/// # Errors
/// Why it cannot be reached, and what to do.
pub fn carried(host: &str, within: Duration) -> Result<Carried, String> {
    let (answers, answer) = sync_channel(1);
    let address = host.to_owned();
    // The client raises the thread that it runs on, and waits for an answer without end: then it is left behind.
    let ask = move || {
        let robot = Robot::new_with_log_size(&address, RealtimeConfig::Ignore, 0);
        // Nobody waits any more: nobody is to be told.
        let _ = answers.send(robot.and_then(|robot| robot.read_once()));
    };
    let asked = std::thread::Builder::new().name("fci-payload".into()).spawn(ask);
    asked.map_err(|error| format!("no thread to ask the arm from: {error}"))?;
    match answer.recv_timeout(within) {
        Ok(state) => state.map(|state| Carried::of(&state)).map_err(|error| explained(host, &error)),
        Err(RecvTimeoutError::Timeout) => Err(format!(
            "the arm at {host} has not answered within {} s: its controller accepts and says nothing, as while it starts; wait \
             until Desk shows the arm, or look at plant.arm.host",
            within.as_secs_f64()
        )),
        Err(RecvTimeoutError::Disconnected) => Err("the arm's client panicked".into()),
    }
}

impl Carried {
    fn of(state: &RobotState) -> Self {
        let body = |mass_kg: f64, com_m: [f64; 3], inertia: &[f64; 9]| LinkInertial {
            mass_kg,
            com_m,
            inertia_com: [inertia[0], inertia[3], inertia[6], inertia[4], inertia[7], inertia[8]],
        };
        Self {
            tool: body(state.m_ee, state.F_x_Cee, &state.I_ee),
            load: body(state.m_load, state.F_x_Cload, &state.I_load),
        }
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are handed on unchanged")]
mod tests {
    use super::*;

    #[test]
    fn an_inertia_is_taken_by_rows() {
        let state = RobotState {
            m_ee: 0.73,
            F_x_Cee: [-0.01, 0.0, 0.03],
            I_ee: [1.0, 2.0, 3.0, 2.0, 4.0, 5.0, 3.0, 5.0, 6.0],
            ..RobotState::default()
        };
        let Carried { tool, load } = Carried::of(&state);
        assert_eq!((tool.mass_kg, tool.com_m), (0.73, [-0.01, 0.0, 0.03]));
        assert_eq!(tool.inertia_com, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "xx, xy, xz, yy, yz, zz");
        assert_eq!(load.mass_kg, 0.0);
    }
}
