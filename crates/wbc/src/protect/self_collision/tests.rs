//! Distances, gradients and what a guard makes of them.

use super::geometry::{segment_and_box, segments};
use super::*;
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PANDA_CAPSULES, SUMMIT_XL, UR10E};
use std::string::ToString;
use std::vec::Vec;

const LEAST_M: f64 = 0.02;

fn solids() -> Solids<'static> {
    Solids {
        capsules: &PANDA_CAPSULES,
        tool: Some(([[0.0, -0.05, 0.04], [0.0, 0.05, 0.04]], 0.04)),
        base_size_m: Some(SUMMIT_XL.size_m),
    }
}

fn guard() -> SelfCollision<7, f64> {
    SelfCollision::new(&PANDA, &MOCA_MOUNT, &solids(), LEAST_M).unwrap()
}

fn model() -> ArmModel<7, f64> {
    ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap()
}

/// From -1 to 1, another one for each seed.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from(u32::try_from(self.0 >> 33).unwrap()) / f64::from(1_u32 << 30) - 1.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.next())
    }

    fn posture(&mut self) -> [f64; 7] {
        core::array::from_fn(|i| {
            let (low, high) = (PANDA.q_min_rad[i], PANDA.q_max_rad[i]);
            0.5 * (low + high + (high - low) * self.next())
        })
    }
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-12
}

/// True for no torque in any joint.
fn is_none(torque_nm: &[f64; 7]) -> bool {
    torque_nm.iter().all(|torque_nm| torque_nm.abs() <= 0.0)
}

#[test]
fn distances_of_segments_at_their_ends_are_exact() {
    let v = Vector3::new;
    let along_x = [v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0)];
    for (other, distance, point, normal) in [
        // crossing, above each other
        ([v(0.5, -1.0, 0.2), v(0.5, 1.0, 0.2)], 0.2, v(0.5, 0.0, 0.0), v(0.0, 0.0, -1.0)),
        // parallel, side by side from 0.5 to 1: the middle
        ([v(0.5, 0.3, 0.0), v(2.5, 0.3, 0.0)], 0.3, v(0.75, 0.0, 0.0), v(0.0, -1.0, 0.0)),
        ([v(2.5, 0.3, 0.0), v(0.5, 0.3, 0.0)], 0.3, v(0.75, 0.0, 0.0), v(0.0, -1.0, 0.0)),
        // parallel, one behind the other
        ([v(3.0, 0.0, 0.0), v(2.0, 0.0, 0.0)], 1.0, v(1.0, 0.0, 0.0), v(-1.0, 0.0, 0.0)),
        // spheres
        ([v(-3.0, 4.0, 0.0); 2], 5.0, v(0.0, 0.0, 0.0), v(0.6, -0.8, 0.0)),
        ([v(0.25, 0.0, 2.0); 2], 2.0, v(0.25, 0.0, 0.0), v(0.0, 0.0, -1.0)),
    ] {
        let found = segments(&along_x, &other);
        assert!(
            near(found.distance, distance) && (found.point - point).norm() < 1e-12,
            "{other:?}: {found:?}"
        );
        assert!((found.normal - normal).norm() < 1e-12, "{other:?}: {found:?}");
        let back = segments(&other, &along_x);
        assert!(
            near(back.distance, distance) && (back.normal + normal).norm() < 1e-12,
            "{other:?}: {back:?}"
        );
    }
    let spheres = segments(&[v(1.0, 0.0, 0.0); 2], &[v(0.0, 0.0, 0.0); 2]);
    assert!(near(spheres.distance, 1.0) && spheres.normal == v(1.0, 0.0, 0.0));
}

#[test]
fn touching_axes_have_a_unit_normal_and_nan_stays_nan() {
    let v = Vector3::new;
    let origin = [v(0.0, 0.0, 0.0); 2];
    let along_x = [v(-1.0, 0.0, 0.0), v(1.0, 0.0, 0.0)];
    let along_y = [v(0.0, -1.0, 0.0), v(0.0, 1.0, 0.0)];
    for (one, other) in
        [(along_x, along_y), (along_x, along_x), (along_y, along_y), (origin, along_x), (origin, origin)]
    {
        let found = segments(&one, &other);
        assert!(near(found.distance, 0.0) && near(found.normal.norm(), 1.0), "{found:?}");
        let along = one[1] - one[0];
        assert!(near(found.normal.dot(&along), 0.0), "{found:?}");
    }
    assert!(segments(&[v(f64::NAN, 0.0, 0.0), v(1.0, 0.0, 0.0)], &along_y).distance.is_nan());
    assert!(segment_and_box(&[v(f64::NAN, 0.0, 0.0), v(1.0, 0.0, 0.0)], &v(1.0, 1.0, 1.0)).distance.is_nan());
}

/// Smallest value of a convex function from 0 to 1.
fn smallest(of: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..70 {
        let third = (high - low) / 3.0;
        if of(low + third) < of(high - third) { high -= third } else { low += third }
    }
    of(0.5 * (low + high))
}

#[test]
fn distances_are_those_of_a_search() {
    let mut draws = Draws(1);
    let half = Vector3::new(0.5, 0.4, 0.3);
    let mut inside = 0;
    for case in 0..300 {
        let one = [draws.vector(), draws.vector()];
        let mut other = [draws.vector(), draws.vector()];
        if case % 5 == 0 {
            // all but parallel
            other[1] = other[0] + (one[1] - one[0]) * 0.7 + draws.vector() * 1e-9;
        }
        let at = |[from, to]: [Vector3<f64>; 2], s: f64| from + (to - from) * s;
        let searched = smallest(|s| smallest(|t| (at(one, s) - at(other, t)).norm()));
        let found = segments(&one, &other);
        assert!((found.distance - searched).abs() < 1e-7, "{one:?} {other:?}: {found:?}, {searched}");
        assert!(near(found.normal.norm(), 1.0));
        let outside = |p: Vector3<f64>| p.zip_map(&half, |x, half| (x.abs() - half).max(0.0)).norm();
        let searched = smallest(|s| outside(at(one, s)));
        let found = segment_and_box(&one, &half);
        assert!((found.distance.max(0.0) - searched).abs() < 1e-7, "{one:?}: {found:?}, {searched}");
        inside += usize::from(found.distance < 0.0);
        if found.distance > 0.0 {
            let foot = found.point - found.normal * found.distance;
            assert!(outside(foot) < 1e-9, "{one:?}: {found:?}");
        }
    }
    assert!((30..270).contains(&inside), "{inside} of the segments pass through the box");
}

#[test]
fn segment_in_a_box_is_pushed_to_the_nearest_face() {
    let half = Vector3::new(0.5, 0.4, 0.3);
    let point = |x, y, z| segment_and_box(&[Vector3::new(x, y, z); 2], &half);
    for (found, distance, normal) in [
        (point(0.0, 0.0, 0.2), -0.1, Vector3::z()),
        (point(0.0, 0.0, -0.2), -0.1, -Vector3::z()),
        (point(-0.45, 0.1, 0.0), -0.05, -Vector3::x()),
        (point(0.0, 0.39, 0.1), -0.01, Vector3::y()),
        (point(0.0, 0.0, 1.3), 1.0, Vector3::z()),
        (point(3.5, 4.4, 0.0), 5.0, Vector3::new(0.6, 0.8, 0.0)),
    ] {
        assert!(near(found.distance, distance) && (found.normal - normal).norm() < 1e-12, "{found:?}");
    }
    // above the middle of a face: the middle of the segment
    let over = segment_and_box(&[Vector3::new(-0.2, 0.0, 0.4), Vector3::new(0.2, 0.0, 0.4)], &half);
    assert!(
        near(over.distance, 0.1) && over.point.norm() < 0.4 + 1e-12 && near(over.point.x, 0.0),
        "{over:?}"
    );
}

#[test]
fn gradient_is_the_change_of_the_distance() {
    let low = Mount { position_base_m: [0.2, 0.0, 0.1], ..MOCA_MOUNT };
    let models = [model(), ArmModel::new(&PANDA, &low, &Payload::NONE).unwrap()];
    let hand = Solids { capsules: &PANDA_CAPSULES[8..], tool: None, base_size_m: None };
    let over_floor = SelfCollision::<7, f64>::new(&PANDA, &low, &hand, LEAST_M).unwrap();
    let guards = [guard(), over_floor];
    let mut draws = Draws(3);
    let mut kinds = [0; 4];
    for case in 0..6000 {
        let (guard, model) = (&guards[case % 2], &models[case % 2]);
        let (q, yaw) = (draws.posture(), 3.0 * draws.next());
        // with its axis in the base a capsule has no one nearest point
        let found = guard.nearest(&model.kinematics(yaw, &q)).filter(|found| found.distance > -0.025);
        let Some(found) = found else { continue };
        let distance = |q: &[f64; 7]| {
            let nearest = guard.nearest(&model.kinematics(yaw, q));
            nearest.filter(|nearest| nearest.parts == found.parts).map(|nearest| nearest.distance)
        };
        for i in 0..7 {
            const STEP: f64 = 1e-6;
            let moved = |step: f64| {
                let mut q = q;
                q[i] += step;
                distance(&q)
            };
            let (Some(more), Some(less), Some(here)) = (moved(STEP), moved(-STEP), distance(&q)) else {
                continue;
            };
            // where the nearest points jump there are two slopes
            let (after, before) = ((more - here) / STEP, (here - less) / STEP);
            let smooth = (after - before).abs() < 1e-4;
            assert!(
                !smooth || (found.gradient[i] - after).abs() < 2e-4,
                "{q:?} J{}: {found:?}, {after}",
                i + 1
            );
            kinds[3] += usize::from(!smooth);
        }
        match found.parts[1] {
            RobotPart::Base => kinds[0] += 1,
            RobotPart::Floor => kinds[1] += 1,
            _ => kinds[2] += 1,
        }
    }
    assert!(kinds[..3].iter().all(|kind| *kind > 30) && kinds[3] < 100, "{kinds:?}");
}

#[test]
fn pairs_that_joints_keep_apart_are_left_out() {
    let guard = guard();
    for (one, other, compared) in
        [(0, 1, false), (1, 3, false), (5, 6, false), (0, 5, true), (1, 6, true), (2, 7, true)]
    {
        assert_eq!(
            (guard.compares(one, other), guard.compares(other, one)),
            (compared, compared),
            "{one} {other}"
        );
    }
    assert!(guard.pairs() > 40);
}

#[test]
fn solids_out_of_range_are_refused_by_name() {
    let with = |capsule: LinkCapsule, least_m: f64| {
        let solids = Solids { capsules: &[capsule], ..solids() };
        SelfCollision::<7, f64>::new(&PANDA, &MOCA_MOUNT, &solids, least_m).unwrap_err().to_string()
    };
    let good = LinkCapsule { link: 3, ends_m: [[0.0; 3]; 2], radius_m: 0.05 };
    assert!(with(LinkCapsule { link: 8, ..good }, 0.02).contains("capsule link = 8"));
    assert!(with(LinkCapsule { radius_m: f64::NAN, ..good }, 0.02).contains("capsule radius = NaN m"));
    assert!(
        with(LinkCapsule { ends_m: [[0.0; 3], [0.0, f64::INFINITY, 0.0]], ..good }, 0.02)
            .contains("capsule end")
    );
    assert!(with(good, 0.004).contains("smallest distance = 0.004 m"));
    let many = [good; MAX_CAPSULES + 1];
    let solids = Solids { capsules: &many, tool: None, base_size_m: None };
    assert!(SelfCollision::<7, f64>::new(&PANDA, &MOCA_MOUNT, &solids, 0.02).is_err());
    let none = Solids { capsules: &[], tool: None, base_size_m: None };
    assert!(SelfCollision::<7, f64>::new(&PANDA, &MOCA_MOUNT, &none, 0.02).is_err());
}

/// Postures in which something is near, with what is near and the mass matrix.
fn near_postures(count: usize) -> Vec<(Near<7, f64>, crate::model::Dynamics<7, f64>, [f64; 7])> {
    let (guard, model) = (guard(), model());
    let mut draws = Draws(5);
    let mut found = Vec::new();
    while found.len() < count {
        let q = draws.posture();
        let dq = core::array::from_fn(|_| draws.next());
        let dynamics = model.dynamics(0.0, &q, &dq);
        if let Some(near) = guard.near(&dynamics.kinematics, &dynamics.mass)
            && near.rows().iter().any(|row| row.distance < LEAST_M)
            && near.rows().iter().all(|row| row.distance > 0.0)
        {
            found.push((near, dynamics, dq));
        }
    }
    found
}

/// Work done on the robot beside that of a potential of the distances is never positive.
#[test]
fn repulsion_is_a_spring_that_only_loses_energy() {
    let mut pushed = 0;
    for (near, _, dq) in near_postures(300) {
        let (moving, resting) = (near.repulsion(&dq, 1e-3), near.repulsion(&[0.0; 7], 1e-3));
        assert!(dot(&moving, &dq) <= dot(&resting, &dq) + 1e-12);
        pushed += usize::from(!is_none(&moving));
        // the spring itself: the gradient of ½·k·depth²
        let mut spring = [0.0; 7];
        for row in near.rows().iter().filter(|row| row.distance < LEAST_M) {
            add(&mut spring, &row.gradient, STIFFNESS_N_M * (LEAST_M - row.distance));
        }
        assert!((0..7).all(|i| (spring[i] - resting[i]).abs() < 1e-9), "{resting:?} {spring:?}");
    }
    assert!(pushed > 250, "{pushed}");
}

#[test]
fn brake_meets_its_demand_and_only_takes_energy() {
    let (mut braked, mut exact) = (0, 0);
    let mut draws = Draws(9);
    for (near, dynamics, dq) in near_postures(300) {
        let torque: [f64; 7] = core::array::from_fn(|_| 20.0 * draws.next());
        let dt_s = 1e-3;
        let braking = near.braking(&dq, &torque, dt_s);
        if is_none(&braking) {
            continue;
        }
        braked += 1;
        let inertia = Cholesky::new(&dynamics.mass).unwrap();
        let after = inertia.solve(&core::array::from_fn(|i| torque[i] + braking[i]));
        // by how much an approaching pair misses its demand, m/s², without the brake and with it
        let (mut before_short, mut short) = (0.0_f64, 0.0_f64);
        for row in near.rows() {
            let rate = dot(&row.gradient, &dq);
            let without = dot(&row.response, &torque);
            if rate + dt_s * without >= 0.0 {
                continue;
            }
            let left = (row.distance - LEAST_M).max(0.0);
            let demand = -BRAKE_PER_S * (rate + APPROACH_PER_S * left) - APPROACH_PER_S * rate;
            let demand = if rate > 0.0 { demand.min(-2.0 * rate / dt_s) } else { demand };
            before_short = before_short.max(demand - without);
            short = short.max(demand - dot(&row.gradient, &after));
        }
        assert!(short <= 0.25 * before_short, "{short} of {before_short} m/s² are missing");
        exact += usize::from(short <= 1e-6 * before_short);
        // what a step at the rate after it gains is no more than what the rate in the middle of it allows
        let middle: [f64; 7] = core::array::from_fn(|i| dq[i] + 0.5 * dt_s * after[i]);
        assert!(
            dot(&braking, &middle) <= 1e-3 * dot(&braking, &braking).sqrt(),
            "{}",
            dot(&braking, &middle)
        );
    }
    assert!(braked > 100 && exact > braked / 2, "{braked} {exact}");
}

#[test]
fn what_moves_apart_is_neither_braked_nor_slowed() {
    for (near, ..) in near_postures(100) {
        if near.rows().len() > 1 {
            continue;
        }
        let away = near.rows()[0].gradient;
        assert!(is_none(&near.braking(&away, &[0.0; 7], 1e-3)));
        assert!(near.too_fast(&away) < 1e-12);
        let towards = away.map(|v| -v);
        assert!(near.too_fast(&towards) > 100.0, "below the smallest distance a reference stands");
    }
}

#[test]
fn reference_slows_down_in_proportion_to_what_is_left() {
    let row = |distance: f64| {
        let mut gradient = [0.0; 7];
        gradient[0] = 1.0;
        Row { distance, gradient, response: gradient, mobility: 1.0 }
    };
    let near = |distance: f64| {
        let mut near = Near { rows: [row(1.0); MAX_NEAR], count: 0, least: LEAST_M };
        near.insert(row(distance));
        near
    };
    let mut towards = [0.0; 7];
    towards[0] = -0.1;
    for left in [0.01, 0.04, 0.1] {
        let allowed = LED_SHARE * APPROACH_PER_S * left;
        assert!((near(LEAST_M + left).too_fast(&towards) - 0.1 / allowed).abs() < 1e-9, "{left}");
    }
    // more pairs than there is room for: the nearest stay
    let mut many = near(0.1);
    for i in 0..30 {
        many.insert(row(0.09 - 0.001 * f64::from(i)));
    }
    let nearest = many.rows().iter().map(|row| row.distance).fold(f64::INFINITY, f64::min);
    let furthest = many.rows().iter().map(|row| row.distance).fold(0.0, f64::max);
    assert!(
        many.rows().len() == MAX_NEAR && near_to(nearest, 0.061) && near_to(furthest, 0.072),
        "{nearest} {furthest}"
    );
}

fn near_to(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

#[test]
fn predicted_posture_reaches_the_pose_or_there_is_none() {
    let (guard, model) = (guard(), model());
    let mut draws = Draws(11);
    let (mut reached, mut tried) = (0, 0);
    while tried < 200 {
        let goal = draws.posture();
        let wanted = model.kinematics(0.4, &goal);
        let at = (&wanted.tool_position, &wanted.tool_rotation);
        tried += 1;
        if let Some(q) = guard.predicted(&model, 0.4, (&PANDA.home_rad, &PANDA.home_rad), at) {
            let found = model.kinematics(0.4, &q);
            assert!((found.tool_position - wanted.tool_position).norm() < 5e-3);
            reached += 1;
        }
    }
    assert!(reached > 100, "{reached}");
    let far = (&Vector3::new(3.0, 0.0, 0.0), &Matrix3::identity());
    assert_eq!(guard.predicted(&model, 0.0, (&PANDA.home_rad, &PANDA.home_rad), far), None);
}

#[test]
fn arm_of_six_joints_in_single_precision_is_as_near() {
    let capsules = [
        LinkCapsule { link: 2, ends_m: [[0.0, 0.0, 0.15], [-0.6, 0.0, 0.15]], radius_m: 0.07 },
        LinkCapsule { link: 5, ends_m: [[0.0, 0.0, -0.05], [0.0, 0.0, 0.05]], radius_m: 0.05 },
    ];
    let solids = Solids { capsules: &capsules, tool: None, base_size_m: Some(SUMMIT_XL.size_m) };
    let double = SelfCollision::<6, f64>::new(&UR10E, &MOCA_MOUNT, &solids, LEAST_M).unwrap();
    let single = SelfCollision::<6, f32>::new(&UR10E, &MOCA_MOUNT, &solids, LEAST_M).unwrap();
    let doubles = ArmModel::<6, f64>::new(&UR10E, &MOCA_MOUNT, &Payload::NONE).unwrap();
    let singles = ArmModel::<6, f32>::new(&UR10E, &MOCA_MOUNT, &Payload::NONE).unwrap();
    let mut draws = Draws(2);
    let mut compared = 0;
    for _ in 0..2000 {
        let q: [f64; 6] = core::array::from_fn(|_| 3.0 * draws.next());
        let near = double.nearest(&doubles.kinematics(0.3, &q));
        let near_f32 = single.nearest(&singles.kinematics(0.3, &q.map(of)));
        if let (Some(one), Some(other)) = (near, near_f32) {
            assert!((one.distance - f64::from(other.distance)).abs() < 1e-5, "{one:?} {other:?}");
            compared += 1;
        }
    }
    assert!(compared > 300, "{compared}");
}
