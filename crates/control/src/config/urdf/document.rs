//! A URDF's text as links and joints. Numbers are judged where they are used, each with its line: what a configuration gives
//! itself is not read, nor is what belongs to no link of the arm.

use super::frames::{HERE, Origin, placed, then, turned_about};
use moca_msgs::robot::{LinkInertial, Payload};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;

/// Largest joint angle, rad, speed, rad/s, and torque, N·m, that the controllers use. A limit beyond them counts as these.
const MOST: (f64, f64, f64) = (100.0, 100.0, 1000.0);
/// Mass of a part whose mass the configuration gives with the whole's: it adds nothing to other parts.
const NEXT_TO_NO_MASS_KG: f64 = 1e-200;
/// Words of xacro's own, which are gone once it has run.
const XACRO: &[&str] = &["macro", "include", "property", "arg", "if", "unless", "insert_block"];
/// Most joints that mimic one another in a chain.
const MIMICS_MAX: usize = 16;

/// Which numbers a configuration gives itself, so that those of the file are not read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Given {
    /// Masses of the links.
    pub mass: bool,
    /// Centres of mass.
    pub com: bool,
    /// Inertias about them.
    pub inertia: bool,
    /// Both ends of the joints' ranges.
    pub range: bool,
    /// Largest joint speeds.
    pub speed: bool,
    /// Largest joint torques.
    pub torque: bool,
}

/// Motion of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    Fixed,
    /// About a unit axis in the child's frame.
    Turning([f64; 3]),
    /// Along a unit axis in the child's frame.
    Sliding([f64; 3]),
    /// In a way that has no axis.
    Other,
}

/// Limits of a joint, as far as the file gives them.
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
#[derive(Clone, Copy, Debug)]
pub(super) struct Joint<'a> {
    pub(super) name: &'a str,
    /// As the file calls it.
    pub(super) type_name: &'a str,
    pub(super) parent: &'a str,
    pub(super) child: &'a str,
    node: Node<'a, 'a>,
}

/// A robot as its file describes it.
#[derive(Clone, Debug)]
pub(super) struct Model<'a> {
    pub(super) name: &'a str,
    pub(super) links: BTreeMap<&'a str, Node<'a, 'a>>,
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
    // what xacro leaves behind of a macro that it did not know is an element like any other that no URDF has
    let xacro =
        |node: &Node<'_, '_>| node.tag_name().namespace().is_some_and(|space| space.contains("xacro"));
    if let Some(macros) =
        root.descendants().find(|node| xacro(node) && XACRO.contains(&node.tag_name().name()))
    {
        return Err(at(macros, "xacro macros; write the URDF first: `xacro FILE.xacro > FILE.urdf`".into()));
    }
    let mut model =
        Model { name: root.attribute("name").unwrap_or("arm"), links: BTreeMap::new(), joints: Vec::new() };
    for node in root.children().filter(|node| node.has_tag_name("link")) {
        let name = name(node)?;
        if model.links.insert(name, node).is_some() {
            return Err(at(node, format!("link \"{name}\" is there twice; rename one")));
        }
    }
    for node in root.children().filter(|node| node.has_tag_name("joint")) {
        let joint = joint(node)?;
        for (end, link) in [("parent", joint.parent), ("child", joint.child)] {
            if !model.links.contains_key(link) {
                return Err(at(
                    node,
                    format!("joint \"{}\": {end} link \"{link}\" is not there; add it", joint.name),
                ));
            }
        }
        if let Some(other) = model.joints.iter().find(|other| other.name == joint.name) {
            return Err(at(node, format!("joint \"{}\" is there twice; rename one", other.name)));
        }
        if let Some(other) = model.joints.iter().find(|other| other.child == joint.child) {
            let (child, other, name) = (joint.child, other.name, joint.name);
            return Err(at(
                node,
                format!("link \"{child}\" is the child of two joints, \"{other}\" and \"{name}\"; leave one"),
            ));
        }
        model.joints.push(joint);
    }
    Ok(model)
}

fn joint<'a>(node: Node<'a, 'a>) -> Result<Joint<'a>, String> {
    let name = name(node)?;
    let of = format!("joint \"{name}\"");
    let end = |tag: &str| {
        let link = child(node, tag).and_then(|node| node.attribute("link"));
        link.ok_or_else(|| at(node, format!("{of} without <{tag} link>; add it")))
    };
    let type_name =
        node.attribute("type").ok_or_else(|| at(node, format!("{of} without a type; add one")))?;
    if !["revolute", "continuous", "fixed", "prismatic", "planar", "floating"].contains(&type_name) {
        let allowed = "revolute, continuous, fixed, prismatic, planar or floating";
        return Err(at(node, format!("{of}: type=\"{type_name}\"; allowed: {allowed}")));
    }
    Ok(Joint { name, type_name, parent: end("parent")?, child: end("child")?, node })
}

impl Joint<'_> {
    fn of(&self) -> String {
        format!("joint \"{}\"", self.name)
    }

    /// Kind of its motion.
    pub(super) fn kind(&self) -> Result<Kind, String> {
        Ok(match self.type_name {
            "fixed" => Kind::Fixed,
            "revolute" | "continuous" => Kind::Turning(axis(self.node, &self.of())?),
            "prismatic" => Kind::Sliding(axis(self.node, &self.of())?),
            _ => Kind::Other,
        })
    }

    /// The child's frame in the parent's at position 0.
    pub(super) fn origin(&self) -> Result<Origin, String> {
        origin(self.node, &self.of())
    }

    /// Returns true if it follows another joint.
    pub(super) fn mimics(&self) -> bool {
        child(self.node, "mimic").is_some()
    }

    /// Its limits, without those that are given. Zero is "not said".
    pub(super) fn limit(&self, given: &Given) -> Result<Limit, String> {
        let Some(node) = child(self.node, "limit") else { return Ok(Limit::default()) };
        let (of, (angle, speed, torque)) = (self.of(), MOST);
        let ranged = self.type_name == "revolute" && !given.range;
        let range_rad = if ranged { range(node, &of)? } else { None };
        let limit = |given: bool, attribute, unit, most, key| {
            if given { Ok(None) } else { positive(node, &of, (attribute, unit, most), key) }
        };
        Ok(Limit {
            range_rad: range_rad.map(|[low, high]| [low.max(-angle), high.min(angle)]),
            speed_rad_s: limit(given.speed, "velocity", "rad/s", speed, "arm.dq_max_rad_s")?,
            torque_nm: limit(given.torque, "effort", "N·m", torque, "arm.torque_max_nm")?,
        })
    }

    /// Position at which a joint beside the chain is held, m or rad: 0, or the end of its range nearest to 0.
    fn position(&self, model: &Model<'_>, depth: usize) -> Result<f64, String> {
        let of = self.of();
        let value = |node, attribute| Ok::<_, String>(number(node, &of, attribute)?.unwrap_or(0.0));
        if let Some(mimic) = child(self.node, "mimic").filter(|_| depth < MIMICS_MAX) {
            let master = mimic.attribute("joint").unwrap_or_default();
            let master = model.joints.iter().find(|joint| joint.name == master);
            let position = master.map_or(Ok(0.0), |master| master.position(model, depth + 1))?;
            let multiplier = number(mimic, &of, "multiplier")?.unwrap_or(1.0);
            return Ok(multiplier * position + value(mimic, "offset")?);
        }
        match child(self.node, "limit").filter(|_| self.type_name != "continuous") {
            Some(limit) => Ok(0.0_f64.min(value(limit, "upper")?).max(value(limit, "lower")?)),
            None => Ok(0.0),
        }
    }

    /// The child's frame in the parent's where it is held.
    pub(super) fn held(&self, model: &Model<'_>) -> Result<Origin, String> {
        let origin = self.origin()?;
        let along = |[x, y, z]: [f64; 3], way| [way * x, way * y, way * z, 0.0, 0.0, 0.0];
        Ok(match self.kind()? {
            Kind::Fixed | Kind::Other => origin,
            Kind::Turning(axis) => then(&origin, &turned_about(&axis, self.position(model, 0)?)),
            Kind::Sliding(axis) => then(&origin, &along(axis, self.position(model, 0)?)),
        })
    }
}

fn at(node: Node<'_, '_>, message: String) -> String {
    format!("line {}: {message}", node.document().text_pos_at(node.range().start).row)
}

fn name<'a>(node: Node<'a, '_>) -> Result<&'a str, String> {
    let name = node.attribute("name").filter(|name| !name.is_empty());
    name.ok_or_else(|| at(node, format!("a <{}> without a name; add one", node.tag_name().name())))
}

fn child<'a, 'd>(node: Node<'a, 'd>, tag: &str) -> Option<Node<'a, 'd>> {
    node.children().find(|child| child.has_tag_name(tag))
}

/// `count` finite numbers of an attribute; `None` where it is not there.
fn numbers<const N: usize>(
    node: Node<'_, '_>,
    of: &str,
    attribute: &str,
) -> Result<Option<[f64; N]>, String> {
    let Some(text) = node.attribute(attribute) else { return Ok(None) };
    let field = format!("{of}: <{} {attribute}=\"{text}\">", node.tag_name().name());
    let parsed: Result<Vec<f64>, _> = text.split_whitespace().map(str::parse).collect();
    let numbers: [f64; N] = parsed.ok().and_then(|list| list.try_into().ok()).ok_or_else(|| {
        let count = if N == 1 { "a number".into() } else { format!("{N} numbers") };
        at(node, format!("{field}; expected {count}"))
    })?;
    match numbers.iter().find(|number| !number.is_finite()) {
        Some(number) => Err(at(node, format!("{field}: {number} is not finite; write a number"))),
        None => Ok(Some(numbers)),
    }
}

fn number(node: Node<'_, '_>, of: &str, attribute: &str) -> Result<Option<f64>, String> {
    Ok(numbers(node, of, attribute)?.map(|[number]| number))
}

/// Numbers of an attribute, each between −`most` and `most`; zeros where it is not there.
fn within<const N: usize>(
    node: Node<'_, '_>,
    of: &str,
    (attribute, unit, most): (&str, &str, f64),
) -> Result<[f64; N], String> {
    let Some(numbers) = numbers::<N>(node, of, attribute)? else { return Ok([0.0; N]) };
    match numbers.iter().find(|number| number.abs() > most) {
        Some(number) => {
            let field = format!("{of}: <{} {attribute}>", node.tag_name().name());
            Err(at(node, format!("{field}: {number} {unit} is outside -{most} to {most} {unit}")))
        }
        None => Ok(numbers),
    }
}

/// A number above 0, at most `most`; `None` where it is 0 or not there.
fn positive(
    node: Node<'_, '_>,
    of: &str,
    (attribute, unit, most): (&str, &str, f64),
    key: &str,
) -> Result<Option<f64>, String> {
    let Some(number) = number(node, of, attribute).map_err(|why| format!("{why}, or set {key}"))? else {
        return Ok(None);
    };
    if number < 0.0 {
        let field = format!("{of}: <limit {attribute}=\"{number}\">");
        return Err(at(node, format!("{field} is not above 0 {unit}; correct it, or set {key}")));
    }
    Ok((number > 0.0).then_some(number.min(most)))
}

/// Least and greatest angle; `None` where both are 0 or not there.
fn range(node: Node<'_, '_>, of: &str) -> Result<Option<[f64; 2]>, String> {
    let keys = "set arm.q_min_rad and arm.q_max_rad";
    let end = |attribute| {
        let number = number(node, of, attribute).map_err(|why| format!("{why}, or {keys}"))?;
        Ok::<_, String>(number.unwrap_or(0.0))
    };
    let (low, high) = (end("lower")?, end("upper")?);
    if low == 0.0 && high == 0.0 {
        return Ok(None);
    }
    if low >= high {
        let field = format!("{of}: <limit lower={low} rad> is not below upper={high} rad");
        return Err(at(node, format!("{field}; correct it, or {keys}")));
    }
    Ok(Some([low, high]))
}

/// The `<origin>` below `node`, or none.
fn origin(node: Node<'_, '_>, of: &str) -> Result<Origin, String> {
    let Some(node) = child(node, "origin") else { return Ok(HERE) };
    let [x, y, z] = within(node, of, ("xyz", "m", 10.0))?;
    let [roll, pitch, yaw] = within(node, of, ("rpy", "rad", 10.0))?;
    Ok([x, y, z, roll, pitch, yaw])
}

/// Body of a link in the link's frame, without what is given; none where the file has no `<inertial>`.
///
/// # Errors
/// A number that is missing or makes no sense. A point mass has no inertia; an inertia without a mass is nothing that there is.
pub(super) fn inertial(link: Node<'_, '_>, name: &str, given: &Given) -> Result<LinkInertial, String> {
    let Some(node) = child(link, "inertial") else { return Ok(Payload::NONE.inertial) };
    let of = format!("link \"{name}\"");
    let mass_kg = match mass(node, &of) {
        // what is given replaces it; place and inertia of the part stay
        mass_kg if given.mass => mass_kg.unwrap_or_default().max(NEXT_TO_NO_MASS_KG),
        mass_kg => mass_kg?,
    };
    let mut inertia_com = [0.0; 6];
    if !given.inertia {
        let missing = |what: &str| {
            at(node, format!("{of}: <inertial> without <{what}>; add it, or set arm.inertia_com"))
        };
        let inertia = child(node, "inertia").ok_or_else(|| missing("inertia"))?;
        for (value, field) in inertia_com.iter_mut().zip(["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]) {
            if inertia.attribute(field).is_none() {
                return Err(missing(&format!("inertia {field}")));
            }
            [*value] = within(inertia, &of, (field, "kg·m²", 1000.0))?;
        }
        if mass_kg == 0.0 && inertia_com.iter().any(|value| *value != 0.0) {
            let message = format!("{of}: <mass value=\"0\"> with an <inertia> that is not 0");
            let remedy = "give it its mass, or take <inertial> out, or set arm.mass_kg and arm.inertia_com";
            return Err(at(node, format!("{message}; {remedy}")));
        }
    }
    let body = LinkInertial { mass_kg, com_m: [0.0; 3], inertia_com };
    if given.com && given.inertia {
        return Ok(body);
    }
    let [x, y, z, ..] = origin(node, &of)?;
    let mut turn = origin(node, &of)?;
    turn[..3].fill(0.0);
    Ok(LinkInertial { com_m: [x, y, z], ..placed(&body, &turn) })
}

/// Shape of a `<collision>`, m.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shape {
    /// Along z, its middle at the origin.
    Cylinder {
        radius_m: f64,
        length_m: f64,
    },
    Sphere {
        radius_m: f64,
    },
    Box {
        size_m: [f64; 3],
    },
    Mesh {
        file: String,
        scale: [f64; 3],
    },
}

/// Every `<collision>` shape of a link, with its frame in the link's.
///
/// # Errors
/// The first shape that is missing or has no size, with its line and what to do.
pub(super) fn shapes(link: Node<'_, '_>, name: &str) -> Result<Vec<(Origin, Shape)>, String> {
    let of = format!("link \"{name}\"");
    let collisions = link.children().filter(|node| node.has_tag_name("collision"));
    collisions.map(|node| Ok((origin(node, &of)?, shape(node, &of)?))).collect()
}

fn shape(collision: Node<'_, '_>, of: &str) -> Result<Shape, String> {
    let given = child(collision, "geometry").and_then(|node| node.children().find(Node::is_element));
    let missing = |node, what: &str| at(node, format!("{of}: <collision> without {what}; add it"));
    let node = given.ok_or_else(|| missing(collision, "a <geometry>"))?;
    let length = |attribute: &str| {
        let length_m = number(node, of, attribute)?.ok_or_else(|| missing(node, attribute))?;
        if length_m > 0.0 && length_m <= 10.0 {
            return Ok(length_m);
        }
        let field = format!("{of}: <{} {attribute}>", node.tag_name().name());
        Err(at(node, format!("{field}: {length_m} m is outside 0 to 10 m; correct it")))
    };
    match node.tag_name().name() {
        "cylinder" => Ok(Shape::Cylinder { radius_m: length("radius")?, length_m: length("length")? }),
        "sphere" => Ok(Shape::Sphere { radius_m: length("radius")? }),
        "box" => {
            if node.attribute("size").is_none() {
                return Err(missing(node, "size"));
            }
            Ok(Shape::Box { size_m: within::<3>(node, of, ("size", "m", 10.0))?.map(f64::abs) })
        }
        "mesh" => {
            let file = node.attribute("filename").ok_or_else(|| missing(node, "filename"))?.to_owned();
            Ok(Shape::Mesh { file, scale: numbers(node, of, "scale")?.unwrap_or([1.0; 3]) })
        }
        other => Err(at(
            node,
            format!("{of}: <{other}> is no shape that is read; write a cylinder, sphere, box or mesh"),
        )),
    }
}

fn mass(inertial: Node<'_, '_>, of: &str) -> Result<f64, String> {
    let remedy = "or set arm.mass_kg";
    let missing = || at(inertial, format!("{of}: <inertial> without <mass value>; add it, {remedy}"));
    let node = child(inertial, "mass").ok_or_else(missing)?;
    let mass_kg = number(node, of, "value").map_err(|why| format!("{why}, {remedy}"))?.ok_or_else(missing)?;
    if (0.0..=1000.0).contains(&mass_kg) {
        return Ok(mass_kg);
    }
    Err(at(node, format!("{of}: <mass value>: {mass_kg} kg is outside 0 to 1000 kg; correct it, {remedy}")))
}

/// Unit axis; x where the file names none.
fn axis(node: Node<'_, '_>, of: &str) -> Result<[f64; 3], String> {
    let Some(node) = child(node, "axis") else { return Ok([1.0, 0.0, 0.0]) };
    let [x, y, z] = numbers(node, of, "xyz")?.unwrap_or([1.0, 0.0, 0.0]);
    let length = x.hypot(y).hypot(z);
    if length < 1e-6 {
        return Err(at(node, format!("{of}: <axis> has no direction; correct its xyz")));
    }
    Ok([x, y, z].map(|component| component / length))
}
