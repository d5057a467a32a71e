//! Requirements on the experiments, each with its bound.

use super::push::{self, Outcome, Push};
use super::pushes;
use moca_experiments::TAXELS;
use moca_experiments::closed_loop::{Rig, Row};
use moca_experiments::collision;
use moca_experiments::settings::Settings;
use moca_msgs::Law;

fn settings(assignments: &[&str]) -> Settings {
    let mut settings = Settings::paper(Law::Impedance);
    settings.set_all(assignments).unwrap();
    settings
}

const LITERAL: &[&str] = &["sensor=ideal"];
const NULL_SPACE: &[&str] = &["sensor=ideal", "null_space_damping=true"];
const COUPLED: &[&str] = &["sensor=ideal", "null_space_damping=true", "base_coupling=true"];

fn push(taxels: &[usize], newton: f64, assignments: &[&str]) -> Outcome {
    run(&push::single(taxels, newton), assignments)
}

fn run(push: &Push, assignments: &[&str]) -> Outcome {
    let settings = settings(assignments);
    let mut rig = Rig::start(&settings, &settings.free_scene()).unwrap();
    let outcome = push::run(&mut rig, &settings, std::slice::from_ref(push)).unwrap().pop();
    assert_eq!(rig.stopped, None);
    outcome.unwrap()
}

/// Largest difference of base, arm and flange (m, rad) and of forces on taxels (N) along two runs.
fn apart(one: &Rig, other: &Rig) -> (f64, f64) {
    assert_eq!((one.rows.len(), &one.stopped), (other.rows.len(), &other.stopped));
    let largest = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    one.rows.iter().zip(&other.rows).fold((0.0f64, 0.0f64), |(place, force), (a, b)| {
        let [of_a, of_b] =
            [a, b].map(|row| [&row.base_pose_world[..], &row.q_rad, &row.flange_world].concat());
        (place.max(largest(&of_a, &of_b)), force.max(largest(&a.force_true, &b.force_true)))
    })
}

#[test]
fn the_closed_loop_goes_the_same_way_on_either_engine() {
    const ENGINES: [&str; 2] = ["engine=mujoco", "engine=analytic"];
    let pushes = [push::single(&[0], 20.0), Push::taxels("pull", &[(5, 10.0)]).and_flange([0.0, 15.0, 5.0])];
    for sensor in ["sensor=ideal", "sensor=stock"] {
        let [one, other] = ENGINES.map(|engine| {
            let settings = settings(&[sensor, engine]);
            let mut rig = Rig::start(&settings, &settings.free_scene()).unwrap();
            push::run(&mut rig, &settings, &pushes).unwrap();
            rig
        });
        let (place, force_n) = apart(&one, &other);
        println!("pushes, {sensor}: {place:.1e} m, rad; {force_n:.1e} N");
        assert!(place < 1e-9 && force_n < 1e-9, "{place:e} {force_n:e}");
    }
    for taxel in ["person.taxel=T1", "person.taxel=T6"] {
        let [one, other] = ENGINES.map(|engine| {
            let mut settings = Settings::paper(Law::Impedance);
            collision::defaults(&mut settings);
            settings.set_all(["sensor=ideal", "duration=5", taxel, engine]).unwrap();
            collision::once(&settings).unwrap()
        });
        let (place, force_n) = apart(&one, &other);
        println!("collision, {taxel}: {place:.1e} m, rad; {force_n:.1e} N");
        assert!(place < 1e-9 && force_n < 1e-7, "{place:e} {force_n:e}");
        assert!(one.rows.iter().any(|row| row.total_force_n > 5.0), "{taxel}: nobody was met");
    }
}

#[test]
fn a_push_is_as_hard_as_its_scale_says() {
    let half = push(&[5], 20.0, &["sensor=ideal", "push.scale=0.5"]).base_displacement;
    let other = push(&[5], 10.0, LITERAL).base_displacement;
    assert_eq!(half.map(f64::to_bits), other.map(f64::to_bits));
    assert!(half[0] < -0.04, "{half:?}");
}

#[test]
fn b1_i_a_lifted_flange_is_a_spring() {
    let lift = Push::taxels("lift", &[]).and_flange([0.0, 0.0, 15.0]);
    let outcome = run(&lift, LITERAL);
    // 15 N against 800 N/m.
    assert!((1e3 * outcome.flange_displacement[2] - 18.75).abs() < 0.3, "{outcome:?}");
}

#[test]
fn b1_ii_t1_moves_the_base_sideways_and_turns_it() {
    for (assignments, flange_mm) in [(LITERAL, 10.0), (NULL_SPACE, 2.5), (COUPLED, 1.0)] {
        let outcome = push(&[0], 20.0, assignments);
        assert!(outcome.base_displacement[1] < -0.2 && outcome.base_displacement[2] > 0.2, "{outcome:?}");
        assert!(outcome.flange_max_mm < flange_mm, "{assignments:?} {outcome:?}");
    }
}

#[test]
fn b1_iii_t6_is_a_pure_translation() {
    for (assignments, flange_mm) in [(LITERAL, 15.0), (NULL_SPACE, 3.0), (COUPLED, 1.0)] {
        let outcome = push(&[5], 20.0, assignments);
        let [x, y, yaw] = outcome.base_displacement;
        assert!(x < -0.08 && y.abs() < 2e-3 && yaw.abs() < 2e-3, "{outcome:?}");
        assert!(outcome.flange_max_mm < flange_mm, "{assignments:?} {outcome:?}");
    }
}

#[test]
fn b1_iv_opposite_corners_are_pure_yaw_and_mirror_images() {
    let left = push(&[3, 7], 15.0, LITERAL);
    let right = push(&[0, 10], 15.0, LITERAL);
    for outcome in [&left, &right] {
        assert!(outcome.wrench_true[0].abs() < 1e-9 && outcome.wrench_true[1].abs() < 1e-9, "{outcome:?}");
    }
    assert!((left.wrench_true[2] + 11.0).abs() < 0.01, "{left:?}");
    assert!(left.base_displacement[2] < -0.25, "{left:?}");
    assert!((left.base_displacement[2] + right.base_displacement[2]).abs() < 1e-3, "{left:?} {right:?}");
    assert!((left.base_displacement[1] + right.base_displacement[1]).abs() < 1e-3, "{left:?} {right:?}");
}

/// Two pushes of 20 N take the base far from the flange before the last two turn it: the arm is stretched when it has to make up
/// for a base that makes room.
#[test]
fn b1_in_one_go_runs_through_under_the_contact_barrier() {
    for firmware in ["moca", "stock-2018"] {
        let assignments = ["board.model=pu-ld30", "barrier=pu-ld30", &format!("sensor.firmware={firmware}")];
        let settings = settings(&assignments);
        let mut rig = Rig::start(&settings, &settings.free_scene()).unwrap();
        let outcomes = push::run(&mut rig, &settings, &pushes::pushes_b1()).unwrap();
        assert_eq!((outcomes.len(), rig.stopped), (5, None), "{firmware}");
    }
}

#[test]
fn feedforward_lets_base_follow_flange_push() {
    let sideways = Push::taxels("sideways", &[]).and_flange([0.0, 15.0, 0.0]);
    let literal = run(&sideways, LITERAL);
    let fed = run(&sideways, &["sensor=ideal", "flange_wrench_feedforward=true"]);
    // Without it the flange gives way by half of 15 N / (800 N/m), and the base drifts against the push.
    assert!((6.0..11.0).contains(&(1e3 * literal.flange_displacement[1])), "{literal:?}");
    assert!(literal.base_displacement[1] < -0.005, "{literal:?}");
    assert!((16.5..20.0).contains(&fed.flange_max_mm), "{fed:?}");
    assert!(fed.base_displacement[1] > 0.1, "{fed:?}");
}

#[test]
fn a_stock_board_keeps_signs_and_pure_motions() {
    let t6 = push(&[5], 20.0, &[]);
    let [x, y, yaw] = t6.base_displacement;
    assert!(x < -0.02 && y.abs() < 0.01 && yaw.abs() < 0.01, "{t6:?}");
    assert!(t6.wrench_sensed[0] < -5.0, "{t6:?}");
    let t1 = push(&[0], 20.0, &[]);
    assert!(t1.base_displacement[1] < -0.05 && t1.base_displacement[2] > 0.05, "{t1:?}");
    let corners = push(&[3, 7], 15.0, &[]);
    assert!(corners.base_displacement[2] < -0.1, "{corners:?}");
}

#[test]
fn a_push_held_for_a_minute_stays_bounded() {
    let settings = settings(&["sensor=ideal", "push_s=60", "rest_s=0"]);
    let mut rig = Rig::start(&settings, &settings.free_scene()).unwrap();
    let outcome = push::run(&mut rig, &settings, &[push::single(&[5], 20.0)]).unwrap().pop().unwrap();
    assert_eq!(rig.stopped, None);
    for (joint, (min, max)) in
        moca_msgs::robot::PANDA.q_min_rad.iter().zip(moca_msgs::robot::PANDA.q_max_rad).enumerate()
    {
        assert!(rig.rows.iter().all(|row| (*min..max).contains(&row.q_rad[joint])), "joint {}", joint + 1);
    }
    assert!(outcome.flange_max_mm < 15.0, "{outcome:?}");
    // Held back by the arm's posture, not running away and not swinging: the last 20 s stand still.
    let settled = &rig.rows[39_000..59_000];
    let (least, most) = settled
        .iter()
        .map(|row| row.base_pose_world[0])
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), x| (l.min(x), m.max(x)));
    assert!(most - least < 0.02 && least > -1.0, "between {least} and {most} m");
}

#[test]
fn b2_the_base_follows_hands_on_cover_and_flange() {
    let run = pushes::b2(&{
        let mut settings = Settings::paper(Law::FollowMe);
        settings.set("sensor=ideal").unwrap();
        settings
    })
    .unwrap();
    let [led, t1, pair, _, opposite] = &run.report.pushes[..] else { panic!("five pushes") };
    assert!(led.base_displacement[0] > 0.3 && led.arm_residual_rad < 1e-3, "{led:?}");
    assert!(t1.base_displacement[1] < -0.1 && t1.base_displacement[2] > 0.05, "{t1:?}");
    assert!(pair.base_displacement[2].abs() < 1e-3, "{pair:?}");
    assert!(opposite.base_displacement[0].hypot(opposite.base_displacement[1]) < 5e-3, "{opposite:?}");
    let [cover, flange, both] = run.report.superposition_m_s.unwrap();
    assert!(cover > 0.1 && ((cover + flange) / both - 1.0).abs() < 0.01, "{cover} {flange} {both}");
}

/// The robot's own estimate has the sign of the force on the robot, and nearly its size, while the base runs away under it.
#[test]
fn b2_base_follows_observed_flange_wrench() {
    let follow = |assignments: &[&str]| {
        let mut settings = Settings::paper(Law::FollowMe);
        settings.set_all(LITERAL.iter().chain(assignments)).unwrap();
        pushes::b2(&settings).unwrap().report
    };
    let (truly, observed) = (follow(&[]), follow(&["flange=observed"]));
    for (a, b) in truly.pushes.iter().zip(&observed.pushes) {
        assert_eq!(a.flange_felt_n.map(f64::to_bits), a.flange_true_n.map(f64::to_bits), "{}", a.name);
        for (felt, force) in b.flange_felt_n.iter().zip(b.flange_true_n) {
            println!("{}: {force:.2} N felt as {felt:.2} N", b.name);
            assert!((felt - force).abs() < 0.5, "{b:?}");
        }
        for (way, other) in a.base_displacement.iter().zip(b.base_displacement) {
            assert!((way - other).abs() < 0.02, "{a:?} {b:?}");
        }
    }
    let [led, ..] = &observed.pushes[..] else { panic!("five pushes") };
    assert!(led.base_displacement[0] > 0.3 && led.flange_felt_n[0] > 14.0, "{led:?}");
}

#[test]
fn collision_is_below_25_n_only_with_100_hz_sensor() {
    let mut base = Settings::paper(Law::Impedance);
    collision::defaults(&mut base);
    let with = |assignments: &[&str]| {
        let mut settings = base.clone();
        settings.set_all(assignments).unwrap();
        collision::run(&settings).unwrap().report
    };
    let on = with(LITERAL);
    assert!(on.measures.peak_force_n < 25.0 && on.measures.flange_rms_mm < 15.0, "{on:?}");
    assert_eq!(on.measures.contact_taxels, ["T1"]);
    assert!(
        on.measures.peaks_n.len() >= 3
            && on.measures.peaks_n[0] > on.measures.peaks_n[1]
            && on.measures.peaks_n[1] > on.measures.peaks_n[2],
        "{on:?}"
    );
    let damped = with(NULL_SPACE);
    assert!(damped.measures.peak_force_n < 25.0 && damped.measures.flange_rms_mm < 2.0, "{damped:?}");
    let off = with(&["sensor=off"]);
    assert!(off.measures.peak_force_n > 4.0 * on.measures.peak_force_n, "{off:?}");
}

#[test]
fn barrier_softens_collisions_of_the_law_alone() {
    let collision = |assignments: &[&str]| {
        let mut settings = Settings::paper(Law::Impedance);
        collision::defaults(&mut settings);
        let scene =
            ["base_coupling=true", "person.taxel=T6", "person.gap=0.1", "duration=5", "board.model=pu-ld30"];
        settings.set_all(NULL_SPACE.iter().chain(&scene).chain(assignments)).unwrap();
        collision::single(&settings).unwrap()
    };
    let stock = ["sensor=stock", "speed=0.065", "barrier=pu-ld30"];
    let ideal = ["person.gap=0.3", "speed=0.139", "barrier=foam"];
    for (name, with) in [("stock", stock), ("ideal", ideal)] {
        let soft = collision(&with);
        let hard = collision(&[with[0], with[1], with[2], "barrier=off"]);
        let [soft_n, hard_n] = [&soft, &hard].map(|report| report.measures.peak_force_n);
        println!(
            "{name}: {soft_n:.1} N with the barrier, {hard_n:.1} N without, at {:.3} m/s",
            soft.approach_m_s
        );
        assert!(soft_n > 5.0 && soft_n < 25.0, "{soft:?}");
        assert!(hard_n > 75.0, "{hard:?}");
        assert!(soft.measures.flange_max_mm < 4.0 && soft.stopped().is_none(), "{soft:?}");
        let [first, later @ ..] = &soft.measures.peaks_n[..] else { panic!("nobody was met") };
        assert!(later.iter().all(|peak_n| peak_n < first), "{:?}", soft.measures.peaks_n);
    }
}

/// The shipped settings on a calibrated cover, led at the paper's speed: no wind-up, no blow, no stop.
#[test]
fn barrier_with_limit_stays_soft_at_paper_speed() {
    let report = collision::single(&super::report::collision_under_barrier().unwrap()).unwrap();
    let m = &report.measures;
    println!("{:.1} N, {:.1} mm, approach {:.3} m/s", m.peak_force_n, m.flange_max_mm, report.approach_m_s);
    assert!(report.stopped().is_none() && m.contact_s.is_some(), "{report:?}");
    assert!(m.peak_force_n > 2.0 && m.peak_force_n < 25.0 && m.flange_max_mm < 5.0, "{report:?}");
}

/// The paper's collision on a base that is late, led faster than the speed limit: a limit and a law that know the delay keep a
/// held leg below 25 N, the whole robot and our firmware's bytes.
#[test]
fn late_base_that_is_known_stays_below_25_n() {
    let peak_n = |late_ms: u32, belief: &str| {
        let mut settings = Settings::paper(Law::Impedance);
        collision::defaults(&mut settings);
        let scene =
            ["sensor=stock", "sensor.firmware=moca", "law=barrier", "person.taxel=T6", "person.fixed=true"];
        let lead = ["person.gap=0.1", "person.steps_away_s=1000", "speed=0.15", "duration=5"];
        settings.set_all(scene.iter().chain(&lead).chain([&belief])).unwrap();
        settings.set(&format!("true.base.order_delay_ms={late_ms}")).unwrap();
        let run = collision::run(&settings).unwrap();
        assert!(
            run.report.stopped().is_none() && run.report.measures.contact_s.is_some(),
            "{:?}",
            run.report
        );
        println!(
            "{late_ms} ms, {belief}: {:.1} N at {:.4} m/s",
            run.report.measures.peak_force_n, run.report.approach_m_s
        );
        run.report.measures.peak_force_n
    };
    for late_ms in [0, 20, 50, 100] {
        assert!(peak_n(late_ms, "belief=measured") < 25.0, "{late_ms} ms");
    }
    assert!(peak_n(50, "belief=default") > 25.0, "the delay costs nothing: nothing is shown");
}

#[test]
fn two_runs_of_one_seed_are_the_same_bit_for_bit() {
    let trace = || {
        let settings = settings(&["push_s=1", "rest_s=0.2"]);
        let mut rig = Rig::start(&settings, &settings.free_scene()).unwrap();
        push::run(&mut rig, &settings, &[push::single(&[1], 20.0)]).unwrap();
        rig.rows
    };
    assert_eq!(trace(), trace());
}

#[test]
fn rate_and_age_of_a_stock_board_can_be_set_and_matter() {
    let peak = |assignments: &[&str]| {
        let mut settings = settings(&["duration=4"]);
        collision::defaults(&mut settings);
        settings.set_all(assignments).unwrap();
        let rig = Rig::start(&settings, &settings.collision_scene().unwrap()).unwrap();
        let rate_hz = rig.frame_rate_hz;
        (collision::single(&settings).unwrap().measures.peak_force_n, rate_hz)
    };
    let (stock_n, stock_hz) = peak(&[]);
    let (quick_n, quick_hz) = peak(&["sensor.period_ms=10"]);
    let (late_n, _) = peak(&["sensor.delay_ms=40"]);
    assert!((stock_hz - 40.5).abs() < 1.0 && (quick_hz - 100.0).abs() < 5.0, "{stock_hz} {quick_hz}");
    assert!(quick_n < stock_n && stock_n < late_n, "{quick_n} {stock_n} {late_n}");
}

/// The arm stands at home.
pub(super) fn row(t_s: f64, base_pose_world: [f64; 3], force_n: f64) -> Row {
    let mut force_true = [0.0; TAXELS];
    (force_true[0], force_true[5]) = (force_n, 0.3 * force_n);
    Row {
        t_s,
        base_pose_world,
        base_velocity_world: [0.0; 3],
        base_velocity_true_world: [0.0; 3],
        base_command_body: [0.0; 3],
        q_rad: moca_msgs::robot::PANDA.home_rad,
        flange_world: [base_pose_world[0] + 0.75, base_pose_world[1], 0.9],
        flange_quaternion: [0.0, 0.0, 0.0, 1.0],
        flange_desired_world: [0.75, 0.0, 0.9],
        flange_wrench_world: [0.0, force_n, 0.0, 0.0, 0.0, 0.0],
        flange_wrench_felt_world: [0.0; 6],
        wrench_true: [0.0; 3],
        wrench_sensed: [0.0; 3],
        force_true,
        force_sensed: force_true,
        total_force_n: force_n,
        largest_force_n: force_n,
        person_world: Some([0.0, 0.5]),
        pressed: [false; TAXELS],
    }
}
