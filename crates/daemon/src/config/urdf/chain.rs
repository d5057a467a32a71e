//! The chain of joints between two links of a URDF as an arm.

use super::document::{Joint, Kind, Model, model};
use super::frames::{HERE, Origin, inverse, placed, then, z_to};
use crate::robot::together;
use moca_msgs::robot::{LinkInertial, Payload};

pub use super::document::Limit;

/// An arm as a URDF describes it, joints about z.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfArm {
    /// The robot's name in its file.
    pub name: String,
    /// What stands on the base, in the base link's frame.
    pub link0: LinkInertial,
    /// From base to tip.
    pub joints: Vec<UrdfJoint>,
    /// The tip's frame in the last link.
    pub flange_origin: [f64; 6],
}

/// One joint, and the link that it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfJoint {
    /// Its name in the file.
    pub name: String,
    /// Its frame in the link before: x, y, z m; roll, pitch, yaw rad.
    pub origin: [f64; 6],
    /// What it moves, in its own frame.
    pub link: LinkInertial,
    /// What it may do.
    pub limit: Limit,
}

/// The arm between `base` and `tip`; either may be empty where the file leaves no choice: the link that no joint moves, the
/// only link at the end of a chain.
///
/// # Errors
/// The first mistake, with its line where it has one, the link or joint, and the field.
pub fn read(text: &str, base: &str, tip: &str) -> Result<UrdfArm, String> {
    let document = roxmltree::Document::parse(text).map_err(|error| format!("no XML: {error}"))?;
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
    };
    // where the link is in the frame of the body that it is part of
    let mut at = HERE;
    weigh(&model, base, &chain, &at, &mut arm.link0)?;
    for joint in &chain {
        at = then(&at, &joint.origin);
        match joint.kind {
            Kind::Fixed => {}
            Kind::Turning(axis) if !joint.mimics => {
                let turn = z_to(&axis);
                arm.joints.push(UrdfJoint {
                    name: joint.name.into(),
                    origin: then(&at, &turn),
                    link: Payload::NONE.inertial,
                    limit: joint.limit,
                });
                at = inverse(&turn);
            }
            Kind::Turning(_) => return Err(not_an_arm(joint, "mimics another")),
            Kind::Other => return Err(not_an_arm(joint, &format!("is {}", joint.type_name))),
        }
        let body = arm.joints.last_mut().map_or(&mut arm.link0, |joint| &mut joint.link);
        weigh(&model, joint.child, &chain, &at, body)?;
    }
    if let Some(light) = arm.joints.iter().find(|joint| joint.link.mass_kg <= 0.0) {
        let moved = chain.iter().find(|joint| joint.name == light.name).map_or("", |joint| joint.child);
        return Err(format!(
            "link \"{moved}\" has no <inertial> with a mass, and joint \"{}\" moves it",
            light.name
        ));
    }
    arm.flange_origin = at;
    Ok(arm)
}

fn not_an_arm(joint: &Joint<'_>, how: &str) -> String {
    format!("joint \"{}\" {how}; an arm here has revolute, continuous and fixed joints", joint.name)
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
                "no chain of joints leads from link \"{base}\" to \"{tip}\": it ends at \"{link}\""
            ));
        };
        if chain.len() >= model.joints.len() {
            return Err(format!(
                "the joints above link \"{tip}\" go in a circle through joint \"{}\"",
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
                "the joints above link \"{base}\" go in a circle through joint \"{}\"",
                joint.name
            ));
        }
    }
    chain.reverse();
    if chain.iter().all(|joint| joint.kind == Kind::Fixed) {
        return Err(format!("between link \"{base}\" and \"{tip}\" nothing turns"));
    }
    Ok(chain)
}

/// Adds to `body` the link at `at` and everything that fixed joints fix to it beside the chain.
fn weigh(
    model: &Model<'_>,
    link: &str,
    chain: &[&Joint<'_>],
    at: &Origin,
    body: &mut LinkInertial,
) -> Result<(), String> {
    if let Some(inertial) = model.links.get(link).and_then(|link| link.inertial) {
        *body = together(body, &placed(&inertial, at));
    }
    let beside = |joint: &&Joint<'_>| joint.parent == link && !chain.iter().any(|one| one.name == joint.name);
    for joint in model.joints.iter().filter(beside) {
        if joint.kind != Kind::Fixed {
            return Err(format!(
                "joint \"{}\" moves link \"{}\" beside the chain; make it fixed, or take it out and say in [robot.tool] \
                 what the arm carries",
                joint.name, joint.child
            ));
        }
        weigh(model, joint.child, chain, &then(at, &joint.origin), body)?;
    }
    Ok(())
}
