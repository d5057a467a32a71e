use super::frames::{inverse, placed, then};
use super::{Given, UrdfArm, urdf};
use crate::config::OwnArm;
use crate::robot::{Arm, Parts, Robot};
use moca_msgs::robot::{AnyArm, ArmTable, PANDA, Payload, UR10E};
use moca_wbc::{ArmModel, robot::MOCA_MOUNT};
use std::fmt::Write;
use std::path::Path;

const MAKERS_UR10E: &str = include_str!("../../../../../examples/robots/ur10e.urdf");

fn read(text: &str, base: &str, tip: &str) -> Result<UrdfArm, String> {
    super::read(text, base, tip, &Given::default())
}

fn robot(arm: &str) -> Robot {
    Robot { arm: Arm::built_in(arm).unwrap(), ..Robot::default() }
}

/// The table of a file, with what no URDF has as `like` has it.
fn table(text: &str, base: &str, tip: &str, like: &AnyArm) -> AnyArm {
    let arm = read(text, base, tip).unwrap();
    assert_eq!(arm.joints.len(), like.joints);
    let mut table = *like;
    (table.table.link0, table.table.flange_origin) = (arm.link0, arm.flange_origin);
    for (i, joint) in arm.joints.iter().enumerate() {
        (table.table.joint_origin[i], table.table.links[i]) = (joint.origin, joint.link);
    }
    table
}

/// Largest difference of pose, Jacobian, mass matrix and bias of two arms, each over its largest number.
fn difference<const N: usize>(one: &ArmTable<N>, other: &ArmTable<N>) -> f64 {
    let [one, other] =
        [one, other].map(|table| ArmModel::<N, f64>::new(table, &MOCA_MOUNT, &Payload::NONE).unwrap());
    let mut most: f64 = 0.0;
    for k in 0..50_u32 {
        let angle = |i: usize, a: f64| 2.5 * (a * f64::from(k) + 1.7 * i as f64).sin();
        let (q, dq) = (std::array::from_fn(|i| angle(i, 0.37)), std::array::from_fn(|i| angle(i, 0.53)));
        let numbers = |model: &ArmModel<N, f64>| {
            let dynamics = model.dynamics(0.3, &q, &dq);
            let kinematics = &dynamics.kinematics;
            [
                kinematics.tool_position.as_slice().to_vec(),
                kinematics.tool_rotation.as_slice().to_vec(),
                kinematics.arm_jacobian().as_slice().to_vec(),
                dynamics.mass.as_slice().to_vec(),
                dynamics.base_coupling.as_slice().to_vec(),
                dynamics.bias.to_vec(),
            ]
        };
        for (one, other) in numbers(&one).iter().zip(&numbers(&other)) {
            let scale = one.iter().fold(1.0_f64, |most, number| most.max(number.abs()));
            most = one.iter().zip(other).fold(most, |most, (a, b)| most.max((a - b).abs() / scale));
        }
    }
    most
}

fn assert_same(one: &AnyArm, other: &AnyArm, within: f64) {
    let error = match one.joints {
        6 => difference::<6>(&one.table().unwrap(), &other.table().unwrap()),
        _ => difference::<7>(&one.table().unwrap(), &other.table().unwrap()),
    };
    assert!(error <= within, "{error}");
}

#[test]
fn what_is_written_reads_back_to_the_same_bits() {
    for name in Arm::built_in_names() {
        let robot = robot(name);
        for parts in [Parts::Arm, Parts::Whole] {
            let text = urdf(&robot, parts);
            assert_eq!(table(&text, "arm_link0", "flange", &robot.arm.table), robot.arm.table, "{name}");
            let arm = read(&text, "arm_link0", "flange").unwrap();
            for (i, joint) in arm.joints.iter().enumerate() {
                let built_in = &robot.arm.table.table;
                assert_eq!(joint.limit.range_rad, Some([built_in.q_min_rad[i], built_in.q_max_rad[i]]));
                assert_eq!(joint.limit.speed_rad_s, Some(built_in.dq_max_rad_s[i]));
                assert_eq!(joint.limit.torque_nm, Some(built_in.torque_max_nm[i]));
            }
        }
    }
}

/// The arm in other frames: joints about x, y, −z and askew, a fixed joint in the middle of each link with half of its body,
/// inertias in turned axes.
#[test]
fn whatever_frames_a_file_puts_its_links_in_it_is_the_same_arm() {
    for name in Arm::built_in_names() {
        let arm = robot(name).arm.table;
        let text = in_other_frames(&arm);
        assert_same(&table(&text, "l0", "tip", &arm), &arm, 1e-12);
    }
}

fn in_other_frames(arm: &AnyArm) -> String {
    let turns = [
        [0.0, 0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2, 0.0],
        [0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2, 0.0, 0.0],
        [0.0, 0.0, 0.0, std::f64::consts::PI, 0.0, 0.0],
        [0.02, -0.01, 0.03, 0.3, -1.2, 2.2],
    ];
    let mut text = String::from("<robot name=\"r\">");
    let mut body = |link: &str, inertial: &moca_msgs::robot::LinkInertial, share: f64| {
        // in axes turned by an arbitrary angle
        let turn = [0.0, 0.0, 0.0, 0.4, -0.7, 1.1];
        let [x, y, z] = inertial.com_m;
        let only = moca_msgs::robot::LinkInertial { com_m: [0.0; 3], ..*inertial };
        let [xx, xy, xz, yy, yz, zz] = placed(&only, &inverse(&turn)).inertia_com.map(|value| share * value);
        let mass = share * inertial.mass_kg;
        write!(
            text,
            "<link name=\"{link}\"><inertial><origin xyz=\"{x:?} {y:?} {z:?}\" rpy=\"0.4 -0.7 1.1\"/><mass value=\"{mass:?}\"/>\
             <inertia ixx=\"{xx:?}\" ixy=\"{xy:?}\" ixz=\"{xz:?}\" iyy=\"{yy:?}\" iyz=\"{yz:?}\" izz=\"{zz:?}\"/></inertial></link>"
        )
        .unwrap();
    };
    let mut joints = String::new();
    let mut joint = |name: &str, kind: &str, parent: &str, child: &str, origin: [f64; 6], axis: [f64; 3]| {
        let ([x, y, z, r, p, w], [a, b, c]) = (origin, axis);
        write!(
            joints,
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <origin xyz=\"{x:?} {y:?} {z:?}\" rpy=\"{r:?} {p:?} {w:?}\"/><axis xyz=\"{a:?} {b:?} {c:?}\"/></joint>"
        )
        .unwrap();
    };
    body("l0", &arm.table.link0, 1.0);
    let mut own = super::frames::HERE;
    for i in 0..arm.joints {
        let (before, link, half) = (format!("l{i}"), format!("l{}", i + 1), format!("half{}", i + 1));
        // only a turn: the joint's axis has to go through the link's origin
        let mut turn = turns[i % turns.len()];
        turn[..3].fill(0.0);
        let origin = then(&then(&inverse(&own), &arm.table.joint_origin[i]), &turn);
        let z = placed(
            &moca_msgs::robot::LinkInertial { mass_kg: 1.0, com_m: [0.0, 0.0, 2.0], inertia_com: [0.0; 6] },
            &inverse(&turn),
        );
        joint(&format!("q{}", i + 1), "continuous", &before, &link, origin, z.com_m);
        own = turn;
        let inertial = placed(&arm.table.links[i], &inverse(&own));
        body(&link, &inertial, 0.5);
        let aside = turns[3];
        body(&half, &placed(&inertial, &inverse(&aside)), 0.5);
        joint(&format!("fixed{}", i + 1), "fixed", &link, &half, aside, [1.0, 0.0, 0.0]);
    }
    let tip = then(&inverse(&own), &arm.table.flange_origin);
    joint("tip", "fixed", &format!("l{}", arm.joints), "tip", tip, [1.0, 0.0, 0.0]);
    format!("{text}<link name=\"tip\"/>{joints}</robot>")
}

/// Inertias of the wrist in turned axes, a base turned by a fixed joint, a flange by two.
#[test]
fn the_file_of_a_maker_is_the_built_in_table() {
    let built_in = AnyArm::of(&UR10E);
    assert_same(&table(MAKERS_UR10E, "base_link", "tool0", &built_in), &built_in, 1e-12);
    assert_same(&table(MAKERS_UR10E, "", "", &built_in), &built_in, 1e-12);
}

#[test]
fn a_file_that_is_no_arm_is_refused_with_link_and_field() {
    let refused = |from: &str, to: &str| {
        assert!(MAKERS_UR10E.contains(from), "{from}");
        read(&MAKERS_UR10E.replacen(from, to, 1), "base_link", "tool0").unwrap_err()
    };
    let shoulder = "<mass value=\"7.369\"/>";
    for (from, to, expected) in [
        (shoulder, "", "link \"shoulder_link\": <inertial> without <mass value>"),
        (
            shoulder,
            "<mass value=\"heavy\"/>",
            "link \"shoulder_link\": <mass value=\"heavy\">; expected a number",
        ),
        (
            shoulder,
            "<mass value=\"NaN\"/>",
            "link \"shoulder_link\": <mass value=\"NaN\">: NaN is not finite; write a number, or set arm.mass_kg",
        ),
        (
            shoulder,
            "<mass value=\"0\"/>",
            "link \"shoulder_link\": <mass value=\"0\"> with an <inertia> that is not 0; give it its mass",
        ),
        (shoulder, "<mass value=\"-1\"/>", "-1 kg is outside 0 to 1000 kg; correct it, or set arm.mass_kg"),
        (" iyy=\"0.03529\"", "", "link \"shoulder_link\": <inertial> without <inertia iyy>"),
        (
            "-0.6127 0 0",
            "-0.6127 inf 0",
            "joint \"elbow_joint\": <origin xyz=\"-0.6127 inf 0\">: inf is not finite; write a number",
        ),
        ("-0.6127 0 0", "-0.6127 0", "joint \"elbow_joint\": <origin xyz=\"-0.6127 0\">; expected 3 numbers"),
        (
            "<axis xyz=\"0 0 1\"/>",
            "<axis xyz=\"0 0 0\"/>",
            "joint \"shoulder_pan_joint\": <axis> has no direction",
        ),
        (
            "type=\"revolute\"",
            "type=\"prismatic\"",
            "joint \"shoulder_pan_joint\" is prismatic; an arm here has",
        ),
        (
            "type=\"revolute\"",
            "type=\"revolving\"",
            "joint \"shoulder_pan_joint\": type=\"revolving\"; allowed:",
        ),
        (
            "<axis xyz=\"0 0 1\"/>",
            "<axis xyz=\"0 0 1\"/><mimic joint=\"x\"/>",
            "joint \"shoulder_pan_joint\" mimics another",
        ),
        (
            "velocity=\"2.0943951023931953\"",
            "velocity=\"-1\"",
            "joint \"shoulder_pan_joint\": <limit velocity=\"-1\"> is not above 0 rad/s; correct it, or set arm.dq_max_rad_s",
        ),
        (
            "lower=\"-6.283185307179586\"",
            "lower=\"7\"",
            "joint \"shoulder_pan_joint\": <limit lower=7 rad> is not below upper=",
        ),
        (
            "<child link=\"forearm_link\"/>",
            "<child link=\"fourarm_link\"/>",
            "joint \"elbow_joint\": child link \"fourarm_link\" is not there",
        ),
        (
            "<child link=\"forearm_link\"/>",
            "<child link=\"shoulder_link\"/>",
            "link \"shoulder_link\" is the child of two joints",
        ),
        ("<child link=\"forearm_link\"/>", "<child/>", "joint \"elbow_joint\" without <child link>"),
        (
            "<link name=\"tool0\"/>",
            "<link name=\"tool0\"/><link name=\"flange\"/>",
            "link \"flange\" is there twice",
        ),
        ("<link name=\"tool0\"/>", "<link/>", "a <link> without a name"),
        ("<robot name=\"ur10e\">", "<sdf>", "no XML"),
        (
            "</robot>",
            "<joint name=\"back\" type=\"fixed\"><parent link=\"tool0\"/><child link=\"base_link\"/></joint></robot>",
            "the joints above link \"base_link\" go in a circle",
        ),
        ("<robot name", "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\" name", ""),
    ] {
        if expected.is_empty() {
            // a namespace alone is no macro
            assert!(read(&MAKERS_UR10E.replacen(from, to, 1), "base_link", "tool0").is_ok());
            continue;
        }
        let said = refused(from, to);
        assert!(said.contains(expected), "{from} to {to}: {said}");
    }
    let wrong = |base: &str, tip: &str| read(MAKERS_UR10E, base, tip).unwrap_err();
    assert!(
        wrong("base", "tool0").starts_with("arm.base_link = \"base\" is no link of it; it has base_link, ")
    );
    assert!(
        wrong("tool0", "base_link").contains("no chain of joints leads from link \"tool0\" to \"base_link\"")
    );
    assert!(wrong("flange", "tool0").contains("between link \"flange\" and \"tool0\" nothing turns"));
    let xacro = "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\">\n<xacro:macro name=\"m\"/></robot>";
    assert!(read(xacro, "", "").unwrap_err().starts_with("line 2: xacro macros; write the URDF first"));
    assert!(read("<sdf/>", "", "").unwrap_err().contains("<sdf> where a URDF has <robot>"));
    let two = "<robot name=\"r\"><link name=\"a\"/><link name=\"b\"/></robot>";
    assert_eq!(read(two, "", "").unwrap_err(), "arm.base_link has to name one of a, b");
}

#[test]
fn a_section_gives_its_arm_and_an_arm_its_section() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/robots"));
    let section = OwnArm {
        urdf: "ur10e.urdf".into(),
        tip_link: "tool0".into(),
        home_rad: UR10E.home_rad.into(),
        torque_max_nm: vec![40.0; 6],
        ..OwnArm::default()
    };
    let arm = section.arm(folder, false).unwrap();
    assert_eq!((arm.name.as_str(), arm.table.joints), ("ur10e", 6));
    assert_eq!(
        arm.table.table.torque_max_nm[..6],
        [40.0; 6],
        "what the section says replaces what the file does"
    );
    let again = OwnArm::of(&arm);
    assert!(again.urdf.is_empty() && again.arm(Path::new("/nowhere"), false).unwrap() == arm);

    let wrong = |change: &dyn Fn(&mut OwnArm)| {
        let mut section = section.clone();
        change(&mut section);
        section.arm(folder, false).unwrap_err().remove(0).1
    };
    assert!(wrong(&|arm| arm.urdf = "none.urdf".into()).contains("No such file"));
    assert_eq!(
        wrong(&|arm| arm.home_rad.clear()),
        "arm.home_rad has 0 numbers; 6 are needed, one for each joint"
    );
    assert_eq!(
        wrong(&|arm| arm.home_rad[2] = 4.0),
        "arm.home_rad = 4 rad of joint 3 is outside its range, -3.141592653589793 to 3.141592653589793 rad"
    );
    assert_eq!(
        wrong(&|arm| arm.joint_origin = vec![0.0; 30]),
        "arm.joint_origin has 30 numbers; six for each joint of an arm of 6 or 7 joints are allowed"
    );
    assert_eq!(
        wrong(&|arm| arm.mass_kg = vec![1.0; 6]),
        "arm.mass_kg has 6 numbers; 7 are needed, one for each link, the first stands on the base"
    );
    assert_eq!(
        wrong(&|arm| arm.mass_kg = vec![0.0; 7]),
        "arm.mass_kg = 0 kg of link \"shoulder_link\" (link 1), which joint 1 moves; set arm.mass_kg, above 0 kg, and \
         arm.inertia_com with it"
    );
    assert!(
        wrong(&|arm| arm.inertia_com = vec![0.1; 42])
            .starts_with("arm.inertia_com of link 0 has the principal moments")
    );
    assert_eq!(wrong(&|arm| arm.mass_kg = vec![2000.0; 7]), "arm.mass_kg = 2000 kg is outside 0 to 1000 kg");
    assert_eq!(
        wrong(&|arm| arm.q_min_rad = vec![7.0; 6]),
        "arm.q_min_rad = 7 rad of joint 1 is not below arm.q_max_rad = 6.283185307179586 rad"
    );
    assert!(
        wrong(&|arm| arm.speed_offset_rad_s = vec![0.1; 6])
            .starts_with("arm.speed_deceleration_rad_s2 has 0")
    );
    let mut section = section;
    (section.mass_kg, section.home_rad) = (vec![0.0; 7], vec![6.9; 6]);
    section.dq_max_rad_s = vec![1.0; 3];
    let all: Vec<_> = section.arm(folder, false).unwrap_err().into_iter().map(|(row, _)| row).collect();
    let of = |row: &str| all.iter().filter(|other| **other == row).count();
    assert_eq!((of("arm.mass_kg"), of("arm.home_rad"), of("arm.dq_max_rad_s"), all.len()), (6, 6, 1, 13));
}

#[test]
fn arm_with_all_origins_at_zero_is_refused() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/robots"));
    let of_length = |length_m: f64| {
        let section = OwnArm {
            urdf: "ur10e.urdf".into(),
            tip_link: "tool0".into(),
            home_rad: UR10E.home_rad.into(),
            joint_origin: vec![0.0; 36],
            flange_origin: vec![0.0, 0.0, length_m, 0.0, 0.0, 0.0],
            ..OwnArm::default()
        };
        section.arm(folder, false)
    };
    let mistakes = of_length(0.0).unwrap_err();
    let said = &mistakes[0].1;
    assert!(mistakes.len() == 1 && mistakes[0].0 == "arm.joint_origin", "{mistakes:?}");
    assert!(said.contains("the links are 0 m long together; at least 0.1 m are needed"), "{said}");
    assert!(of_length(0.0999).is_err() && of_length(0.1).is_ok());
}

/// Results of Pinocchio for the file that is written here (tests/fixtures/urdf/panda.py).
#[test]
fn written_urdf_matches_foreign_library() {
    let written = urdf(&Robot::default(), Parts::Whole);
    assert_eq!(written, include_str!("../../../../../tests/fixtures/urdf/panda.urdf"));
    let foreign: serde_json::Value =
        serde_json::from_str(include_str!("../../../../../tests/fixtures/urdf/panda.json")).unwrap();
    let model = ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
    let list = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
    };
    // Rows of a symmetric matrix are its columns; a rotation's are not.
    let matrix =
        |value: &serde_json::Value| value.as_array().unwrap().iter().flat_map(list).collect::<Vec<_>>();
    let rows = foreign["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 20);
    for row in rows {
        let dynamics = model.dynamics(0.0, &list(&row["q"]).try_into().unwrap(), &[0.0; 7]);
        let kinematics = &dynamics.kinematics;
        let flange_base = kinematics.tool_from_base();
        for (ours, theirs) in [
            (flange_base.as_slice(), list(&row["flange_base"])),
            (kinematics.tool_rotation.transpose().as_slice(), matrix(&row["rotation"])),
            (dynamics.mass.as_slice(), matrix(&row["mass"])),
        ] {
            assert_eq!(ours.len(), theirs.len());
            assert!(ours.iter().zip(theirs).all(|(a, b)| (a - b).abs() < 1e-9), "{ours:?}");
        }
    }
}
