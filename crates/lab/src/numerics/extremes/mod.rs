//! `moca-lab extremes`: the ends of the controllers' range, one row each: condition, error in both precisions, time,
//! verdict.

use crate::study::{self, Answer, Column};
use moca_experiments::timed::{Controller, Timed as _};
use moca_experiments::{JOINTS, TAXELS};
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_msgs::{Limits, Parameters, Payload, RobotState};
use moca_wbc::testing::accuracy::{Case, Reference, Step, accuracy, admitted};
use moca_wbc::{ControlInput, ControlLaw, ControllerState, rotation};
use serde::Serialize;
use std::hint::black_box;
use std::time::Instant;

/// Steps per timed pass, and passes of which the fastest counts.
const STEPS: u32 = 200;
const PASSES: u32 = 20;
/// Largest factor, over the condition number, by which rounding may be amplified.
const AMPLIFICATION: f64 = 16.0;

/// Accuracy and time at the ends of the controllers' range.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    answer: Answer,
}

#[derive(Serialize)]
struct Report {
    rows: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    name: String,
    /// Condition number of the weighted Λ⁻¹; null where it is singular or there is none.
    condition: Option<f64>,
    error_f64: Option<f64>,
    error_f32: Option<f64>,
    ns_per_tick: f64,
    verdict: String,
    passed: bool,
}

const COLUMNS: &[Column<Row>] = &[
    ("end", |row| row.name.clone()),
    ("condition", |row| shown(row.condition)),
    ("error f64", |row| shown(row.error_f64)),
    ("error f32", |row| shown(row.error_f32)),
    ("ns/tick", |row| format!("{:.0}", row.ns_per_tick)),
    ("verdict", |row| format!("{}{}", if row.passed { "" } else { "FAILED: " }, row.verdict)),
];

fn shown(value: Option<f64>) -> String {
    value.map_or("-".into(), |value| format!("{value:.1e}"))
}

/// Errs if an end behaves otherwise than it should.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let reference: Reference =
        serde_json::from_str(include_str!("../../../../../tests/fixtures/extremes.json"))?;
    let mut rows = Vec::new();
    for case in &reference.cases {
        rows.push(law(case)?);
    }
    for dt in [1e-4, 1e-3, 1e-2] {
        rows.push(admittance(dt, &reference.admittance)?);
    }
    rows.push(strong_push()?);
    rows.extend(not_finite()?);
    rows.push(sign_flip()?);
    rows.push(half_turn()?);
    let report = Report { rows };
    arguments.answer.print(&report, || Ok(study::table(COLUMNS, &report.rows)))?;
    let failed: Vec<&str> =
        report.rows.iter().filter(|row| !row.passed).map(|row| row.name.as_str()).collect();
    anyhow::ensure!(failed.is_empty(), "not as expected: {}", failed.join(", "));
    Ok(())
}

/// Torques and damping at one configuration. Rounding may grow with the condition number, not more.
fn law(case: &Case) -> anyhow::Result<Row> {
    let (double, single) = (accuracy::<f64>(case)?, accuracy::<f32>(case)?);
    let (error_f64, error_f32) = (double.force.max(double.damping), single.force.max(single.damping));
    let allowed = |epsilon: f64, shift: f64| match case.condition {
        // beyond 1/epsilon the singular direction is lost, and with it the torque that belongs to it
        Some(condition) => AMPLIFICATION * epsilon * condition.min(1.0 / epsilon),
        None => shift,
    };
    let passed = error_f64 <= allowed(f64::EPSILON, 1e-6)
        && error_f32 <= allowed(f64::from(f32::EPSILON), 0.1)
        && double.largest_nm < 87.0
        && single.largest_nm < 87.0;
    let verdict = match (case.condition, error_f64, error_f32) {
        (None, ..) => "singular: the direction that cannot move gets no torque".into(),
        (_, double, single) if double < 1e-10 && single < 1e-4 => "accurate".into(),
        (_, double, _) if double < 1e-5 => {
            "digits lost to the condition; in f32 the singular direction".into()
        }
        _ => format!("singular to rounding: largest torque {:.1} N·m", double.largest_nm),
    };
    let mut parameters = Parameters::PAPER;
    parameters.gains.virtual_mass = case.virtual_mass;
    parameters.gains.stiffness = case.stiffness;
    parameters.gains.eta_base = case.eta_base;
    parameters.gains.eta_arm = case.eta_arm;
    let mut robot = at_home();
    robot.base_pose_world.copy_from_slice(&case.q[..3]);
    robot.q_rad.copy_from_slice(&case.q[3..]);
    let ns_per_tick = timed(&parameters, &input(robot))?;
    Ok(Row {
        name: case.name.clone(),
        condition: case.condition,
        error_f64: Some(error_f64),
        error_f32: Some(error_f32),
        ns_per_tick,
        verdict,
        passed,
    })
}

/// eq. (2) over all masses and dampings at one step.
#[expect(clippy::float_cmp, reason = "the file holds these very steps")]
fn admittance(dt: f64, steps: &[Step]) -> anyhow::Result<Row> {
    let steps: Vec<&Step> = steps.iter().filter(|step| step.dt == dt).collect();
    let worst = |error: fn(&Step) -> f64| {
        steps.iter().map(|step| error(step)).fold(0.0_f64, |worst, e| if e <= worst { worst } else { e })
    };
    let (error_f64, error_f32) = (worst(admitted::<f64>), worst(admitted::<f32>));
    let parameters =
        Parameters { limits: Limits { period_s: dt, ..Limits::for_arm(&PANDA) }, ..Parameters::PAPER };
    let mut input = input(at_home());
    input.dt_s = dt;
    Ok(Row {
        name: format!("step {:.1} ms, D dt/M 0 to {:.0e}", dt * 1e3, 1e5 * dt / 0.01),
        condition: None,
        error_f64: Some(error_f64),
        error_f32: Some(error_f32),
        ns_per_tick: timed(&parameters, &input)?,
        verdict: format!("eq. (2) exact, {} cases, D = 0 among them", steps.len()),
        passed: !steps.is_empty() && error_f64 < 1e-15 && error_f32 < 1e-6,
    })
}

/// 10 kN on one taxel.
fn strong_push() -> anyhow::Result<Row> {
    let mut strong = input(at_home());
    strong.taxel_force_n[5] = 1e4;
    let (controller, mut state) = entered()?;
    let output = f64::step(&controller, &mut state, &strong)?;
    let believed = output.cover_wrench_base[0].abs();
    let most = Limits::for_arm(&PANDA).taxel_force_n;
    Ok(Row {
        name: "taxel force 1e4 N".into(),
        condition: None,
        error_f64: None,
        error_f32: None,
        ns_per_tick: timed(&Parameters::PAPER, &strong)?,
        verdict: format!("taken as {believed:.0} N"),
        passed: output.limits.taxel_force && (believed - most).abs() < 1e-9,
    })
}

/// NaN and infinity in each input: an error, and a state that is as it was.
fn not_finite() -> anyhow::Result<Vec<Row>> {
    type Spoil = fn(&mut ControlInput<JOINTS, TAXELS>, f64);
    let inputs: [(&str, Spoil); 8] = [
        ("base pose", |i, x| i.robot.base_pose_world[1] = x),
        ("base velocity", |i, x| i.robot.base_velocity_world[2] = x),
        ("joint angle", |i, x| i.robot.q_rad[3] = x),
        ("joint rate", |i, x| i.robot.dq_rad_s[6] = x),
        ("measured torque", |i, x| i.robot.torque_measured_nm[0] = x),
        ("taxel force", |i, x| i.taxel_force_n[4] = x),
        ("flange wrench", |i, x| i.flange_wrench_world = Some([x; 6])),
        ("step", |i, x| i.dt_s = x),
    ];
    let mut rows = Vec::new();
    for (name, spoil) in inputs {
        let (controller, state) = entered()?;
        let mut verdict = String::new();
        let mut passed = true;
        let start = Instant::now();
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut input = input(at_home());
            spoil(&mut input, bad);
            let mut after = state;
            let outcome = f64::step(&controller, &mut after, &input);
            passed &= outcome.is_err() && after == state;
            verdict = outcome.err().map_or("accepted".into(), |error| format!("refused: {error}"));
        }
        rows.push(Row {
            name: format!("NaN, inf: {name}"),
            condition: None,
            error_f64: None,
            error_f32: None,
            ns_per_tick: start.elapsed().as_secs_f64() * 1e9 / 3.0,
            verdict,
            passed,
        });
    }
    Ok(rows)
}

/// A target quaternion and its negative.
fn sign_flip() -> anyhow::Result<Row> {
    let (controller, state) = entered()?;
    let (mut plus, mut minus) = (state, state);
    let quaternion = rotation::to_quaternion(&rotation::from_rpy([3.0, 0.2, -0.4]));
    plus.set_target_pose([0.5, 0.0, 1.1], quaternion)?;
    minus.set_target_pose([0.5, 0.0, 1.1], quaternion.map(|x| -x))?;
    let mut error = 0.0_f64;
    for _ in 0..100 {
        let input = input(at_home());
        let a = f64::step(&controller, &mut plus, &input)?.command.arm_torque_nm;
        let b = f64::step(&controller, &mut minus, &input)?.command.arm_torque_nm;
        error = a.iter().zip(b).fold(error, |worst, (a, b)| worst.max((a - b).abs()));
    }
    Ok(Row {
        name: "quaternion sign flip".into(),
        condition: None,
        error_f64: Some(error),
        error_f32: None,
        ns_per_tick: timed(&Parameters::PAPER, &input(at_home()))?,
        verdict: "the same rotation".into(),
        passed: error < 1e-12,
    })
}

/// Orientation errors of exactly half a turn about many axes.
fn half_turn() -> anyhow::Result<Row> {
    fn worst<T: moca_wbc::Scalar>() -> f64 {
        let of = nalgebra::convert::<f64, T>;
        let mut worst = 0.0_f64;
        for step in 0..1000_u32 {
            let angle = f64::from(step) * 0.1;
            let axis = nalgebra::Vector3::new(angle.sin(), angle.cos(), (3.0 * angle).sin()).normalize();
            // 2 a aᵀ − I: half a turn about the axis
            let half = axis * axis.transpose() * 2.0 - nalgebra::Matrix3::identity();
            let error = rotation::error(&nalgebra::Matrix3::identity(), &half.map(of));
            let length: f64 = nalgebra::try_convert(error.norm()).unwrap_or(f64::NAN);
            let gap = (length - std::f64::consts::PI).abs();
            worst = if gap <= worst { worst } else { gap };
        }
        worst
    }
    let (error_f64, error_f32) = (worst::<f64>(), worst::<f32>());
    Ok(Row {
        name: "orientation error of pi".into(),
        condition: None,
        error_f64: Some(error_f64),
        error_f32: Some(error_f32),
        ns_per_tick: timed(&Parameters::PAPER, &input(at_home()))?,
        verdict: "one of the two axes, length pi; its pull saturates".into(),
        passed: error_f64 < 1e-7 && error_f32 < 2e-3,
    })
}

/// Fastest of several passes of the whole step, ns.
fn timed(parameters: &Parameters<JOINTS>, input: &ControlInput<JOINTS, TAXELS>) -> anyhow::Result<f64> {
    let controller = controller(parameters)?;
    let mut state = controller.enter(ControlLaw::Impedance, &input.robot)?;
    let mut least = f64::INFINITY;
    for _ in 0..PASSES {
        let start = Instant::now();
        for _ in 0..STEPS {
            black_box(f64::step(&controller, &mut state, black_box(input))?);
        }
        least = least.min(start.elapsed().as_secs_f64() * 1e9 / f64::from(STEPS));
    }
    Ok(least)
}

fn controller(parameters: &Parameters<JOINTS>) -> anyhow::Result<Controller> {
    Ok(Controller::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, parameters)?)
}

fn entered() -> anyhow::Result<(Controller, ControllerState<JOINTS>)> {
    let controller = controller(&Parameters::PAPER)?;
    let state = controller.enter(ControlLaw::Impedance, &at_home())?;
    Ok((controller, state))
}

fn at_home() -> RobotState<JOINTS> {
    RobotState { flange_wrench_world: Some([0.0; 6]), ..RobotState::at_rest(PANDA.home_rad) }
}

fn input(robot: RobotState<JOINTS>) -> ControlInput<JOINTS, TAXELS> {
    ControlInput::new(robot, [0.0; TAXELS], 1e-3)
}
