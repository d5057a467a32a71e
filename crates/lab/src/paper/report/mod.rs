//! `moca-lab report`: the paper and what it leaves out, on one self-contained HTML page.

pub(crate) mod claims;
pub(crate) mod errors;
mod sweeps;

use crate::cover::characterize;
use crate::numerics::stability;
use crate::paper::figure::Layout;
use crate::paper::{collision_figure, pushes};
use crate::picture::Width;
use anyhow::{Context, Result};
use moca_experiments::collision;
use moca_experiments::free_scene;
use moca_experiments::parallel;
use moca_experiments::settings::{Sensor, Settings};
use moca_figures::Drawing;
use moca_msgs::Law;
use std::fmt::Write as _;
use std::path::PathBuf;

/// One self-contained HTML page: tables, figures, what matches the paper and what does not.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Folder for report.html.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Values that the paper does not print, chosen so that its text is reproduced.
const TUNED: &str = "The paper gives no gains. Virtual mass (4, 4, 2), virtual damping (80, 80, 60), flange stiffness 800 N/m \
    and 40 N·m/rad, damping ratio 0.9, η_B/η_A = 3 and the posture gains were tuned in simulation until the text was \
    reproduced, and the collision sits on the stability boundary: other taxels give larger forces with the same gains. \
    Base, arm mount, taxel positions, foams' viscosity, person and collision foam are assumed; each is named so in the code. \
    Nothing here was measured on a robot or on a physical board.";

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
    let (tables, figure_4) = characterize::tables_and_figure_4(10, 1)?;
    section(&mut body, "Tables I and II, Figure 4: the taxel", &tables, &figure_4);

    let sensors = [Sensor::Ideal, Sensor::Stock];
    let b1 = parallel::run("report, Figure 5", &sensors, |s| pushes::b1(&with(Law::Impedance, *s)))?;
    let b2 = parallel::run("report, Figure 6", &sensors, |s| pushes::b2(&with(Law::FollowMe, *s)))?;
    let sensors = [Sensor::Ideal, Sensor::Stock, Sensor::Off];
    let c = parallel::run("report, Figure 7", &sensors, |s| collision::run(&collision_with(*s)))?;
    let under_barrier = collision::run(&collision_under_barrier()?)?;
    let texts =
        |runs: &[pushes::Run]| runs.iter().map(|run| run.report.text()).collect::<Vec<_>>().join("\n");
    for (title, law, runs, draw) in [
        (
            "Figure 5: expanded impedance (ideal sensor drawn, stock board beside it as text)",
            Law::Impedance,
            &b1,
            pushes::figure_5 as fn(&Settings, &pushes::Run, &Layout) -> Result<Drawing>,
        ),
        (
            "Figure 6: expanded follow-me (ideal sensor drawn, stock board beside it as text)",
            Law::FollowMe,
            &b2,
            pushes::figure_6 as fn(&Settings, &pushes::Run, &Layout) -> Result<Drawing>,
        ),
    ] {
        let drawing = draw(&with(law, Sensor::Ideal), &runs[0], &Layout::default())?;
        section(&mut body, title, &texts(runs), &drawing.svg());
    }
    for (title, run) in [
        ("Figure 7: a person in the way, ideal sensor at 100 Hz", &c[0]),
        ("The same collision with a stock Touch Board", &c[1]),
        ("The same collision without a cover", &c[2]),
        ("The same collision with the contact barrier and its speed limit, ideal sensor", &under_barrier),
    ] {
        let (moments, scene) = (collision_figure::moments(&run.rows), free_scene());
        let drawing = collision_figure::figure(run, &moments, &scene).draw(&Layout::default())?;
        let title = format!("{title}: {}", run.report.verdict);
        section(&mut body, &title, &run.report.text(), &drawing.svg());
    }
    section(
        &mut body,
        "What the paper does not show: the collision's peak force",
        "Each dot is the worst of five collisions, one a phase of the sensor, with a person who stays; the band goes down to the least, a \
         cross is where the robot stops. The red line is 25 N: what lies above is UNSAFE. A grey vertical \
         line is where the contact stability law (virtual mass and damping at the taxel, delay and period of the ideal \
         sensor, base servo, foam and tissue at 20 N) changes its verdict for the ideal sensor; it knows no speed.",
        &sweeps::draw()?.svg(),
    );
    section(
        &mut body,
        "Stability: simulation and theory",
        "Each cell is a collision with a person who stays. The line is the boundary of the same law.",
        &stability::maps::draw(&stability::maps::all()?, Width::Screen).svg(),
    );
    let mut head = String::new();
    claims::table(&mut head, &claims::all(&b1[0], &b2[0], &c)?);
    Ok(format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>MOCA-S in simulation</title><style>\
         body{{font:15px/1.45 sans-serif;max-width:980px;margin:2em auto;padding:0 1em}}pre{{background:#f4f4f4;padding:.8em;\
         overflow-x:auto;font-size:12px}}table{{border-collapse:collapse}}td,th{{border:1px solid #ccc;padding:.3em .6em;\
         text-align:left}}svg{{max-width:100%;height:auto}}.no{{color:#b00;font-weight:bold}}</style></head><body>\
         <h1>MOCA-S in simulation</h1><p>{TUNED}</p>{head}{body}</body></html>\n"
    ))
}

pub(crate) fn with(law: Law, sensor: Sensor) -> Settings {
    Settings { sensor, ..Settings::paper(law) }
}

pub(crate) fn collision_with(sensor: Sensor) -> Settings {
    let mut settings = with(Law::Impedance, sensor);
    collision::defaults(&mut settings);
    settings
}

/// The paper's collision as a calibrated cover has it: contact barrier, the speed limit that goes with it, and both
/// corrections.
pub(crate) fn collision_under_barrier() -> Result<Settings> {
    let mut settings = collision_with(Sensor::Ideal);
    settings.set("law=barrier")?;
    Ok(settings)
}

fn section(out: &mut String, title: &str, text: &str, svg: &str) {
    // Writing to a string cannot fail.
    let _ = write!(out, "<h2>{}</h2><pre>{}</pre>{svg}", escaped(title), escaped(text));
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}
