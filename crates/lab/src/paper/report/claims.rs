//! Claims of the paper and of an independent simulation, next to our results.

use super::{collision_under_barrier, collision_with, with};
use crate::paper::push::{self, Outcome, Push};
use crate::paper::pushes;
use anyhow::Result;
use moca_experiments::closed_loop::Rig;
use moca_experiments::collision;
use moca_experiments::parallel;
use moca_experiments::settings::{Sensor, Settings};
use moca_msgs::Law;
use std::fmt::Write as _;

/// One claim with our figure.
pub(super) struct Claim {
    what: String,
    bound: String,
    ours: String,
    holds: bool,
}

fn claim(what: &str, bound: &str, ours: String, holds: bool) -> Claim {
    Claim { what: what.into(), bound: bound.into(), ours, holds }
}

/// Every claim as a table in Markdown.
pub(crate) fn markdown() -> Result<String> {
    let b1 = pushes::b1(&with(Law::Impedance, Sensor::Ideal))?;
    let b2 = pushes::b2(&with(Law::FollowMe, Sensor::Ideal))?;
    let sensors = [Sensor::Ideal, Sensor::Stock, Sensor::Off];
    let c = parallel::run("collision", &sensors, |s| collision::run(&collision_with(*s)))?;
    let mut out = String::from("| claim | bound | here | |\n|---|---|---|---|\n");
    for Claim { what, bound, ours, holds } in all(&b1, &b2, &c)? {
        let verdict = if holds { "holds" } else { "**does not hold**" };
        // Writing to a string cannot fail.
        let _ = writeln!(out, "| {what} | {} | {ours} | {verdict} |", bound.replace('|', "\\|"));
    }
    Ok(out)
}

/// Experiments B1, B2 and C, the three corrections, and a person who walks in.
pub(super) fn all(b1: &pushes::Run, b2: &pushes::Run, c: &[collision::Run]) -> Result<Vec<Claim>> {
    let mut claims = pushes_b1(b1);
    claims.extend(corrections()?);
    claims.extend(pushes_b2(b2));
    let observed = Settings { flange_observed: true, ..with(Law::FollowMe, Sensor::Ideal) };
    let observed = pushes_b2(&pushes::b2(&observed)?).into_iter();
    claims.extend(observed.map(|claim| Claim { what: format!("{}, observed", claim.what), ..claim }));
    claims.extend(collisions(c)?);
    Ok(claims)
}

fn pushes_b1(b1: &pushes::Run) -> Vec<Claim> {
    let [lift, _, _, left, right] = &b1.report.pushes[..] else { return Vec::new() };
    let z_mm = 1e3 * lift.flange_displacement[2];
    let [_, _, left_yaw] = left.base_displacement;
    let [fx, fy, _] = left.wrench_true;
    vec![
        claim(
            "B1-i flange lifted with 15 N",
            "18.75 ± 0.3 mm",
            format!("{z_mm:.2} mm"),
            (z_mm - 18.75).abs() < 0.3,
        ),
        claim(
            "B1-iv T4 + T8 are pure yaw",
            "net force < 1e-9 N, yaw < −0.25 rad",
            format!("{:.0e} N, {left_yaw:.3} rad", fx.hypot(fy)),
            fx.hypot(fy) < 1e-9 && left_yaw < -0.25,
        ),
        claim(
            "B1-iv T1 + T11 turn it the other way",
            "yaw > 0.25 rad",
            format!("{:.3} rad", right.base_displacement[2]),
            right.base_displacement[2] > 0.25,
        ),
    ]
}

/// One push from the home posture, ideal sensor.
fn single(push: &Push, assignments: &[&str]) -> Result<Option<Outcome>> {
    let mut settings = with(Law::Impedance, Sensor::Ideal);
    settings.set_all(assignments)?;
    let mut rig = Rig::start(&settings, &settings.free_scene())?;
    Ok(push::run(&mut rig, &settings, std::slice::from_ref(push))?.pop())
}

/// B1-ii to B1-iv with the literal law and with its corrections.
fn corrections() -> Result<Vec<Claim>> {
    let laws: [(&str, &[&str]); 3] = [
        ("literal", &[]),
        ("null-space damping", &["null_space_damping=true"]),
        ("null-space damping and coupling", &["null_space_damping=true", "base_coupling=true"]),
    ];
    let mut claims = Vec::new();
    for ((law, assignments), [t1_mm, t6_mm]) in laws.into_iter().zip([[10.0, 15.0], [2.5, 3.0], [1.0, 1.0]]) {
        if let Some(t1) = single(&push::single(&[0], 20.0), assignments)? {
            let [x, y, yaw] = t1.base_displacement;
            claims.push(claim(
                &format!("B1-ii T1 20 N, {law}"),
                &format!("y < −0.2 m, yaw > 0.2 rad, flange < {t1_mm} mm"),
                format!("({x:.3} m, {y:.3} m, {yaw:.3} rad), {:.2} mm", t1.flange_max_mm),
                y < -0.2 && yaw > 0.2 && t1.flange_max_mm < t1_mm,
            ));
        }
        if let Some(t6) = single(&push::single(&[5], 20.0), assignments)? {
            let [x, y, yaw] = t6.base_displacement;
            claims.push(claim(
                &format!("B1-iii T6 20 N, {law}"),
                &format!("pure x: |y| < 2 mm, |yaw| < 2 mrad, flange < {t6_mm} mm"),
                format!("{x:.3} m, {:.3} mm, {:.3} mrad, {:.2} mm", 1e3 * y, 1e3 * yaw, t6.flange_max_mm),
                x < 0.0 && y.abs() < 2e-3 && yaw.abs() < 2e-3 && t6.flange_max_mm < t6_mm,
            ));
        }
    }
    let sideways = Push::taxels("flange +y 15 N", &[]).and_flange([0.0, 15.0, 0.0]);
    for (law, assignments, wanted_mm) in [
        ("literal", &[][..], [6.0, 11.0]),
        ("feedforward", &["flange_wrench_feedforward=true"][..], [16.5, 20.0]),
    ] {
        if let Some(push) = single(&sideways, assignments)? {
            let (mm, y) = (1e3 * push.flange_displacement[1], push.base_displacement[1]);
            let [low, high] = wanted_mm;
            let follows = if law == "literal" { y < 0.0 } else { y > 0.0 };
            claims.push(claim(
                &format!("flange +y 15 N, {law}"),
                &format!(
                    "flange off by {low} to {high} mm; base {}",
                    if law == "literal" { "drifts against it" } else { "follows" }
                ),
                format!("{:.2} mm at most, {mm:.2} mm from its start; base {y:+.3} m", push.flange_max_mm),
                (low..high).contains(&push.flange_max_mm) && follows,
            ));
        }
    }
    Ok(claims)
}

fn pushes_b2(b2: &pushes::Run) -> Vec<Claim> {
    let [led, t1, pair, _, opposite] = &b2.report.pushes[..] else { return Vec::new() };
    let way_mm = 1e3 * opposite.base_displacement[0].hypot(opposite.base_displacement[1]);
    let mut claims = vec![
        claim(
            "B2-i the base follows a hand at the flange, the arm returns",
            "> 0.3 m, arm < 1 mrad",
            format!("{:.3} m, {:.3} mrad", led.base_displacement[0], 1e3 * led.arm_residual_rad),
            led.base_displacement[0] > 0.3 && led.arm_residual_rad < 1e-3,
        ),
        claim(
            "B2-ii T1 moves the base sideways and turns it",
            "y < −0.1 m, yaw > 0.05 rad",
            format!("{:.3} m, {:.3} rad", t1.base_displacement[1], t1.base_displacement[2]),
            t1.base_displacement[1] < -0.1 && t1.base_displacement[2] > 0.05,
        ),
        claim(
            "B2-ii T2 + T3 do not turn it",
            "|yaw| < 1 mrad",
            format!("{:.3} mrad", 1e3 * pair.base_displacement[2]),
            pair.base_displacement[2].abs() < 1e-3,
        ),
        claim("B2-iv opposite hands on one line cancel", "< 5 mm", format!("{way_mm:.1} mm"), way_mm < 5.0),
    ];
    if let Some([a, b, both]) = b2.report.superposition_m_s {
        claims.push(claim(
            "B2-iii hands the same way add up",
            "within 1 %",
            format!("{a:.4} + {b:.4} = {both:.4} m/s"),
            ((a + b) / both - 1.0).abs() < 0.01,
        ));
    }
    claims
}

fn collisions(c: &[collision::Run]) -> Result<Vec<Claim>> {
    let [ideal, stock, off] = c else { return Ok(Vec::new()) };
    let m = &ideal.report.measures;
    let peak = m.peak_force_n;
    let falling = m.peaks_n.len() >= 3 && m.peaks_n.windows(2).all(|pair| pair[0] > pair[1]);
    let stock_peak = stock.report.measures.peak_force_n;
    let mut damped = collision_with(Sensor::Ideal);
    damped.set("null_space_damping=true")?;
    let damped = collision::run(&damped)?.report.measures;
    let mut claims = vec![
        claim(
            "C peak force, 100 Hz sensor, worst of five phases",
            "< 25 N",
            format!("{peak:.1} N: {}", ideal.report.verdict),
            ideal.report.verdict == "below 25 N",
        ),
        claim(
            "C peaks fall, T1 only",
            "at least three, each below the one before",
            format!("{:.1?} N on {}", m.peaks_n, m.contact_taxels.join(", ")),
            falling && m.contact_taxels == ["T1"],
        ),
        claim(
            "C flange, literal",
            "RMS < 15 mm",
            format!("{:.1} mm, yaw {:+.1}° in contact", m.flange_rms_mm, m.yaw_in_contact_deg),
            m.flange_rms_mm < 15.0,
        ),
        claim(
            "C with null-space damping",
            "< 25 N, RMS < 2 mm",
            format!("{:.1} N, {:.2} mm", damped.peak_force_n, damped.flange_rms_mm),
            damped.peak_force_n < 25.0 && damped.flange_rms_mm < 2.0,
        ),
        claim(
            "C without the cover",
            "more than 4 times the force",
            format!("{:.1} N", off.report.measures.peak_force_n),
            off.report.measures.peak_force_n > 4.0 * peak,
        ),
        claim(
            "C with a stock Touch Board",
            "< 25 N (outside the contact stability law)",
            format!("{stock_peak:.1} N"),
            stock_peak < 25.0,
        ),
    ];
    let under_barrier = collision::run(&collision_under_barrier()?)?.report;
    claims.push(claim(
        "C with the contact barrier and its speed limit",
        "< 25 N, flange < 5 mm",
        format!(
            "{:.1} N, {:.1} mm",
            under_barrier.measures.peak_force_n, under_barrier.measures.flange_max_mm
        ),
        under_barrier.verdict == "below 25 N" && under_barrier.measures.flange_max_mm < 5.0,
    ));
    // The same gains elsewhere, and the case that the paper leaves out.
    for (what, assignments) in [
        ("C at T2, same gains", &["person.taxel=T2"][..]),
        ("C at T3, same gains", &["person.taxel=T3"][..]),
        ("C at T4, same gains", &["person.taxel=T4"][..]),
        ("a person walks into the standing robot at 0.2 m/s, T1", &["speed=0", "person.walk=0.2"][..]),
    ] {
        let mut settings = collision_with(Sensor::Ideal);
        settings.set_all(assignments)?;
        let peak = collision::run(&settings)?.report.measures.peak_force_n;
        claims.push(claim(what, "< 25 N", format!("{peak:.1} N"), peak < 25.0));
    }
    Ok(claims)
}

pub(super) fn table(out: &mut String, claims: &[Claim]) {
    out.push_str("<h2>What matches and what does not</h2><table><tr><th>claim</th><th>bound</th><th>here</th><th></th></tr>");
    for Claim { what, bound, ours, holds } in claims {
        let verdict = if *holds { "holds" } else { "<span class=\"no\">does not hold</span>" };
        let [what, bound, ours] = [what, bound, ours].map(|text| super::escaped(text));
        // Writing to a string cannot fail.
        let _ = write!(out, "<tr><td>{what}</td><td>{bound}</td><td>{ours}</td><td>{verdict}</td></tr>");
    }
    out.push_str("</table>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_that_does_not_hold_is_shown_as_such() {
        let mut out = String::new();
        table(&mut out, &[claim("a < b", "< 1", "2".into(), false)]);
        assert!(out.contains("a &lt; b") && out.contains("does not hold"), "{out}");
    }
}
