//! A URDF's text as links and joints: every number finite, every name known, every mistake with its line.

use super::frames::{HERE, Origin, matrix, placed};
use moca_msgs::robot::{LinkInertial, Payload};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;

/// Largest part of the trace by which an inertia may miss what a body can have: the last digits of a file.
const ROUNDING: f64 = 1e-6;

/// One link.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// In the link's frame; `None` where the file has no `<inertial>`.
    pub(super) inertial: Option<LinkInertial>,
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    Fixed,
    /// About a unit axis in the child's frame.
    Turning([f64; 3]),
    /// In a way that the controllers have no model of.
    Other,
}

/// What a joint may do, as far as the file says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limit {
    /// Least and greatest angle, rad.
    pub range_rad: Option<[f64; 2]>,
    /// Greatest speed, rad/s.
    pub speed_rad_s: Option<f64>,
    /// Greatest torque, N·m.
    pub torque_nm: Option<f64>,
}

/// One joint.
#[derive(Clone, Debug)]
pub(super) struct Joint<'a> {
    pub(super) name: &'a str,
    /// As the file calls it.
    pub(super) type_name: &'a str,
    pub(super) kind: Kind,
    pub(super) parent: &'a str,
    pub(super) child: &'a str,
    /// The child's frame in the parent's at angle 0.
    pub(super) origin: Origin,
    pub(super) limit: Limit,
    pub(super) mimics: bool,
}

/// A robot as its file describes it.
#[derive(Clone, Debug)]
pub(super) struct Model<'a> {
    pub(super) name: &'a str,
    pub(super) links: BTreeMap<&'a str, Link>,
    pub(super) joints: Vec<Joint<'a>>,
}

/// Reads a parsed XML document.
///
/// # Errors
/// The first mistake, with line, link or joint, and field.
pub(super) fn model<'a>(document: &'a Document<'a>) -> Result<Model<'a>, String> {
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        return Err(at(root, format!("<{}> where a URDF has <robot>", root.tag_name().name())));
    }
    if let Some(macros) = root
        .descendants()
        .find(|node| node.tag_name().namespace().is_some_and(|space| space.contains("xacro")))
    {
        return Err(at(macros, "xacro macros; write the URDF first: `xacro FILE.xacro > FILE.urdf`".into()));
    }
    let mut model =
        Model { name: root.attribute("name").unwrap_or("arm"), links: BTreeMap::new(), joints: Vec::new() };
    for node in root.children().filter(|node| node.has_tag_name("link")) {
        let name = name(node)?;
        let link = Link { inertial: inertial(node, name)? };
        if model.links.insert(name, link).is_some() {
            return Err(at(node, format!("link \"{name}\" is there twice")));
        }
    }
    for node in root.children().filter(|node| node.has_tag_name("joint")) {
        let joint = joint(node)?;
        for (end, link) in [("parent", joint.parent), ("child", joint.child)] {
            if !model.links.contains_key(link) {
                return Err(at(
                    node,
                    format!("joint \"{}\": {end} link \"{link}\" is not there", joint.name),
                ));
            }
        }
        if let Some(other) = model.joints.iter().find(|other| other.name == joint.name) {
            return Err(at(node, format!("joint \"{}\" is there twice", other.name)));
        }
        if let Some(other) = model.joints.iter().find(|other| other.child == joint.child) {
            let (child, other, name) = (joint.child, other.name, joint.name);
            return Err(at(
                node,
                format!("link \"{child}\" is the child of two joints, \"{other}\" and \"{name}\""),
            ));
        }
        model.joints.push(joint);
    }
    Ok(model)
}

fn at(node: Node<'_, '_>, message: String) -> String {
    format!("line {}: {message}", node.document().text_pos_at(node.range().start).row)
}

fn name<'a>(node: Node<'a, '_>) -> Result<&'a str, String> {
    let name = node.attribute("name").filter(|name| !name.is_empty());
    name.ok_or_else(|| at(node, format!("a <{}> without a name", node.tag_name().name())))
}

fn child<'a, 'd>(node: Node<'a, 'd>, tag: &str) -> Option<Node<'a, 'd>> {
    node.children().find(|child| child.has_tag_name(tag))
}

/// `count` numbers of an attribute; `None` where it is not there.
fn numbers<const N: usize>(
    node: Node<'_, '_>,
    of: &str,
    attribute: &str,
    unit: &str,
    range: [f64; 2],
) -> Result<Option<[f64; N]>, String> {
    let Some(text) = node.attribute(attribute) else { return Ok(None) };
    let field = format!("{of}: <{} {attribute}=\"{text}\">", node.tag_name().name());
    let parsed: Result<Vec<f64>, _> = text.split_whitespace().map(str::parse).collect();
    let numbers: [f64; N] = parsed.ok().and_then(|list| list.try_into().ok()).ok_or_else(|| {
        at(
            node,
            format!("{field}; expected {}", if N == 1 { "a number".into() } else { format!("{N} numbers") }),
        )
    })?;
    let [min, max] = range;
    match numbers.iter().find(|number| !(**number >= min && **number <= max)) {
        Some(number) => Err(at(node, format!("{field}: {number} {unit} is outside {min} to {max} {unit}"))),
        None => Ok(Some(numbers)),
    }
}

fn number(
    node: Node<'_, '_>,
    of: &str,
    attribute: &str,
    unit: &str,
    range: [f64; 2],
) -> Result<Option<f64>, String> {
    Ok(numbers(node, of, attribute, unit, range)?.map(|[number]| number))
}

/// The `<origin>` below `node`, or none.
fn origin(node: Node<'_, '_>, of: &str) -> Result<Origin, String> {
    let Some(node) = child(node, "origin") else { return Ok(HERE) };
    let [x, y, z] = numbers(node, of, "xyz", "m", [-10.0, 10.0])?.unwrap_or_default();
    let [roll, pitch, yaw] = numbers(node, of, "rpy", "rad", [-10.0, 10.0])?.unwrap_or_default();
    Ok([x, y, z, roll, pitch, yaw])
}

fn inertial(link: Node<'_, '_>, name: &str) -> Result<Option<LinkInertial>, String> {
    let Some(node) = child(link, "inertial") else { return Ok(None) };
    let of = format!("link \"{name}\"");
    let missing = |what: &str| at(node, format!("{of}: <inertial> without <{what}>"));
    let mass = child(node, "mass").ok_or_else(|| missing("mass value"))?;
    let mass_kg = number(mass, &of, "value", "kg", [0.0, 1000.0])?.ok_or_else(|| missing("mass value"))?;
    let inertia = child(node, "inertia").ok_or_else(|| missing("inertia"))?;
    let mut inertia_com = [0.0; 6];
    for (value, field) in inertia_com.iter_mut().zip(["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]) {
        *value = number(inertia, &of, field, "kg·m²", [-1000.0, 1000.0])?
            .ok_or_else(|| missing(&format!("inertia {field}")))?;
    }
    if mass_kg == 0.0 {
        return Ok(Some(Payload::NONE.inertial));
    }
    let mut principal: [f64; 3] = matrix(&inertia_com).symmetric_eigenvalues().into();
    principal.sort_by(f64::total_cmp);
    let [least, middle, most] = principal;
    let slack = ROUNDING * (least + middle + most).abs();
    if least <= 0.0 || most > least + middle + slack {
        return Err(at(
            inertia,
            format!(
                "{of}: <inertia> has the principal moments {least:.4e}, {middle:.4e} and {most:.4e} kg·m²; a body's are \
                 positive, and none is larger than the other two together"
            ),
        ));
    }
    let body = LinkInertial { mass_kg, com_m: [0.0; 3], inertia_com };
    let [x, y, z, ..] = origin(node, &of)?;
    let mut turn = origin(node, &of)?;
    turn[..3].fill(0.0);
    Ok(Some(LinkInertial { com_m: [x, y, z], ..placed(&body, &turn) }))
}

fn joint<'a>(node: Node<'a, '_>) -> Result<Joint<'a>, String> {
    let name = name(node)?;
    let of = format!("joint \"{name}\"");
    let end = |tag: &str| {
        let link = child(node, tag).and_then(|node| node.attribute("link"));
        link.ok_or_else(|| at(node, format!("{of} without <{tag} link>")))
    };
    let type_name = node.attribute("type").ok_or_else(|| at(node, format!("{of} without a type")))?;
    let kind = match type_name {
        "fixed" => Kind::Fixed,
        "revolute" | "continuous" => Kind::Turning(axis(node, &of)?),
        "prismatic" | "planar" | "floating" => Kind::Other,
        _ => {
            let allowed = "revolute, continuous, fixed, prismatic, planar or floating";
            return Err(at(node, format!("{of}: type=\"{type_name}\"; allowed: {allowed}")));
        }
    };
    Ok(Joint {
        name,
        type_name,
        kind,
        parent: end("parent")?,
        child: end("child")?,
        origin: origin(node, &of)?,
        limit: limit(node, &of, type_name == "revolute")?,
        mimics: child(node, "mimic").is_some(),
    })
}

/// Of length 1; x where the file names none.
fn axis(node: Node<'_, '_>, of: &str) -> Result<[f64; 3], String> {
    let Some(node) = child(node, "axis") else { return Ok([1.0, 0.0, 0.0]) };
    let [x, y, z] = numbers(node, of, "xyz", "", [-10.0, 10.0])?.unwrap_or([1.0, 0.0, 0.0]);
    let length = x.hypot(y).hypot(z);
    if length < 1e-6 {
        return Err(at(node, format!("{of}: <axis> has no direction")));
    }
    Ok([x, y, z].map(|component| component / length))
}

fn limit(joint: Node<'_, '_>, of: &str, ranged: bool) -> Result<Limit, String> {
    let Some(node) = child(joint, "limit") else { return Ok(Limit::default()) };
    let angle = |attribute| number(node, of, attribute, "rad", [-100.0, 100.0]);
    let positive = |attribute, unit, most| number(node, of, attribute, unit, [f64::MIN_POSITIVE, most]);
    let (low, high) = (angle("lower")?.unwrap_or(0.0), angle("upper")?.unwrap_or(0.0));
    if ranged && low >= high {
        return Err(at(node, format!("{of}: <limit lower={low} rad> is not below upper={high} rad")));
    }
    Ok(Limit {
        range_rad: ranged.then_some([low, high]),
        speed_rad_s: positive("velocity", "rad/s", 100.0)?,
        torque_nm: positive("effort", "N·m", 1e4)?,
    })
}
