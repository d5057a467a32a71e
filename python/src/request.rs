//! Requests by name.

use crate::Refused;
use moca_msgs::params::MAX_ELEMENTS;
use moca_msgs::request::PRESS_FORCE_MAX_N;
use moca_msgs::target::MAX_WAYPOINTS;
use moca_msgs::{
    Law, Outcome, ParameterValues, Request, Target, TimedTarget, TouchPolicy, TwistAxes, Waypoint,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Requests that take no numbers.
const PLAIN: [(&str, Request); 9] = [
    ("tare", Request::Tare),
    ("arm", Request::Arm),
    ("disarm", Request::Disarm),
    ("stop", Request::Stop),
    ("resume", Request::Resume),
    ("end-target", Request::EndTarget),
    ("recentre", Request::Recentre),
    ("impedance", Request::SelectLaw(Law::Impedance)),
    ("follow-me", Request::SelectLaw(Law::FollowMe)),
];

/// One that takes no numbers.
pub(crate) fn plain(name: &str) -> PyResult<Request> {
    let found = PLAIN.iter().find(|(known, _)| *known == name).map(|(_, request)| *request);
    found.ok_or_else(|| {
        let names = PLAIN.map(|(known, _)| known).join(", ");
        PyValueError::new_err(format!("no request is called {name:?}; allowed: {names}"))
    })
}

/// A press of a taxel (0 is T1) of a cover of `count`.
pub(crate) fn press(taxel: u8, force_n: f64, count: usize) -> PyResult<Request> {
    let number = u16::from(taxel) + 1;
    if usize::from(taxel) >= count {
        return Err(PyValueError::new_err(format!("taxel {number}: allowed: 1 (T1) to {count} (T{count})")));
    }
    if !(0.0..=PRESS_FORCE_MAX_N).contains(&force_n) {
        return Err(PyValueError::new_err(format!(
            "force {force_n} N: allowed: 0 (let go) to {PRESS_FORCE_MAX_N} N"
        )));
    }
    Ok(Request::PressTaxel { taxel, force_n })
}

/// Kinds of targets.
const TARGETS: &str = "pose, twist world, twist base, twist flange, posture, base";

/// A target: its kind, its numbers, how old it may become, and what a touch does to it.
pub(crate) fn target(
    kind: &str,
    values: &[f64],
    stamp_unix_ns: u64,
    age_limit_s: f64,
    touch: &str,
) -> PyResult<Request> {
    let axes = match kind {
        "twist base" => TwistAxes::Base,
        "twist flange" => TwistAxes::Flange,
        _ => TwistAxes::World,
    };
    let target = match kind {
        "pose" => {
            let [x, y, z, qx, qy, qz, qw] = exactly(values, "a position in m and a quaternion x, y, z, w")?;
            Target::Pose { position_world: [x, y, z], quaternion_world: [qx, qy, qz, qw] }
        }
        "twist world" | "twist base" | "twist flange" => {
            Target::Twist { axes, twist: exactly(values, "a twist in m/s and rad/s")? }
        }
        "posture" => {
            let q_rad = ParameterValues::new(values);
            Target::Posture(q_rad.ok_or_else(|| counted(values.len(), "joint angles in rad", MAX_ELEMENTS))?)
        }
        "base" => Target::BaseVelocity { velocity_body: exactly(values, "a velocity in m/s, m/s, rad/s")? },
        _ => return Err(PyValueError::new_err(format!("no target is called {kind:?}; allowed: {TARGETS}"))),
    };
    let touch = policy(touch)?;
    Ok(Request::Target(TimedTarget { target, stamp_unix_ns, age_s: 0.0, age_limit_s, touch }))
}

pub(crate) fn policy(touch: &str) -> PyResult<TouchPolicy> {
    match touch {
        "wins" => Ok(TouchPolicy::TouchWins),
        "pass-through" => Ok(TouchPolicy::PassThrough),
        _ => Err(PyValueError::new_err(format!("touch = {touch:?}: allowed: \"wins\", \"pass-through\""))),
    }
}

/// Rows of time, position, quaternion: as many as a trajectory may have.
pub(crate) fn waypoints(rows: &[f64]) -> PyResult<Vec<Waypoint>> {
    let count = rows.len().div_ceil(8);
    if count == 0 || count > MAX_WAYPOINTS {
        return Err(counted(count, "poses of a trajectory", MAX_WAYPOINTS));
    }
    rows.chunks(8)
        .map(|row| {
            let [time_s, x, y, z, qx, qy, qz, qw] =
                exactly(row, "a time in s, a position in m and a quaternion x, y, z, w")?;
            Ok(Waypoint { time_s, position_world: [x, y, z], quaternion_world: [qx, qy, qz, qw] })
        })
        .collect()
}

/// Refuses a number of things, from 1 to `most`.
pub(crate) fn counted(count: usize, what: &str, most: usize) -> PyErr {
    PyValueError::new_err(format!("{count} {what}: allowed: 1 to {most}"))
}

pub(crate) fn exactly<const N: usize>(values: &[f64], what: &str) -> PyResult<[f64; N]> {
    let wrong = |_| PyValueError::new_err(format!("{} numbers for {what}: {N} are needed", values.len()));
    values.try_into().map_err(wrong)
}

pub(crate) fn answered(request: Request, outcome: Outcome) -> PyResult<()> {
    outcome.map_err(|refusal| Refused::new_err(request.refused(refusal).to_string()))
}
