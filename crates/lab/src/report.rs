//! `moca-lab report`: the paper and what it leaves out, on one self-contained HTML page.

use crate::chart::{Panel, Scale, Series};
use crate::drawing::Drawing;
use crate::experiment::settings::{Sensor, Settings};
use crate::experiment::{collision, figure, measure, paper};
use crate::{characterize, parallel, stability};
use anyhow::{Context, Result};
use moca_msgs::Law;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Arguments of `moca-lab report`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Folder for report.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// What the paper does not print and was chosen so that its text is reproduced.
const TUNED: &str = "The paper gives no gains. Virtual mass (4, 4, 2), virtual damping (80, 80, 60), flange stiffness 800 N/m \
    and 40 N·m/rad, damping ratio 0.9, η_B/η_A = 3 and the posture gains were tuned in simulation until the text was \
    reproduced, and the collision sits on the stability boundary: other taxels give larger forces with the same gains. \
    Base, arm mount, taxel positions, foams' viscosity, person and collision foam are assumed; each is named so in the code. \
    Nothing here was measured on a robot or on a physical board.";

/// One claim with our figure.
struct Claim {
    what: &'static str,
    bound: &'static str,
    ours: String,
    holds: bool,
}

/// A parameter against which the collision's peak force is shown.
struct Axis {
    key: &'static str,
    label: &'static str,
    scale: Scale,
    values: &'static [f64],
}

const AXES: [Axis; 8] = [
    Axis {
        key: "speed",
        label: "flange speed [m/s]",
        scale: Scale::Linear,
        values: &[0.05, 0.1, 0.15, 0.2, 0.25],
    },
    Axis {
        key: "person.mass",
        label: "person [kg]",
        scale: Scale::Log,
        values: &[5.0, 20.0, 75.0, 150.0, 300.0],
    },
    Axis {
        key: "foam.scale",
        label: "foam stiffness",
        scale: Scale::Log,
        values: &[0.25, 0.5, 1.0, 2.0, 4.0],
    },
    Axis {
        key: "m_v",
        label: "virtual mass [kg]",
        scale: Scale::Log,
        values: &[0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
    },
    Axis {
        key: "d_v",
        label: "virtual damping [N.s/m]",
        scale: Scale::Log,
        values: &[20.0, 40.0, 80.0, 160.0, 320.0],
    },
    Axis {
        key: "sensor.period_ms",
        label: "sensor period [ms]",
        scale: Scale::Log,
        values: &[1.0, 5.0, 10.0, 20.0, 33.0, 50.0],
    },
    Axis {
        key: "sensor.delay_ms",
        label: "sensor delay [ms]",
        scale: Scale::Linear,
        values: &[0.0, 10.0, 20.0, 40.0],
    },
    Axis { key: "person.taxel", label: "taxel", scale: Scale::Linear, values: &[1.0, 2.0, 3.0, 4.0] },
];

/// Runs everything and writes the page.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let page = page()?;
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot create {}", arguments.out.display()))?;
    let path = arguments.out.join("report.html");
    std::fs::write(&path, page).with_context(|| format!("cannot write {}", path.display()))?;
    println!("{}", path.display());
    Ok(())
}

fn page() -> Result<String> {
    let mut body = String::new();
    say("Tables I and II, Figure 4");
    let (tables, figure_4) = characterize::tables_and_figure_4(10, 1)?;
    section(&mut body, "Tables I and II, Figure 4: the taxel", &tables, &figure_4);

    let sensors = [Sensor::Ideal, Sensor::Stock];
    say("Figure 5");
    let b1 = parallel::run("B1", &sensors, |s| paper::b1(&with(Law::Impedance, *s)), |_| ());
    say("Figure 6");
    let b2 = parallel::run("B2", &sensors, |s| paper::b2(&with(Law::FollowMe, *s)), |_| ());
    say("Figure 7");
    let sensors = [Sensor::Ideal, Sensor::Stock, Sensor::Off];
    let c = parallel::run("collision", &sensors, |s| collision::run(&collision_with(*s)), |_| ());
    let b1 = b1.into_iter().collect::<Result<Vec<_>>>()?;
    let b2 = b2.into_iter().collect::<Result<Vec<_>>>()?;
    let c = c.into_iter().collect::<Result<Vec<_>>>()?;
    let texts = |runs: &[paper::Run]| runs.iter().map(|run| run.report.text()).collect::<Vec<_>>().join("\n");
    for (title, runs, panels) in [
        (
            "Figure 5: expanded impedance (ideal sensor drawn, stock board beside it as text)",
            &b1,
            paper::panels_b1 as fn(&[_]) -> _,
        ),
        (
            "Figure 6: expanded follow-me (ideal sensor drawn, stock board beside it as text)",
            &b2,
            paper::panels_b2 as fn(&[_]) -> _,
        ),
    ] {
        let drawing = figure::draw(&runs[0].rows, &runs[0].moments, panels(&runs[0].rows));
        section(&mut body, title, &texts(runs), &drawing.svg());
    }
    let drawing = figure::draw(&c[0].rows, &c[0].moments, collision::panels(&c[0].rows));
    let text = c.iter().map(|run| run.report.text()).collect::<Vec<_>>().join("\n");
    section(
        &mut body,
        "Figure 7: a person in the way (ideal sensor drawn; stock board and no cover as text)",
        &text,
        &drawing.svg(),
    );
    say("collision against eight parameters");
    section(
        &mut body,
        "What the paper does not show: the collision's peak force",
        "Blue: ideal sensor, 100 Hz. Orange: stock board; above 25 N it is UNSAFE. The person stays for the whole run.",
        &sweeps()?.svg(),
    );
    say("stability map");
    section(
        &mut body,
        "Stability: sensor period against virtual damping",
        "Each cell is a collision with a person who stays. The line is the least damping of the contact stability law \
         (virtual mass, lever arm of T1, base servo, foam and tissue at 20 N).",
        &stability::map_figure()?.svg(),
    );
    let mut head = String::new();
    claims_table(&mut head, &claims(&b1[0], &b2[0], &c));
    Ok(format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>MOCA-S in simulation</title><style>\
         body{{font:15px/1.45 sans-serif;max-width:980px;margin:2em auto;padding:0 1em}}pre{{background:#f4f4f4;padding:.8em;\
         overflow-x:auto;font-size:12px}}table{{border-collapse:collapse}}td,th{{border:1px solid #ccc;padding:.3em .6em;\
         text-align:left}}svg{{max-width:100%;height:auto}}.no{{color:#b00;font-weight:bold}}</style></head><body>\
         <h1>MOCA-S in simulation</h1><p>{TUNED}</p>{head}{body}</body></html>\n"
    ))
}

/// Progress on the terminal.
fn say(what: &str) {
    eprintln!("{what}");
}

fn with(law: Law, sensor: Sensor) -> Settings {
    Settings { sensor, ..Settings::paper(law) }
}

fn collision_with(sensor: Sensor) -> Settings {
    let mut settings = with(Law::Impedance, sensor);
    collision::defaults(&mut settings);
    settings
}

fn section(out: &mut String, title: &str, text: &str, svg: &str) {
    // Writing to a string cannot fail.
    let _ = write!(out, "<h2>{}</h2><pre>{}</pre>{svg}", escaped(title), escaped(text));
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn claims(b1: &paper::Run, b2: &paper::Run, c: &[collision::Run]) -> Vec<Claim> {
    let [lift, t1, t6, corners, ..] = &b1.report.pushes[..] else { return Vec::new() };
    let [.., opposite] = &b2.report.pushes[..] else { return Vec::new() };
    let [ideal, stock, off] = c else { return Vec::new() };
    let mut claims = Vec::new();
    let mut claim = |what, bound, ours: String, holds| claims.push(Claim { what, bound, ours, holds });
    let z_mm = 1e3 * lift.flange_displacement[2];
    claim(
        "B1-i flange lifted with 15 N",
        "18.75 ± 0.3 mm",
        format!("{z_mm:.2} mm"),
        (z_mm - 18.75).abs() < 0.3,
    );
    let [_, y, yaw] = t1.base_displacement;
    claim(
        "B1-ii T1 moves the base sideways and turns it",
        "y < −0.2 m, yaw > 0.2 rad, flange < 10 mm",
        format!("{y:.3} m, {yaw:.3} rad, {:.1} mm", t1.flange_max_mm),
        y < -0.2 && yaw > 0.2 && t1.flange_max_mm < 10.0,
    );
    claim(
        "B1-iii T6 does not turn it",
        "|yaw| < 2 mrad, flange < 15 mm",
        format!("{:.2} mrad, {:.1} mm", 1e3 * t6.base_displacement[2], t6.flange_max_mm),
        t6.base_displacement[2].abs() < 2e-3 && t6.flange_max_mm < 15.0,
    );
    claim(
        "B1-iv T4 + T8 are pure yaw",
        "yaw < −0.25 rad",
        format!("{:.3} rad", corners.base_displacement[2]),
        corners.base_displacement[2] < -0.25,
    );
    let way_mm = 1e3 * opposite.base_displacement[0].hypot(opposite.base_displacement[1]);
    claim("B2-iv opposite hands on one line cancel", "< 5 mm", format!("{way_mm:.1} mm"), way_mm < 5.0);
    if let Some([a, b, both]) = b2.report.superposition_m_s {
        claim(
            "B2-iii hands the same way add up",
            "within 1 %",
            format!("{a:.4} + {b:.4} = {both:.4} m/s"),
            ((a + b) / both - 1.0).abs() < 0.01,
        );
    }
    let peak = ideal.report.measures.peak_force_n;
    claim("C peak force, 100 Hz sensor", "< 25 N", format!("{peak:.1} N"), peak < 25.0);
    claim(
        "C without the cover",
        "more than 4 times",
        format!("{:.1} N", off.report.measures.peak_force_n),
        off.report.measures.peak_force_n > 4.0 * peak,
    );
    claim(
        "C with a stock Touch Board",
        "< 25 N (a stock board is outside the contact stability law)",
        format!("{:.1} N", stock.report.measures.peak_force_n),
        stock.report.measures.peak_force_n < 25.0,
    );
    claims
}

fn claims_table(out: &mut String, claims: &[Claim]) {
    out.push_str("<h2>What matches and what does not</h2><table><tr><th>claim</th><th>bound</th><th>here</th><th></th></tr>");
    for Claim { what, bound, ours, holds } in claims {
        let verdict = if *holds { "holds" } else { "<span class=\"no\">does not hold</span>" };
        // Writing to a string cannot fail.
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{verdict}</td></tr>",
            escaped(what),
            escaped(bound),
            escaped(ours)
        );
    }
    out.push_str("</table>");
}

/// Peak force against each axis, both sensors.
fn sweeps() -> Result<Drawing> {
    let mut inputs = Vec::new();
    for (panel, axis) in AXES.iter().enumerate() {
        for sensor in [Sensor::Ideal, Sensor::Stock] {
            if sensor == Sensor::Stock && axis.key.starts_with("sensor.") {
                continue;
            }
            for value in axis.values {
                let mut settings = collision_with(sensor);
                for assignment in [
                    "person.gap=0.1",
                    "duration=4",
                    "person.steps_away_s=100",
                    &format!("{}={value}", axis.key),
                ] {
                    settings.set(assignment)?;
                }
                inputs.push((panel, sensor, *value, settings));
            }
        }
    }
    let peaks = parallel::run(
        "collisions",
        &inputs,
        |(.., settings)| collision::once(settings).map(|rig| measure::peak_force_n(&rig.rows)),
        |_| (),
    );
    let mut series = vec![[Vec::new(), Vec::new()]; AXES.len()];
    for ((panel, sensor, value, _), peak) in inputs.iter().zip(peaks) {
        series[*panel][usize::from(*sensor == Sensor::Stock)].push([*value, peak?]);
    }
    let height = 190.0;
    let mut drawing = Drawing::new(900.0, height * 8.0 + 20.0);
    let mut top = 10.0;
    for (axis, [ideal, stock]) in AXES.iter().zip(series) {
        let mut lines = vec![Series::dots(0, "ideal, 100 Hz", ideal)];
        if !stock.is_empty() {
            lines.push(Series::dots(1, "stock: UNSAFE", stock));
        }
        Panel {
            x_scale: axis.scale,
            y_scale: Scale::Log,
            series: lines,
            levels: vec![(25.0, "25 N")],
            ..Panel::new(axis.label, axis.label, "peak force [N]")
        }
        .draw(&mut drawing, [0.0, top], [900.0, height]);
        top += height;
    }
    Ok(drawing)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_that_does_not_hold_is_shown_as_such() {
        let mut out = String::new();
        claims_table(&mut out, &[Claim { what: "a < b", bound: "< 1", ours: "2".into(), holds: false }]);
        assert!(out.contains("a &lt; b") && out.contains("does not hold"), "{out}");
    }

    #[test]
    fn every_axis_names_keys_and_values_that_exist() {
        for axis in &AXES {
            for value in axis.values {
                collision_with(Sensor::Ideal).set(&format!("{}={value}", axis.key)).unwrap();
            }
        }
    }
}
