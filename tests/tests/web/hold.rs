//! Presses that run the robot, and everything that stops it.

use super::robot::Robot;
use moca_web::access::{Role, devices::Store};
use serde_json::json;
use std::time::Duration;

/// Longer than every lease.
const TOO_OLD: Duration = Duration::from_millis(1100);

#[tokio::test]
async fn press_runs_the_robot_and_letting_go_disarms_it() {
    let robot = Robot::start("press");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.run().await;
    page.until(|page| page.state["holder"] == "Op").await.unwrap();
    page.press = 0;
    page.beat().await;
    page.until(|page| page.mode() == "ready" && page.state["holder"].is_null()).await.unwrap();
    assert!(page.state["fault"].is_null(), "letting go is no stop: {}", page.state);
}

#[tokio::test]
async fn viewer_stops_the_robot_and_a_later_picture_confirms_it() {
    let robot = Robot::start_recorded("stop");
    let mut holder = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    let viewer = robot.paired(Role::Viewer, "Viewer").await;
    let mut page = viewer.page().await.unwrap();
    holder.run().await;
    page.stop(7).await;
    let (stopped, held) = tokio::join!(
        page.until(|page| page.stop_confirmed() == 7 && page.mode() == "protective stop"),
        holder.until(|page| page.mode() == "protective stop")
    );
    stopped.unwrap();
    held.unwrap();
    // And without a socket.
    holder.press = 0;
    holder.newer().await;
    holder.ask(json!("resume")).await;
    holder.until(|page| page.mode() == "ready").await.unwrap();
    assert_eq!(viewer.send("POST", "/stop", "").await.status, 202);
    holder.until(|page| page.mode() == "protective stop").await.unwrap();
    let asked = robot.asked();
    let stops = asked.iter().filter(|line| line.what == "stop" && line.accepted);
    let of_viewer = stops.filter(|line| line.who.ends_with(", for Viewer")).map(|line| line.times);
    assert_eq!(of_viewer.sum::<u64>(), 2, "the robot's log names the device: {asked:#?}");
}

/// Regression test: a new connection to the daemon once asked for every earlier stop again.
#[tokio::test]
async fn answered_stop_is_not_repeated_to_a_new_daemon() {
    let mut robot = Robot::start("restart");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.until(|page| page.mode() == "ready").await.unwrap();
    page.stop(1).await;
    page.until(|page| page.stop_confirmed() == 1).await.unwrap();
    robot.restart();
    page.until(|page| page.state["down"].is_string()).await.unwrap();
    page.until(|page| page.state["down"].is_null() && page.mode() == "ready").await.unwrap();
    page.run().await;
    let seen = page.drawn;
    page.until(|page| page.drawn > seen + 20).await.unwrap();
    assert_eq!(page.mode(), "impedance");
}

#[tokio::test]
async fn press_that_began_before_a_stop_never_arms() {
    let robot = Robot::start("before");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.run().await;
    let before = page.drawn;
    page.stop(1).await;
    page.until(|page| page.mode() == "protective stop").await.unwrap();
    page.newer().await;
    page.ask(json!("resume")).await;
    // The same press goes on all the time.
    page.until(|page| page.mode() == "ready").await.unwrap();
    let seen = page.drawn;
    page.until(|page| page.drawn > seen + 15).await.unwrap();
    assert_eq!(page.mode(), "ready", "a press that lasts over a stop arms nothing");
    // One that ended does not come back, nor does a new one that has not seen the stop.
    let press = page.press;
    page.press = 0;
    page.beat().await;
    page.press = press;
    page.beat().await;
    assert_eq!(page.reply().await["text"], "this press has ended: press again");
    page.press = 0;
    page.beat().await;
    let newest = page.drawn;
    (page.drawn, page.press) = (before, press + 1);
    page.beat().await;
    page.drawn = newest;
    let reply = page.reply().await;
    let text = reply["text"].as_str().unwrap().to_owned();
    assert!(text.contains("stopped meanwhile") || text.contains("too slow"), "{reply}");
    assert_eq!(page.mode(), "ready");
}

#[tokio::test]
async fn press_with_an_old_picture_does_nothing() {
    let robot = Robot::start("old");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.until(|page| page.mode() == "ready").await.unwrap();
    tokio::time::sleep(TOO_OLD).await;
    page.press += 1;
    page.beat().await;
    assert_eq!(page.reply().await["text"], "the link is too slow: nothing was done");
    page.ask(json!("tare")).await;
    let reply = page.reply().await;
    // By now newer pictures have been drawn.
    assert_eq!(reply["ok"], true, "{reply}");
}

#[tokio::test]
async fn signs_of_life_of_an_old_picture_stop_the_robot_for_good() {
    let robot = Robot::start("repeats");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.run().await;
    page.until_without_drawing(|page| page.mode() == "protective stop").await.unwrap();
    assert!(page.state["fault"]["text"].as_str().is_some_and(|text| text.contains("gone")), "{}", page.state);
    // New pictures are drawn again, and the press lasts: it does not revive the robot.
    let seen = page.drawn;
    page.until(|page| page.drawn > seen + 20).await.unwrap();
    assert_eq!(page.mode(), "protective stop");
    assert_eq!(robot.audited("Op", "the robot stops"), 1);
}

#[tokio::test]
async fn holder_whose_connection_ends_stops_the_robot() {
    let robot = Robot::start("gone");
    let mut watching = robot.paired(Role::Viewer, "Viewer").await.page().await.unwrap();
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.run().await;
    drop(page);
    watching.until(|page| page.mode() == "protective stop").await.unwrap();
}

#[tokio::test]
async fn holder_that_reads_nothing_stops_the_robot() {
    let robot = Robot::start("deaf");
    let mut watching = robot.paired(Role::Viewer, "Viewer").await.page().await.unwrap();
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.run().await;
    // It goes on talking, of the last picture that it has drawn.
    let (stopped, ()) = tokio::join!(watching.until(|page| page.mode() == "protective stop"), async {
        for _ in 0..40 {
            page.beat().await;
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    });
    stopped.unwrap();
}

#[tokio::test]
async fn revoked_holder_is_closed_and_the_robot_stops() {
    let robot = Robot::start("revoked");
    let mut watching = robot.paired(Role::Viewer, "Viewer").await.page().await.unwrap();
    let browser = robot.paired(Role::Operator, "Op").await;
    let mut page = browser.page().await.unwrap();
    page.run().await;
    assert_eq!(Store::open(&robot.state()).unwrap().revoke("Op").unwrap(), 1);
    let (stopped, closed) =
        tokio::join!(watching.until(|page| page.mode() == "protective stop"), page.until(|_| false));
    stopped.unwrap();
    assert_eq!(closed.unwrap_err().0, 1008);
    assert_eq!(browser.get("/me").await.status, 401);
    assert_eq!(browser.page().await.err(), Some(401));
}

#[tokio::test]
async fn second_operator_is_told_who_holds_and_changes_nothing() {
    let robot = Robot::start("second");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    let mut other = robot.paired(Role::Maintainer, "Other").await.page().await.unwrap();
    page.run().await;
    let second = async {
        other.until(|page| page.state["holder"] == "Op").await.unwrap();
        for what in [json!("tare"), json!({"law": "follow-me"})] {
            other.ask(what).await;
            assert_eq!(other.reply().await["text"], "Op holds the command");
        }
        other.press += 1;
        other.beat().await;
        assert_eq!(other.reply().await["text"], "Op holds the command");
    };
    let holder = async { page.until(|_| false).await };
    tokio::select! {
        () = second => {}
        end = holder => panic!("{end:?}"),
    }
    page.until(|page| page.drawn > 0).await.unwrap();
    assert_eq!(page.mode(), "impedance");
}
