//! The chain of joints between two links of a URDF as an arm.

use super::document::{Joint, Kind, Model, inertial, model};
use super::frames::{HERE, Origin, inverse, placed, then, z_to};
use super::text;
use moca_msgs::robot::{LinkInertial, Payload};

pub use super::document::{Given, Limit};

/// An arm as a URDF describes it, joints about z.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfArm {
    /// The robot's name in its file.
    pub name: String,
    /// Link that stands on the base, in the base link's frame.
    pub link0: LinkInertial,
    /// From base to tip.
    pub joints: Vec<UrdfJoint>,
    /// The tip's frame in the last link.
    pub flange_origin: [f64; 6],
    /// Links of the file that it is made of.
    pub parts: Vec<Part>,
}

/// A link of the file, and where it is in the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Its name.
    pub link: String,
    /// Link of the arm that it belongs to; 0 is the one that stands on the base.
    pub body: usize,
    /// Its frame in that link: x, y, z m; roll, pitch, yaw rad.
    pub at: [f64; 6],
}

/// One joint, and the link that it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfJoint {
    /// Its name in the file.
    pub name: String,
    /// Name of the link that it moves.
    pub moves: String,
    /// Its frame in the link before: x, y, z m; roll, pitch, yaw rad.
    pub origin: [f64; 6],
    /// Link that it moves, in its own frame.
    pub link: LinkInertial,
    /// Limits of the joint.
    pub limit: Limit,
    /// True for a joint without a range.
    pub continuous: bool,
}

/// The arm between `base` and `tip`; either may be empty where the file leaves no choice: the link that no joint moves, the
/// only link at the end of a chain. What is `given` is not read, and not judged.
///
/// # Errors
/// The first mistake, with its line where it has one, the link or joint, the field, and what to do.
pub fn read(text: &str, base: &str, tip: &str, given: &Given) -> Result<UrdfArm, String> {
    let text = text::prepared(text)?;
    let document = text::parse(&text)?;
    let model = model(&document)?;
    let base =
        if base.is_empty() { only("base_link", &roots(&model))? } else { known(&model, "base_link", base)? };
    let tip = if tip.is_empty() { only("tip_link", &ends(&model))? } else { known(&model, "tip_link", tip)? };
    let chain = chain(&model, base, tip)?;
    let mut arm = UrdfArm {
        name: model.name.into(),
        link0: Payload::NONE.inertial,
        joints: Vec::new(),
        flange_origin: HERE,
        parts: Vec::new(),
    };
    // where the link is in the frame of the body that it is part of
    let mut at = HERE;
    let all = Weighed { model: &model, chain: &chain, given };
    all.weigh(base, &at, &mut arm.link0)?;
    all.place(base, &at, 0, &mut arm.parts)?;
    for joint in &chain {
        at = then(&at, &joint.origin()?);
        match joint.kind()? {
            Kind::Fixed => {}
            Kind::Turning(axis) if !joint.mimics() => {
                let turn = z_to(&axis);
                arm.joints.push(UrdfJoint {
                    name: joint.name.into(),
                    moves: joint.child.into(),
                    origin: then(&at, &turn),
                    link: Payload::NONE.inertial,
                    limit: joint.limit(given)?,
                    continuous: joint.type_name == "continuous",
                });
                at = inverse(&turn);
            }
            Kind::Turning(_) => return Err(not_an_arm(joint, "mimics another")),
            Kind::Sliding(_) | Kind::Other => {
                return Err(not_an_arm(joint, &format!("is {}", joint.type_name)));
            }
        }
        let body = arm.joints.last_mut().map_or(&mut arm.link0, |joint| &mut joint.link);
        all.weigh(joint.child, &at, body)?;
        all.place(joint.child, &at, arm.joints.len(), &mut arm.parts)?;
    }
    arm.flange_origin = at;
    Ok(arm)
}

fn not_an_arm(joint: &Joint<'_>, how: &str) -> String {
    format!(
        "joint \"{}\" {how}; an arm here has revolute, continuous and fixed joints: name another arm.base_link or \
         arm.tip_link, or make it fixed",
        joint.name
    )
}

fn known<'a>(model: &Model<'a>, key: &str, link: &str) -> Result<&'a str, String> {
    let found = model.links.keys().find(|name| **name == link);
    found.copied().ok_or_else(|| {
        let names: Vec<&str> = model.links.keys().copied().collect();
        format!("arm.{key} = \"{link}\" is no link of it; it has {}", names.join(", "))
    })
}

fn only<'a>(key: &str, candidates: &[&'a str]) -> Result<&'a str, String> {
    match candidates {
        [one] => Ok(one),
        many => Err(format!("arm.{key} has to name one of {}", many.join(", "))),
    }
}

fn roots<'a>(model: &Model<'a>) -> Vec<&'a str> {
    let moved = |link: &str| model.joints.iter().any(|joint| joint.child == link);
    model.links.keys().copied().filter(|link| !moved(link)).collect()
}

fn ends<'a>(model: &Model<'a>) -> Vec<&'a str> {
    let carries = |link: &str| model.joints.iter().any(|joint| joint.parent == link);
    model.links.keys().copied().filter(|link| !carries(link)).collect()
}

/// From base to tip.
fn chain<'m, 'a>(model: &'m Model<'a>, base: &str, tip: &str) -> Result<Vec<&'m Joint<'a>>, String> {
    let (mut chain, mut link) = (Vec::new(), tip);
    while link != base {
        let Some(joint) = model.joints.iter().find(|joint| joint.child == link) else {
            return Err(format!(
                "no chain of joints leads from link \"{base}\" to \"{tip}\", it ends at \"{link}\": name another \
                 arm.base_link or arm.tip_link"
            ));
        };
        if chain.len() >= model.joints.len() {
            return Err(format!(
                "the joints above link \"{tip}\" go in a circle through joint \"{}\"; take it out",
                joint.name
            ));
        }
        chain.push(joint);
        link = joint.parent;
    }
    let (mut above, mut steps) = (base, 0);
    while let Some(joint) = model.joints.iter().find(|joint| joint.child == above) {
        (above, steps) = (joint.parent, steps + 1);
        if above == base || steps > model.joints.len() {
            return Err(format!(
                "the joints above link \"{base}\" go in a circle through joint \"{}\"; take it out",
                joint.name
            ));
        }
    }
    chain.reverse();
    if chain.iter().all(|joint| joint.type_name == "fixed") {
        return Err(format!(
            "between link \"{base}\" and \"{tip}\" nothing turns: name another arm.base_link or arm.tip_link"
        ));
    }
    Ok(chain)
}

/// Links to be weighed with those of a chain.
struct Weighed<'a> {
    model: &'a Model<'a>,
    chain: &'a [&'a Joint<'a>],
    given: &'a Given,
}

impl Weighed<'_> {
    /// Adds to `body` the link at `at` and everything that hangs on it beside the chain.
    fn weigh(&self, link: &str, at: &Origin, body: &mut LinkInertial) -> Result<(), String> {
        if let Some(node) = self.model.links.get(link) {
            *body = body.with(&placed(&inertial(*node, link, self.given)?, at));
        }
        for joint in self.beside(link) {
            self.weigh(joint.child, &then(at, &joint.held(self.model)?), body)?;
        }
        Ok(())
    }

    /// Notes where the link at `at` and everything that hangs on it beside the chain is, in the link `body` of the arm.
    fn place(&self, link: &str, at: &Origin, body: usize, parts: &mut Vec<Part>) -> Result<(), String> {
        parts.push(Part { link: link.into(), body, at: *at });
        for joint in self.beside(link) {
            self.place(joint.child, &then(at, &joint.held(self.model)?), body, parts)?;
        }
        Ok(())
    }

    /// Joints that hang on a link beside the chain.
    fn beside(&self, link: &str) -> impl Iterator<Item = &Joint<'_>> {
        let in_chain = |joint: &Joint<'_>| self.chain.iter().any(|one| one.name == joint.name);
        self.model.joints.iter().filter(move |joint| joint.parent == link && !in_chain(joint))
    }
}
