//! Drawing of a three-dimensional view: base, arm and the desired flange, plates coloured by force, arrows of contacts and
//! wrenches. Each array is complete: markers that have ended are deleted in it, so that a viewer that missed one shows
//! nothing that has ended.

use super::{
    frames::{self, BASE, DESIRED, WORLD, link, taxel},
    markers::{Color, Marker, Markers},
};
use crate::{
    RobotDescription,
    ros::messages::{Header, Point, Pose, Quaternion, Time},
};
use moca_msgs::{Sample, TaxelReading, TaxelStatus};

const ARROW: i32 = 0;
const CUBE: i32 = 1;
const CYLINDER: i32 = 3;
const LABEL: i32 = 9;
const DELETE: i32 = 2;

/// Length of an arrow, m/N.
const M_PER_N: f64 = 0.01;
/// Below this a force has no arrow, N.
const SMALLEST_N: f64 = 0.5;
/// Thickness, width and height of a plate, m; its frame's x axis points inward.
const PLATE_M: [f64; 3] = [0.02, 0.2, 0.18];
/// Diameter of a link, m.
const LINK_M: f64 = 0.1;

const BODY: [f32; 4] = [0.25, 0.27, 0.3, 1.0];
const LINK: [f32; 4] = [0.85, 0.86, 0.88, 1.0];
const GHOST: [f32; 4] = [1.0, 0.6, 0.0, 0.45];
const UNUSABLE: [f32; 4] = [0.6, 0.2, 0.7, 0.6];
const PRESS: [f32; 4] = [0.9, 0.1, 0.1, 1.0];
const COVER_WRENCH: [f32; 4] = [0.1, 0.7, 0.2, 1.0];
const FLANGE_WRENCH: [f32; 4] = [0.1, 0.5, 0.9, 1.0];
const WRITING: [f32; 4] = [1.0, 1.0, 1.0, 1.0];

fn marker(at: &Time, frame: &str, ns: &str, id: usize, kind: i32, [r, g, b, a]: [f32; 4]) -> Marker {
    Marker {
        header: Header::new(at, frame),
        ns: ns.into(),
        id: i32::try_from(id).unwrap_or(i32::MAX),
        r#type: kind,
        pose: Pose { orientation: unturned(), ..Pose::default() },
        scale: [1.0; 3].into(),
        color: Color { r, g, b, a },
        frame_locked: true,
        ..Marker::default()
    }
}

fn unturned() -> Quaternion {
    [0.0, 0.0, 0.0, 1.0].into()
}

/// A cylinder from the frame's origin to `end`; `None` where the two are one.
fn rod(at: &Time, frame: &str, ns: &str, id: usize, end: [f64; 3], color: [f32; 4]) -> Option<Marker> {
    let length = end.iter().map(|part| part * part).sum::<f64>().sqrt();
    if length < 1e-3 {
        return None;
    }
    let mut rod = marker(at, frame, ns, id, CYLINDER, color);
    let [x, y, z] = end.map(|part| part / length);
    // The turn that takes z to the rod; half a turn about x where it points downward.
    let half = (2.0 * (1.0 + z)).sqrt();
    let turn = if half < 1e-6 { [1.0, 0.0, 0.0, 0.0] } else { [-y / half, x / half, 0.0, half / 2.0] };
    rod.pose = Pose { position: end.map(|part| part / 2.0).into(), orientation: turn.into() };
    rod.scale = [LINK_M, LINK_M, length].into();
    Some(rod)
}

/// Base, arm and the ghost of the wanted flange, which move with their frames.
pub(super) fn bodies(robot: &RobotDescription, at: &Time) -> Markers {
    let [length, width, height] = robot.base_size_m;
    let mut base = marker(at, BASE, "base", 0, CUBE, BODY);
    base.pose.position = [0.0, 0.0, height / 2.0].into();
    // Inside its plates.
    base.scale = [length - PLATE_M[0], width - PLATE_M[0], height].into();
    let mut markers = vec![base];
    if frames::has_arm(robot) {
        let ends = frames::joint_origins(robot).iter().chain([&robot.arm.table.flange_origin]);
        let rods =
            ends.enumerate().filter_map(|(i, [x, y, z, ..])| rod(at, &link(i), "arm", i, [*x, *y, *z], LINK));
        markers.extend(rods);
        let [x, y, z, ..] = robot.arm.table.flange_origin;
        let back = [-x, -y, -z];
        markers.extend(rod(at, DESIRED, "wanted flange", 0, back, GHOST));
    }
    Markers { markers }
}

fn arrow(at: &Time, frame: &str, ns: &str, id: usize, [from, to]: [[f64; 3]; 2], color: [f32; 4]) -> Marker {
    let mut arrow = marker(at, frame, ns, id, ARROW, color);
    let long = from.iter().zip(to).any(|(a, b)| (a - b).abs() > SMALLEST_N * M_PER_N);
    if long {
        arrow.points = vec![Point::from(from), Point::from(to)];
        // Diameters of shaft and head.
        arrow.scale = [0.02, 0.05, 0.0].into();
    } else {
        arrow.action = DELETE;
    }
    arrow
}

/// From blue through yellow to red.
fn heat(part: f64) -> [f32; 4] {
    #[expect(clippy::cast_possible_truncation, reason = "a colour")]
    let part = part.clamp(0.0, 1.0) as f32;
    if part < 0.5 {
        [2.0 * part, 0.3 + part, 0.7 - 1.4 * part, 1.0]
    } else {
        [1.0, 1.6 - 1.6 * part, 0.0, 1.0]
    }
}

/// The force that is shown, N; 0 where the taxel has none to show.
fn force_n(taxel: &TaxelReading) -> f64 {
    if taxel.status == TaxelStatus::Ok && taxel.force_n.is_finite() { taxel.force_n } else { 0.0 }
}

/// Returns true if the robot is touched, anywhere, by more than an arrow can show.
pub(super) fn is_touched(sample: &Sample) -> bool {
    let flange = sample.flange_wrench_world;
    sample.taxels.iter().any(|taxel| force_n(taxel) > SMALLEST_N)
        || flange[..3].iter().any(|force| force.abs() > SMALLEST_N)
}

/// Plates coloured by force and the arrows of contacts and wrenches.
pub(super) fn touch(robot: &RobotDescription, sample: &Sample, at: &Time) -> Markers {
    let mut markers = Vec::new();
    for (i, reading) in sample.taxels.iter().enumerate().take(robot.taxels.len()) {
        let (frame, force_n) = (taxel(i), force_n(reading));
        let usable = reading.status == TaxelStatus::Ok;
        let color = if usable { heat(force_n / robot.taxel_force_max_n) } else { UNUSABLE };
        let mut plate = marker(at, &frame, "plates", i, CUBE, color);
        plate.scale = PLATE_M.into();
        markers.push(plate);
        let tail = [-force_n * M_PER_N, 0.0, 0.0];
        markers.push(arrow(at, &frame, "contacts", i, [tail, [0.0; 3]], PRESS));
    }
    let ([fx, fy, mz], above) = (sample.cover_wrench_base, robot.base_size_m[2] + 0.05);
    let tip = [fx * M_PER_N, fy * M_PER_N, above];
    markers.push(arrow(at, BASE, "cover wrench", 0, [[0.0, 0.0, above], tip], COVER_WRENCH));
    let mut label = marker(at, BASE, "cover wrench", 1, LABEL, WRITING);
    label.pose.position = [0.0, 0.0, above + 0.1].into();
    label.scale.z = 0.06;
    if fx.hypot(fy) > SMALLEST_N {
        label.text = format!("{:.0} N, {mz:.1} N·m", fx.hypot(fy));
    } else {
        label.action = DELETE;
    }
    markers.push(label);
    if frames::has_arm(robot) {
        let (from, wrench) = (sample.flange_position_world, sample.flange_wrench_world);
        let tip = std::array::from_fn(|i| from[i] + wrench[i] * M_PER_N);
        markers.push(arrow(at, WORLD, "flange wrench", 0, [from, tip], FLANGE_WRENCH));
    }
    Markers { markers }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is drawn is given, not computed")]
mod tests {
    use super::*;

    /// The first marker of a kind and a number.
    fn found<'a>(markers: &'a Markers, ns: &str, id: i32) -> &'a Marker {
        markers.markers.iter().find(|marker| (marker.ns.as_str(), marker.id) == (ns, id)).unwrap()
    }

    fn at(point: &Point) -> [f64; 3] {
        [point.x, point.y, point.z]
    }

    #[test]
    fn plates_take_the_colour_of_their_force_and_arrows_its_length() {
        let robot = RobotDescription::paper("test", true);
        let mut sample = Sample::default();
        let reading = |force_n, status| TaxelReading { force_n, status };
        let half_n = robot.taxel_force_max_n / 2.0;
        sample.taxels.extend([
            reading(0.0, TaxelStatus::Ok),
            reading(half_n, TaxelStatus::Ok),
            reading(2.0 * robot.taxel_force_max_n, TaxelStatus::Ok),
            reading(half_n, TaxelStatus::Stuck),
            reading(f64::NAN, TaxelStatus::Ok),
        ]);
        sample.cover_wrench_base = [3.0, -4.0, 1.25];
        let drawn = touch(&robot, &sample, &Time::default());
        let rgb = |id| {
            let Color { r, g, b, .. } = found(&drawn, "plates", id).color;
            [r, g, b]
        };
        assert_eq!(rgb(0), [0.0, 0.3, 0.7], "blue: nobody touches it");
        assert_eq!(rgb(1), [1.0, 0.8, 0.0], "yellow: half of the largest force");
        assert_eq!(rgb(2), [1.0, 0.0, 0.0], "red: the largest and more");
        assert_eq!([rgb(3), rgb(4)], [[0.6, 0.2, 0.7], rgb(0)], "what means nothing has a colour of its own");

        let press = found(&drawn, "contacts", 1);
        assert_eq!((&*press.header.frame_id, press.action), (&*taxel(1), 0));
        // The frame's x axis points inward: the hand comes from outside and ends at the plate.
        assert_eq!(press.points.iter().map(at).collect::<Vec<_>>(), [[-0.01 * half_n, 0.0, 0.0], [0.0; 3]]);
        for untouched in [0, 3, 4] {
            assert_eq!(found(&drawn, "contacts", untouched).action, DELETE, "T{}", untouched + 1);
        }
        let wrench = found(&drawn, "cover wrench", 0);
        let [from, to] = [at(&wrench.points[0]), at(&wrench.points[1])];
        assert_eq!([to[0] - from[0], to[1] - from[1], to[2] - from[2]], [0.03, -0.04, 0.0]);
        assert_eq!(found(&drawn, "cover wrench", 1).text, "5 N, 1.2 N·m");
    }

    #[test]
    fn desired_flange_is_a_ghost_in_its_own_frame() {
        let robot = RobotDescription::paper("test", true);
        let ghost = bodies(&robot, &Time::default());
        let ghost = found(&ghost, "wanted flange", 0);
        assert_eq!(&*ghost.header.frame_id, DESIRED);
        assert!(ghost.color.a < 1.0 && ghost.frame_locked);
        let mut sample = Sample { flange_position_world: [1.0, 2.0, 1.5], ..Sample::default() };
        sample.flange_wrench_world = [0.0, 10.0, -20.0, 0.0, 0.0, 0.0];
        let drawn = touch(&robot, &sample, &Time::default());
        let pull = found(&drawn, "flange wrench", 0);
        assert_eq!(&*pull.header.frame_id, WORLD);
        assert_eq!(pull.points.iter().map(at).collect::<Vec<_>>(), [[1.0, 2.0, 1.5], [1.0, 2.1, 1.3]]);
    }
}
