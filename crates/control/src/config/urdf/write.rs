//! A robot as a URDF: base, taxels, arm and tool from its description.

use crate::robot::{Parts, Robot};
use moca_msgs::robot::LinkInertial;
use std::fmt::Write;

/// Half of a taxel's plate along the cover and upward, m: for the eye, nothing computes with it.
const PLATE_M: [f64; 2] = [0.1, 0.09];

/// `robot` as far as it has `parts`. Links: `base_link` (frame B), `taxel_1` … with x pointing inward, `arm_link0` (frame A) …,
/// `flange`, `tool`.
pub fn urdf(robot: &Robot, parts: Parts) -> String {
    let mut out = Urdf(String::with_capacity(16_384));
    out.line(0, &format!("<?xml version=\"1.0\"?>\n<robot name=\"{}\">", escaped(&robot.name)));
    if parts.has_cover() {
        out.base(robot);
    }
    if parts.has_arm() {
        if parts.has_cover() {
            let [x, y, z] = robot.mount.position_base_m;
            let [roll, pitch, yaw] = robot.mount.rpy_rad;
            out.fixed("arm_mount", "base_link", "arm_link0", &[x, y, z, roll, pitch, yaw]);
        }
        out.arm(robot);
    }
    out.line(0, "</robot>");
    out.0
}

struct Urdf(String);

impl Urdf {
    fn line(&mut self, depth: usize, text: &str) {
        for _ in 0..depth {
            self.0.push_str("  ");
        }
        self.0.push_str(text);
        self.0.push('\n');
    }

    fn base(&mut self, robot: &Robot) {
        let base = &robot.base;
        let [xx, yy, zz] = base.inertia_com_diagonal;
        let body = LinkInertial {
            mass_kg: base.mass_kg,
            com_m: base.com_m,
            inertia_com: [xx, 0.0, 0.0, yy, 0.0, zz],
        };
        let size = list(&base.size_m);
        let middle = [0.0, 0.0, 0.5 * base.size_m[2]];
        self.line(1, "<link name=\"base_link\">");
        self.inertial(&body);
        self.boxes(&middle, &size);
        self.line(1, "</link>");
        for (i, taxel) in robot.cover.placements().iter().enumerate() {
            let link = format!("taxel_{}", i + 1);
            let ([x, y], z) = (taxel.position_base_m, 0.5 * base.size_m[2]);
            self.line(1, &format!("<link name=\"{link}\">"));
            let [along, up] = PLATE_M.map(|half| 2.0 * half);
            self.boxes(&[0.0; 3], &format!("0.002 {along:?} {up:?}"));
            self.line(1, "</link>");
            let at = [x, y, z, 0.0, 0.0, taxel.inward_angle_base_rad];
            self.fixed(&format!("taxel_{}_place", i + 1), "base_link", &link, &at);
        }
    }

    fn arm(&mut self, robot: &Robot) {
        let (arm, joints) = (&robot.arm.table.table, robot.arm.table.joints);
        self.body("arm_link0", &arm.link0);
        for i in 0..joints {
            let (before, link) = (format!("arm_link{i}"), format!("arm_link{}", i + 1));
            self.body(&link, &arm.links[i]);
            self.line(1, &format!("<joint name=\"arm_joint{}\" type=\"revolute\">", i + 1));
            self.between(&before, &link, &arm.joint_origin[i]);
            self.line(2, "<axis xyz=\"0 0 1\"/>");
            let limit = format!(
                "<limit lower=\"{:?}\" upper=\"{:?}\" velocity=\"{:?}\" effort=\"{:?}\"/>",
                arm.q_min_rad[i], arm.q_max_rad[i], arm.dq_max_rad_s[i], arm.torque_max_nm[i]
            );
            self.line(2, &limit);
            self.line(1, "</joint>");
        }
        let last = format!("arm_link{joints}");
        self.line(1, "<link name=\"flange\"/>");
        self.fixed("flange_place", &last, "flange", &arm.flange_origin);
        let payload = robot.payload();
        if payload.inertial.mass_kg > 0.0 {
            self.body("carried", &payload.inertial);
            self.fixed("carried_place", "flange", "carried", &[0.0; 6]);
        }
        if payload.tool_origin.iter().any(|number| *number != 0.0) {
            self.line(1, "<link name=\"tool\"/>");
            self.fixed("tool_place", "flange", "tool", &payload.tool_origin);
        }
    }

    fn body(&mut self, name: &str, body: &LinkInertial) {
        self.line(1, &format!("<link name=\"{name}\">"));
        self.inertial(body);
        self.line(1, "</link>");
    }

    fn inertial(&mut self, body: &LinkInertial) {
        if body.mass_kg <= 0.0 {
            return;
        }
        let [xx, xy, xz, yy, yz, zz] = body.inertia_com;
        self.line(2, "<inertial>");
        self.line(3, &format!("<origin xyz=\"{}\" rpy=\"0 0 0\"/>", list(&body.com_m)));
        self.line(3, &format!("<mass value=\"{:?}\"/>", body.mass_kg));
        let inertia = format!(
            "<inertia ixx=\"{xx:?}\" ixy=\"{xy:?}\" ixz=\"{xz:?}\" iyy=\"{yy:?}\" iyz=\"{yz:?}\" izz=\"{zz:?}\"/>"
        );
        self.line(3, &inertia);
        self.line(2, "</inertial>");
    }

    fn boxes(&mut self, middle: &[f64; 3], size: &str) {
        for use_ in ["visual", "collision"] {
            self.line(2, &format!("<{use_}>"));
            self.line(3, &format!("<origin xyz=\"{}\" rpy=\"0 0 0\"/>", list(middle)));
            self.line(3, &format!("<geometry><box size=\"{size}\"/></geometry>"));
            self.line(2, &format!("</{use_}>"));
        }
    }

    fn fixed(&mut self, name: &str, parent: &str, child: &str, origin: &[f64; 6]) {
        self.line(1, &format!("<joint name=\"{name}\" type=\"fixed\">"));
        self.between(parent, child, origin);
        self.line(1, "</joint>");
    }

    fn between(&mut self, parent: &str, child: &str, [x, y, z, roll, pitch, yaw]: &[f64; 6]) {
        let (place, turn) = (list(&[*x, *y, *z]), list(&[*roll, *pitch, *yaw]));
        self.line(2, &format!("<parent link=\"{parent}\"/>"));
        self.line(2, &format!("<child link=\"{child}\"/>"));
        self.line(2, &format!("<origin xyz=\"{place}\" rpy=\"{turn}\"/>"));
    }
}

/// Every digit, so that a reader gets the same bits.
fn list(numbers: &[f64]) -> String {
    let mut out = String::new();
    for number in numbers {
        let space = if out.is_empty() { "" } else { " " };
        // a String takes everything
        let _ = write!(out, "{space}{number:?}");
    }
    out
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
