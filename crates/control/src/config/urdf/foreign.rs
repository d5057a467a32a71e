//! Files of other people, each as a change of one file: read as it is meant, or refused with a remedy.

use super::{Given, read};
use crate::config::{Config, OwnArm};
use crate::robot::Arm;
use moca_msgs::robot::UR10E;
use std::path::PathBuf;

const MAKERS_UR10E: &str = include_str!("../../../../../examples/robots/ur10e.urdf");
const NO_TOOL: &str = "<link name=\"tool0\"/>";
const FINGERS: &str = "<link name=\"left\"><inertial><mass value=\"0.2\"/><inertia ixx=\"0\" ixy=\"0\" ixz=\"0\" iyy=\"0\" \
    iyz=\"0\" izz=\"0\"/></inertial></link><link name=\"right\"><inertial><mass value=\"0.2\"/><inertia ixx=\"0\" ixy=\"0\" \
    ixz=\"0\" iyy=\"0\" iyz=\"0\" izz=\"0\"/></inertial></link>\
    <joint name=\"grip\" type=\"prismatic\"><parent link=\"tool0\"/><child link=\"left\"/><axis xyz=\"0 1 0\"/>\
    <limit lower=\"0.01\" upper=\"0.04\" effort=\"0\" velocity=\"0\"/></joint>\
    <joint name=\"grip2\" type=\"prismatic\"><mimic joint=\"grip\" multiplier=\"-1\"/><parent link=\"tool0\"/>\
    <child link=\"right\"/><axis xyz=\"0 1 0\"/></joint></robot>";

/// The arm of the UR10e's file with every `from` in it turned into `to`.
fn changed(from: &str, to: &str, given: impl Fn(&mut OwnArm)) -> Result<Arm, String> {
    assert!(MAKERS_UR10E.contains(from), "{from}");
    arm(&MAKERS_UR10E.replace(from, to), given)
}

fn arm(urdf: &str, given: impl Fn(&mut OwnArm)) -> Result<Arm, String> {
    let folder = Folder::new(urdf);
    let mut section = OwnArm {
        urdf: "arm.urdf".into(),
        base_link: "base_link".into(),
        tip_link: "tool0".into(),
        home_rad: UR10E.home_rad.into(),
        ..OwnArm::default()
    };
    given(&mut section);
    section
        .arm(&folder.0, false)
        .map_err(|mistakes| mistakes.into_iter().map(|(_, message)| message).collect::<Vec<_>>().join("\n"))
}

/// A folder of its own with one URDF in it.
struct Folder(PathBuf);

impl Folder {
    fn new(urdf: &str) -> Self {
        use std::sync::atomic::{AtomicUsize, Ordering};
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let name = format!("moca-urdf-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("arm.urdf"), urdf).unwrap();
        Self(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

fn as_it_is(_: &mut OwnArm) {}

/// A number that the controllers have no use for is not said, or the largest that they have.
#[test]
fn limit_of_zero_is_not_said_and_the_key_to_set_is_named() {
    let without = |attribute: &str| {
        let mut text = MAKERS_UR10E.to_owned();
        let find = format!(" {attribute}=\"");
        while let Some(at) = text.find(&find) {
            let value = at + find.len();
            let end = value + text[value..].find('"').unwrap();
            text.replace_range(at..=end, "");
        }
        text
    };
    for (text, key, list) in [
        (without("effort"), "arm.torque_max_nm", "[?, ?, ?, ?, ?, ?] N·m"),
        (without("velocity"), "arm.dq_max_rad_s", "[?, ?, ?, ?, ?, ?] rad/s"),
        (
            MAKERS_UR10E.replace("effort=\"56\"", "effort=\"0\""),
            "arm.torque_max_nm",
            "[330.0, 330.0, 150.0, ?, ?, ?] N·m",
        ),
    ] {
        let said = arm(&text, as_it_is).unwrap_err();
        assert!(
            said.contains("is 0 or missing: not said; set") && said.contains(&format!("set {key} = {list}")),
            "{said}"
        );
        assert!(said.len() < 400, "{said}");
    }
    let given =
        changed("effort=\"330\"", "effort=\"much\"", |arm| arm.torque_max_nm = vec![40.0; 6]).unwrap();
    assert_eq!(given.table.table.torque_max_nm[..6], [40.0; 6], "what is given is not read in the file");
    let negative = changed("effort=\"150\"", "effort=\"-1\"", as_it_is).unwrap_err();
    assert!(
        negative.contains("<limit effort=\"-1\"> is not above 0 N·m; correct it, or set arm.torque_max_nm"),
        "{negative}"
    );
    let huge = changed("effort=\"150\"", "effort=\"1e9\"", as_it_is).unwrap();
    assert_eq!(huge.table.table.torque_max_nm[2].to_bits(), 1000.0_f64.to_bits());
}

#[test]
fn what_a_configuration_gives_is_not_judged_in_the_file() {
    let shoulder = "<mass value=\"7.369\"/>";
    assert!(changed(shoulder, "<mass value=\"-1\"/>", as_it_is).is_err());
    let masses = vec![4.0, 7.4, 13.0, 3.9, 2.0, 2.0, 0.2];
    let given = changed(shoulder, "<mass value=\"-1\"/>", |arm| arm.mass_kg.clone_from(&masses)).unwrap();
    assert_eq!(given.table.table.links[0].mass_kg.to_bits(), 7.4_f64.to_bits());
    let body = [0.02, 0.0, 0.0, 0.02, 0.0, 0.02].repeat(7);
    let given = changed(" iyy=\"0.03529\"", "", |arm| arm.inertia_com.clone_from(&body)).unwrap();
    assert_eq!(given.table.table.links[0].inertia_com.to_vec(), body[..6]);
    let range = "lower=\"-6.283185307179586\"";
    assert!(
        changed(range, "lower=\"7\"", as_it_is).unwrap_err().contains("set arm.q_min_rad and arm.q_max_rad")
    );
    let given = changed(range, "lower=\"7\"", |arm| {
        (arm.q_min_rad, arm.q_max_rad) = (vec![-3.0; 6], vec![3.0; 6]);
    });
    assert_eq!(given.unwrap().table.table.q_min_rad[..6], [-3.0; 6]);
}

#[test]
fn continuous_joint_is_named_and_the_others_keep_their_ranges() {
    let wrist = "<joint name=\"wrist_3_joint\" type=\"revolute\">";
    let said = changed(wrist, &wrist.replace("revolute", "continuous"), as_it_is).unwrap_err();
    let low = "set arm.q_min_rad = [-6.283185307179586, -6.283185307179586, -3.141592653589793, -6.283185307179586, \
               -6.283185307179586, ?] and arm.q_max_rad = [6.283185307179586, ";
    assert!(
        said.contains("joint \"wrist_3_joint\": continuous, so without a range; ") && said.contains(low),
        "{said}"
    );
    let no_range =
        changed("lower=\"-3.141592653589793\" upper=\"3.141592653589793\"", "", as_it_is).unwrap_err();
    assert!(
        no_range
            .contains("joint \"elbow_joint\": lower and upper are 0 or missing: not said; set arm.q_min_rad"),
        "{no_range}"
    );
}

#[test]
fn limits_of_joints_that_do_not_turn_are_not_judged() {
    let fixed = "<child link=\"base_link_inertia\"/>";
    let limit = "<limit effort=\"0\" lower=\"0\" upper=\"0\" velocity=\"-1\"/>";
    assert!(changed(fixed, &format!("{fixed}{limit}"), as_it_is).is_ok());
}

/// By the parallel-axis theorem.
#[test]
fn point_mass_on_a_fixed_link_is_weighed_where_it_is() {
    let point = |inertia: &str, mass: f64| {
        let body = format!(
            "<link name=\"tool0\"><inertial><origin xyz=\"0 0 0.1\"/><mass value=\"{mass}\"/><inertia ixx=\"{inertia}\" \
             ixy=\"0\" ixz=\"0\" iyy=\"{inertia}\" iyz=\"0\" izz=\"{inertia}\"/></inertial></link>"
        );
        changed(NO_TOOL, &body, as_it_is)
    };
    let (plain, loaded) = (changed(NO_TOOL, NO_TOOL, as_it_is).unwrap(), point("0", 0.5).unwrap());
    let wrist = |arm: &Arm| arm.table.table.links[5];
    assert!((wrist(&loaded).mass_kg - wrist(&plain).mass_kg - 0.5).abs() < 1e-12);
    assert!(wrist(&loaded).inertia_com[0] > wrist(&plain).inertia_com[0]);
    let said = point("0.1", 0.0).unwrap_err();
    assert!(
        said.contains("link \"tool0\": <mass value=\"0\"> with an <inertia> that is not 0; give it its mass"),
        "{said}"
    );
    assert_eq!(point("0", 0.0).unwrap().table, plain.table, "nothing is nothing");
}

#[test]
fn inertia_that_no_body_has_is_refused_with_link_and_key() {
    let said = changed(" iyy=\"0.03529\"", " iyy=\"0.5\"", as_it_is).unwrap_err();
    assert!(
        said.starts_with("arm.inertia_com of link \"shoulder_link\" (link 1) has the principal moments"),
        "{said}"
    );
    assert!(said.ends_with("; set arm.inertia_com"), "{said}");
}

#[test]
fn text_is_taken_as_other_readers_of_urdfs_take_it() {
    let plain = changed(NO_TOOL, NO_TOOL, as_it_is).unwrap();
    let after_declaration = |insert: &str| {
        let end = MAKERS_UR10E.find("?>").unwrap() + 2;
        format!("{}{insert}{}", &MAKERS_UR10E[..end], &MAKERS_UR10E[end..])
    };
    for text in [
        format!("\n\n  {MAKERS_UR10E}"),
        format!("\u{feff}{MAKERS_UR10E}"),
        after_declaration("\n<!DOCTYPE robot>"),
        MAKERS_UR10E
            .replace("</robot>", "<gazebo><sensor:ray/><xyz:abc sensor:type=\"1\"/></gazebo></robot>"),
    ] {
        assert_eq!(arm(&text, as_it_is).unwrap_or_else(|why| panic!("{why}: {text}")).table, plain.table);
    }
    let late =
        arm(&format!("\n\n{}", MAKERS_UR10E.replace("mass value=\"7.369\"", "mass value=\"x\"")), as_it_is);
    let (late, line) =
        (late.unwrap_err(), MAKERS_UR10E.lines().position(|line| line.contains("7.369")).unwrap() + 3);
    assert!(late.contains(&format!("line {line}: link \"shoulder_link\"")), "{late}");
    let entity = arm(&after_declaration("\n<!DOCTYPE robot [<!ENTITY a \"b\">]>"), as_it_is).unwrap_err();
    assert!(entity.contains("it declares an XML entity, which is not read"), "{entity}");
    let xacro = arm("<robot name=\"r\"><xacro:macro name=\"m\"/></robot>", as_it_is).unwrap_err();
    assert!(xacro.contains("xacro macros; write the URDF first"), "{xacro}");
    let left_over = MAKERS_UR10E.replace(
        "</robot>",
        "<xacro:sensors xmlns:xacro=\"http://ros.org/wiki/xacro\" port=\"none\"/></robot>",
    );
    assert_eq!(arm(&left_over, as_it_is).unwrap().table, plain.table, "xacro ran and did not know the macro");
}

/// Two fingers at 0.01 m, the end of their range that is nearest to 0, weigh as two points there.
#[test]
fn fingers_behind_the_flange_are_held_and_weighed() {
    let held = changed("</robot>", FINGERS, as_it_is).unwrap();
    let point = |y: f64| {
        format!(
            "<inertial><origin xyz=\"0 {y} 0\"/><mass value=\"0.2\"/><inertia ixx=\"0\" ixy=\"0\" ixz=\"0\" iyy=\"0\" \
             iyz=\"0\" izz=\"0\"/></inertial>"
        )
    };
    let fixed = |name: &str, body: &str| {
        format!(
            "<link name=\"{name}\">{body}</link><joint name=\"at_{name}\" type=\"fixed\"><parent link=\"tool0\"/>\
             <child link=\"{name}\"/></joint>"
        )
    };
    let points = format!("{}{}</robot>", fixed("left", &point(0.01)), fixed("right", &point(-0.01)));
    assert_eq!(held.table, changed("</robot>", &points, as_it_is).unwrap().table);
    let turned = FINGERS.replace("prismatic", "revolute").replace("lower=\"0.01\"", "lower=\"-1\"");
    assert_eq!(
        changed("</robot>", &turned, as_it_is).unwrap().table.table.links[5].mass_kg.to_bits(),
        held.table.table.links[5].mass_kg.to_bits(),
        "a finger that turns is held, too"
    );
    let in_a_circle =
        FINGERS.replace("<axis xyz=\"0 1 0\"/><limit", "<mimic joint=\"grip2\"/><axis xyz=\"0 1 0\"/><limit");
    assert!(
        changed("</robot>", &in_a_circle, as_it_is).is_ok(),
        "joints that mimic each other are held, somewhere"
    );
    let slides = changed(
        "<joint name=\"wrist_3_joint\" type=\"revolute\">",
        "<joint name=\"wrist_3_joint\" type=\"prismatic\">",
        as_it_is,
    );
    let slides = slides.unwrap_err();
    assert!(
        slides.contains("joint \"wrist_3_joint\" is prismatic; an arm here has")
            && slides.contains("make it fixed"),
        "{slides}"
    );
}

/// The last two joints turn about one line: no gains of any size are stable, in no posture.
#[test]
fn arm_that_is_singular_everywhere_is_refused_as_such() {
    let origin =
        "<origin xyz=\"0 0.11655 0\" rpy=\"1.5707963267948966 3.141592653589793 3.141592653589793\"/>";
    let one_line = changed(origin, "", as_it_is).unwrap();
    let mut config = Config::default();
    config.robot.arm = one_line;
    config.own_arm = OwnArm::of(&config.robot.arm);
    let mut table: toml::Table = toml::to_string(&config.to_toml()).unwrap().parse().unwrap();
    table.remove("control");
    table.remove("limits");
    let said = Config::parse(&toml::to_string(&table).unwrap()).unwrap_err().to_string();
    assert!(said.contains("control.gains.posture_rad: the arm is singular there"), "{said}");
    assert!(said.ends_with("where two joints turn about one line, another arm.tip_link"), "{said}");
}

#[test]
fn default_posture_gains_are_stable_for_a_light_arm() {
    let mut light = UR10E;
    for link in &mut light.links {
        link.mass_kg *= 0.02;
        link.inertia_com = link.inertia_com.map(|value| 1e-4 * value);
    }
    let mut config = Config::default();
    config.robot.arm.table = moca_msgs::robot::AnyArm::of(&light);
    config.robot.arm.source = crate::robot::OWN_ARM.into();
    config.robot.arm.capsules.clear();
    config.own_arm = OwnArm::of(&config.robot.arm);
    let text = toml::to_string(&config.to_toml()).unwrap();
    let mut table: toml::Table = text.parse().unwrap();
    table.remove("control");
    table.remove("limits");
    let light = Config::parse(&toml::to_string(&table).unwrap());
    let light = light.unwrap_or_else(|error| panic!("defaults of a light arm are stable: {error}"));
    assert!(light.control.gains.posture_damping[5] < UR10E.posture_damping_nm_s_rad[5]);
}

#[test]
fn nothing_is_read_beyond_what_is_needed() {
    let given = Given { mass: true, com: true, inertia: true, range: true, speed: true, torque: true };
    let bare = "<robot name=\"r\"><link name=\"a\"><inertial/></link><link name=\"b\"><inertial/></link>\
                <joint name=\"j\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/><limit effort=\"x\"/></joint></robot>";
    assert_eq!(read(bare, "", "", &given).unwrap().joints.len(), 1);
    assert!(read(bare, "", "", &Given::default()).unwrap_err().contains("<inertial> without <mass value>"));
}
