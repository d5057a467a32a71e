//! MuJoCo's model of a scene, written from the robot tables. What the scene does not ask for is not in the text.
//!
//! Unless a scene asks for geoms, there are none: inertias come from the tables, and forces between people and
//! cover are computed from the geometric gap (see `contact`), not by MuJoCo's collision detection.

use crate::scene::{Integrator, Mobility, Robot, Scene, Shape};
use moca_msgs::robot::LinkInertial;
use std::fmt::{self, Write};

/// Velocity gain of the inner base servo along x and y and about the vertical, N·s/m, N·s/m, N·m·s/rad: 20 N push it back by
/// 0.2 mm/s. ASSUMED.
pub const SERVO_DAMPING: [f64; 3] = [1e5, 1e5, 2.5e4];
/// Returns the part of [`SERVO_DAMPING`] that an engine applies itself, on the speed at the step's end: all of it, or for the
/// trapezoidal rule the half that does not act on the speed at its start.
pub(crate) fn implicit_damping(scene: &Scene) -> [f64; 3] {
    let share = if scene.integrator == Integrator::Leapfrog { 0.5 } else { 1.0 };
    SERVO_DAMPING.map(|damping| share * damping)
}

/// Name of the massless body that marks the flange.
pub(crate) const FLANGE: &str = "flange";
/// Name of the body that gets the mass of a grasped object.
pub(crate) const LOAD: &str = "load";

/// The scene as MJCF.
pub(crate) fn mjcf(scene: &Scene) -> Result<String, fmt::Error> {
    let mut xml = String::with_capacity(8192);
    options(&mut xml, scene)?;
    xml.push_str("<worldbody>\n");
    match scene.robot {
        Robot::MobileManipulator => {
            base(&mut xml, scene)?;
            arm(&mut xml, scene, [0.0; 3])?;
            xml.push_str("</body>\n");
        }
        Robot::BaseOnly => {
            base(&mut xml, scene)?;
            xml.push_str("</body>\n");
        }
        Robot::ArmOnly => arm(&mut xml, scene, scene.base_pose_world)?,
    }
    for person in &scene.people {
        let [x, y] = person.position_world;
        if let Mobility::Standing { mass_kg, .. } = person.mobility {
            write!(xml, "<body pos=\"{x} {y} 0\"><joint type=\"slide\" axis=\"1 0 0\"/>")?;
            xml.push_str("<joint type=\"slide\" axis=\"0 1 0\"/>");
            writeln!(xml, "<inertial pos=\"0 0 0\" mass=\"{mass_kg}\" diaginertia=\"1 1 1\"/>")?;
            if let (true, Shape::Cylinder { radius_m }) = (scene.geoms, person.shape) {
                writeln!(xml, "<geom type=\"cylinder\" size=\"{radius_m} 0.4\" pos=\"0 0 0.45\"/>")?;
            }
            xml.push_str("</body>\n");
        }
    }
    if scene.geoms {
        xml.push_str("<geom type=\"plane\" size=\"20 20 1\" pos=\"0 0 -0.01\"/>\n");
    }
    if !scene.capsules.is_empty() {
        xml.push_str("<geom type=\"plane\" size=\"20 20 1\" contype=\"0\" conaffinity=\"1\"/>\n");
    }
    xml.push_str("</worldbody>\n");
    if !scene.apart.is_empty() {
        apart(&mut xml, scene)?;
    }
    if scene.geoms {
        sensors(&mut xml, scene)?;
    }
    xml.push_str("</mujoco>\n");
    Ok(xml)
}

fn options(xml: &mut String, scene: &Scene) -> fmt::Result {
    let integrator = match scene.integrator {
        Integrator::Euler => "Euler",
        Integrator::RungeKutta4 => "RK4",
        Integrator::Implicit => "implicit",
        Integrator::ImplicitFast | Integrator::Leapfrog => "implicitfast",
    };
    let meets = scene.geoms || !scene.capsules.is_empty();
    let contact = if meets { "enable" } else { "disable" };
    let constraint = if scene.joint_limits || meets { "enable" } else { "disable" };
    writeln!(xml, "<mujoco model=\"moca\">")?;
    // Upper-case axes are fixed axes: R = Rz·Ry·Rx, as in the tables.
    writeln!(xml, "<compiler angle=\"radian\" autolimits=\"true\" eulerseq=\"XYZ\"/>")?;
    writeln!(
        xml,
        "<option timestep=\"{}\" integrator=\"{integrator}\" gravity=\"0 0 -9.81\">",
        scene.physics_step_s
    )?;
    // Without autoreset="disable" a NaN would silently become the start state at time 0.
    writeln!(
        xml,
        "<flag autoreset=\"disable\" contact=\"{contact}\" constraint=\"{constraint}\"/></option>"
    )?;
    if !meets {
        // What MuJoCo sets aside for contacts has no use where there are none; `tests/plant.rs` says what a step takes.
        writeln!(xml, "<size memory=\"256K\"/>")?;
    }
    Ok(())
}

fn base(xml: &mut String, scene: &Scene) -> fmt::Result {
    let [ix, iy, iz] = scene.base.inertia_com_diagonal;
    let [cx, cy, cz] = scene.base.com_m;
    xml.push_str("<body name=\"base\">\n");
    let [along_x, along_y, yaw] = implicit_damping(scene);
    for (name, kind, axis, damping) in [
        ("base_x", "slide", "1 0 0", along_x),
        ("base_y", "slide", "0 1 0", along_y),
        ("base_yaw", "hinge", "0 0 1", yaw),
    ] {
        writeln!(xml, "<joint name=\"{name}\" type=\"{kind}\" axis=\"{axis}\" damping=\"{damping}\"/>")?;
    }
    if scene.geoms {
        hull(xml, scene)?;
    } else if !scene.capsules.is_empty() {
        let [x, y, z] = half_hull(scene);
        writeln!(
            xml,
            "<geom type=\"box\" size=\"{x} {y} {z}\" pos=\"0 0 {z}\" contype=\"0\" conaffinity=\"1\"/>"
        )?;
    }
    let mass = scene.base.mass_kg;
    writeln!(xml, "<inertial pos=\"{cx} {cy} {cz}\" mass=\"{mass}\" diaginertia=\"{ix} {iy} {iz}\"/>")
}

/// The arm on its mount, `stand` being the pose (x, y, yaw) of B in the parent body.
fn arm(xml: &mut String, scene: &Scene, stand: [f64; 3]) -> fmt::Result {
    let [x, y, z] = scene.mount.position_base_m;
    let [roll, pitch, yaw] = scene.mount.rpy_rad;
    let (sin, cos) = stand[2].sin_cos();
    let origin = [stand[0] + cos * x - sin * y, stand[1] + sin * x + cos * y, z, roll, pitch, stand[2] + yaw];
    open_body(xml, "link0", &origin)?;
    let (table, joints) = (&scene.arm.table, scene.arm.joints);
    inertial(xml, &table.link0)?;
    capsules(xml, scene, 0)?;
    for i in 0..joints {
        open_body(xml, &format!("link{}", i + 1), &table.joint_origin[i])?;
        write!(xml, "<joint name=\"q{}\" type=\"hinge\" axis=\"0 0 1\"", i + 1)?;
        if scene.joint_limits {
            write!(xml, " range=\"{} {}\"", table.q_min_rad[i], table.q_max_rad[i])?;
        }
        xml.push_str("/>\n");
        inertial(xml, &table.links[i])?;
        capsules(xml, scene, i + 1)?;
        if scene.geoms {
            let [x, y, z] = table.links[i].com_m;
            writeln!(xml, "<geom type=\"sphere\" size=\"0.02\" pos=\"{x} {y} {z}\"/>")?;
        }
    }
    open_body(xml, FLANGE, &table.flange_origin)?;
    // Applied forces act at a body's centre of mass. A body without inertial gets its own offset in the parent for it.
    xml.push_str("<inertial pos=\"0 0 0\" mass=\"0\" diaginertia=\"0 0 0\"/>\n");
    capsules(xml, scene, joints + 1)?;
    if scene.payload.inertial.mass_kg > 0.0 {
        open_body(xml, "payload", &[0.0; 6])?;
        inertial(xml, &scene.payload.inertial)?;
        xml.push_str("</body>\n");
    }
    if scene.has_object() {
        open_body(xml, LOAD, &[0.0; 6])?;
        // Away from the body's origin, or MuJoCo would take both frames for one for good.
        xml.push_str("<inertial pos=\"0 0 0.1\" mass=\"0\" diaginertia=\"0 0 0\"/></body>\n");
    }
    if scene.geoms {
        xml.push_str("<site name=\"flange\"/>\n");
    }
    for _ in 0..joints + 2 {
        xml.push_str("</body>");
    }
    xml.push('\n');
    Ok(())
}

/// The capsules of a link.
fn capsules(xml: &mut String, scene: &Scene, link: usize) -> fmt::Result {
    for capsule in scene.capsules.iter().filter(|capsule| capsule.link == link) {
        let ([[x0, y0, z0], [x1, y1, z1]], radius) = (capsule.ends_m, capsule.radius_m);
        // MuJoCo takes no capsule without a length
        let is_point = [x1 - x0, y1 - y0, z1 - z0].iter().all(|length_m| length_m.abs() < 1e-9);
        // a bit each for the arm and for what it meets: the base never meets the floor
        let shape = if is_point {
            format!("type=\"sphere\" size=\"{radius}\" pos=\"{x0} {y0} {z0}\"")
        } else {
            format!("type=\"capsule\" size=\"{radius}\" fromto=\"{x0} {y0} {z0} {x1} {y1} {z1}\"")
        };
        writeln!(xml, "<geom {shape} contype=\"1\" conaffinity=\"1\"/>")?;
    }
    Ok(())
}

/// Pairs of links that pass through each other.
fn apart(xml: &mut String, scene: &Scene) -> fmt::Result {
    let joints = scene.arm.joints;
    let body = |link: usize| if link > joints { FLANGE.to_owned() } else { format!("link{link}") };
    xml.push_str("<contact>\n");
    for [one, other] in scene.apart.iter().filter(|[one, other]| one.max(other) <= &(joints + 1)) {
        writeln!(xml, "<exclude body1=\"{}\" body2=\"{}\"/>", body(*one), body(*other))?;
    }
    writeln!(xml, "</contact>")
}

fn open_body(xml: &mut String, name: &str, [x, y, z, roll, pitch, yaw]: &[f64; 6]) -> fmt::Result {
    writeln!(xml, "<body name=\"{name}\" pos=\"{x} {y} {z}\" euler=\"{roll} {pitch} {yaw}\">")
}

fn inertial(xml: &mut String, link: &LinkInertial) -> fmt::Result {
    let [x, y, z] = link.com_m;
    let [xx, xy, xz, yy, yz, zz] = link.inertia_com;
    let mass = link.mass_kg;
    if link.inertia_com.iter().all(|value| *value == 0.0) {
        // a point mass, or nothing at all: MuJoCo takes no full inertia of zeros
        return writeln!(xml, "<inertial pos=\"{x} {y} {z}\" mass=\"{mass}\" diaginertia=\"0 0 0\"/>");
    }
    // MuJoCo's order: xx yy zz xy xz yz.
    writeln!(
        xml,
        "<inertial pos=\"{x} {y} {z}\" mass=\"{mass}\" fullinertia=\"{xx} {yy} {zz} {xy} {xz} {yz}\"/>"
    )
}

/// Half lengths of the box out to the taxels.
fn half_hull(scene: &Scene) -> [f64; 3] {
    let [x, y, z] = scene.base.size_m.map(|length| 0.5 * length);
    let furthest = |half: f64, axis: usize| {
        scene.cover.iter().map(|taxel| taxel.position_base_m[axis].abs()).fold(half, f64::max)
    };
    [furthest(x, 0), furthest(y, 1), z]
}

/// The base as a box out to its taxels, a touch pad at each.
fn hull(xml: &mut String, scene: &Scene) -> fmt::Result {
    let [x, y, z] = half_hull(scene);
    writeln!(xml, "<geom type=\"box\" size=\"{x} {y} {z}\" pos=\"0 0 {z}\"/>")?;
    for (i, taxel) in scene.cover.iter().enumerate() {
        let [x, y] = taxel.position_base_m;
        let yaw = taxel.inward_angle_base_rad;
        writeln!(
            xml,
            "<site name=\"t{}\" type=\"box\" size=\"0.05 0.095 {z}\" pos=\"{x} {y} {z}\" euler=\"0 0 {yaw}\"/>",
            i + 1
        )?;
    }
    Ok(())
}

/// Writes the sensors of a controller: taxels first, then joints and the wrench at the flange.
fn sensors(xml: &mut String, scene: &Scene) -> fmt::Result {
    xml.push_str("<sensor>\n");
    let base: &[&str] = if scene.robot == Robot::ArmOnly { &[] } else { &["base_x", "base_y", "base_yaw"] };
    let joints = if scene.robot == Robot::BaseOnly { 0 } else { scene.arm.joints };
    if !base.is_empty() {
        for taxel in 1..=scene.cover.len() {
            writeln!(xml, "<touch site=\"t{taxel}\"/>")?;
        }
    }
    let arm: Vec<String> = (1..=joints).map(|joint| format!("q{joint}")).collect();
    for joint in base.iter().copied().chain(arm.iter().map(String::as_str)) {
        writeln!(xml, "<jointpos joint=\"{joint}\"/><jointvel joint=\"{joint}\"/>")?;
    }
    if !arm.is_empty() {
        writeln!(xml, "<force site=\"flange\"/><torque site=\"flange\"/>")?;
    }
    writeln!(xml, "</sensor>")
}
