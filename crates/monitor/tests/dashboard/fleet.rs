//! Several robots in one window.

use crate::bench::{Daemon, Fake, sample};
use egui_kittest::{Harness, kittest::Queryable};
use moca_monitor::{
    logic::fleet::Row,
    ui::{App, FleetWindow},
};
use moca_msgs::{BoardFault, Mode, Request};
use moca_telemetry::net::fleet::Glance;
use std::{cell::RefCell, rc::Rc};

/// A window for two robots and one that is away; each has a daemon of its own.
struct Fleet {
    rows: Rc<RefCell<Vec<Row>>>,
    daemons: [Rc<RefCell<Daemon>>; 3],
    harness: Harness<'static, FleetWindow>,
}

fn glance(mode: Mode, force_n: f64) -> Glance {
    Glance { mode, fault: None, force_n, taxels_ok: 10, taxels: 11, cover_age_s: 0.012 }
}

impl Fleet {
    fn new() -> Self {
        let row = |name: &str, seen| Row { name: name.into(), seen };
        let rows = Rc::new(RefCell::new(vec![
            row("ada", Ok(glance(Mode::Impedance, 12.3))),
            row("bob", Ok(glance(Mode::Ready, 0.0))),
            row("eve", Err("no connection: Connection refused".into())),
        ]));
        let daemons: [Rc<RefCell<Daemon>>; 3] = std::array::from_fn(|_| {
            Rc::new(RefCell::new(Daemon { simulated: true, session: 1, ..Daemon::default() }))
        });
        let (shown, opened) = (Rc::clone(&rows), daemons.clone());
        let open = move |ctx: &egui::Context, place: usize| match place {
            2 => Err("eve cannot be opened".to_owned()),
            _ => Ok(App::new(ctx, Fake(Rc::clone(&opened[place])), format!("unix:/{place}"), None)),
        };
        let window = FleetWindow::new(Box::new(move || shown.borrow().clone()), Box::new(open), None);
        let harness = Harness::builder().with_size([1280.0, 800.0]).build_ui_state(
            |ui, window: &mut FleetWindow| {
                window.update(&ui.ctx().clone());
                window.show(ui);
            },
            window,
        );
        Self { rows, daemons, harness }
    }

    fn steps(&mut self) {
        for tick in 0..3 {
            for daemon in &self.daemons {
                daemon.borrow_mut().samples.push_back(sample(tick, Mode::Ready, None));
            }
            self.harness.step();
        }
    }

    fn click(&mut self, label: &str) {
        self.harness.get_by_label_contains(label).click();
        self.steps();
    }

    fn shows(&self, text: &str) -> bool {
        self.harness.query_all_by_label_contains(text).next().is_some()
    }

    fn asked(&self) -> [Vec<Request>; 3] {
        std::array::from_fn(|robot| std::mem::take(&mut self.daemons[robot].borrow_mut().asked))
    }
}

#[test]
fn fleet_list_shows_mode_fault_contact_and_age() {
    let mut fleet = Fleet::new();
    fleet.steps();
    for text in ["3 robots, 2 without trouble", "impedance", "12.3 N", "10 of 11 taxels", "12 ms old"] {
        assert!(fleet.shows(text), "{text}");
    }
    assert!(fleet.shows("away") && fleet.shows("Connection refused"));
    let stopped = Glance { fault: Some(BoardFault::Lost.of(0)), ..glance(Mode::ProtectiveStop, 0.0) };
    fleet.rows.borrow_mut()[0].seen = Ok(stopped);
    fleet.steps();
    assert!(
        fleet.shows("protective stop")
            && fleet.shows(BoardFault::Lost.of(0).remedy())
            && !fleet.shows("12.3 N")
    );
    assert!(!fleet.shows("STOP"), "the list only watches");
    assert!(fleet.asked().iter().all(Vec::is_empty));
}

#[test]
fn opened_robot_of_a_fleet_is_stopped_alone() {
    let mut fleet = Fleet::new();
    fleet.steps();
    fleet.click("bob");
    assert!(fleet.shows("STOP (space)") && fleet.shows("Tare"));
    fleet.click("STOP (space)");
    assert_eq!(fleet.asked(), [vec![], vec![Request::Stop], vec![]]);
    // The others stay in sight, and any of them is a click away.
    assert!(fleet.shows("ada: impedance") && fleet.shows("eve: away"));
    fleet.click("ada: impedance");
    fleet.click("Tare");
    assert_eq!(fleet.asked(), [vec![Request::Tare], vec![], vec![]]);
    fleet.click("All robots");
    assert!(fleet.shows("3 robots") && !fleet.shows("STOP (space)"));
    // Robots that are not in front are shown no sign of life: nobody watches them.
    let before = fleet.daemons[1].borrow().signs_of_life;
    fleet.steps();
    assert_eq!(fleet.daemons[1].borrow().signs_of_life, before);
}

#[test]
fn robot_that_cannot_be_opened_is_said_in_the_list() {
    let mut fleet = Fleet::new();
    fleet.steps();
    fleet.click("eve");
    assert!(fleet.shows("eve cannot be opened") && fleet.shows("3 robots"));
}
