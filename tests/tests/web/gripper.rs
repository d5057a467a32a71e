//! The gripper of a robot on its page.

use super::browser::Page;
use super::robot::Robot;
use moca_web::access::Role;
use serde_json::{Value, json};
use std::time::Duration;

/// Longer than every lease.
const TOO_OLD: Duration = Duration::from_millis(1100);
/// The page's number of a gripper that holds an object.
const HOLDING: u8 = 2;

fn grasp(width_m: f64, force_n: f64) -> Value {
    let (speed_m_s, tolerance_m, mass_kg) = (0.05, 0.005, 0.5);
    let grasp = json!({"width_m": width_m, "speed_m_s": speed_m_s, "force_n": force_n, "tolerance_m": tolerance_m,
        "mass_kg": mass_kg});
    json!({"gripper": {"Grasp": grasp}})
}

/// A page that has drawn a few pictures of a robot that is ready.
async fn operator(robot: &Robot) -> Page {
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.until(|page| page.mode() == "ready" && page.drawn > 2).await.unwrap();
    page
}

/// Asks, and returns the answer's text; null for a success.
async fn ask(page: &mut Page, what: Value) -> Value {
    page.newer().await;
    page.ask(what).await;
    page.reply().await["text"].take()
}

fn holds(page: &Page) -> bool {
    page.gripper().is_some_and(|(_, object_kg, phase)| phase == HOLDING && object_kg > 0.0)
}

#[tokio::test]
async fn page_of_robot_without_gripper_is_told_of_none() {
    let robot = Robot::start("no-gripper");
    let mut page = operator(&robot).await;
    assert_eq!((&page.state["gripper"], page.gripper()), (&Value::Null, None));
    let said = "the robot has no gripper: set plant.gripper, restart the daemon";
    assert_eq!(ask(&mut page, json!({"gripper": "Release"})).await, said);
}

#[tokio::test]
async fn object_is_grasped_kept_through_a_stop_and_released() {
    let robot = Robot::start_with_gripper("gripper");
    let mut page = operator(&robot).await;
    let ranges =
        json!({"width_m": [0.0, 0.08], "force_n": [1.0, 70.0], "mass_kg": [0.0, 2.27], "fault": null});
    assert_eq!(page.state["gripper"], ranges);
    assert_eq!(page.gripper().map(|(width_mm, ..)| width_mm), Some(80.0));
    let said = "force of the gripper = 71 N; allowed: 1 to 70 N";
    assert_eq!(ask(&mut page, grasp(0.05, 71.0)).await, said);
    assert_eq!(page.gripper(), Some((80.0, 0.0, 0)), "a refused request changes nothing");

    assert_eq!(ask(&mut page, grasp(0.05, 40.0)).await, Value::Null);
    page.until(holds).await.unwrap();
    assert_eq!(page.gripper(), Some((50.0, 0.5, HOLDING)));
    page.run().await;
    page.stop(1).await;
    page.until(|page| page.stop_confirmed() == 1).await.unwrap();
    page.press = 0;
    assert_eq!(ask(&mut page, json!({"gripper": "Stop"})).await, Value::Null);
    page.newer().await;
    assert!(holds(&page), "a stop of robot and fingers lets nothing go: {:?}", page.gripper());
    assert_eq!(ask(&mut page, json!({"gripper": "Release"})).await, Value::Null);
    page.until(|page| page.gripper() == Some((80.0, 0.0, 0))).await.unwrap();
}

#[tokio::test]
async fn fault_of_gripper_is_told_with_its_remedy() {
    let robot = Robot::start_with_gripper("gripper-fault");
    let mut page = operator(&robot).await;
    assert_eq!(ask(&mut page, grasp(0.03, 40.0)).await, Value::Null);
    page.until(|page| page.state["gripper"]["fault"].is_object()).await.unwrap();
    let fault = moca_msgs::GripperFault::TooLarge;
    assert_eq!(page.state["gripper"]["fault"], json!({"text": fault.text(), "remedy": fault.remedy()}));
    assert!(page.state["fault"].is_null(), "it stops no robot");
}

#[tokio::test]
async fn old_picture_stops_fingers_and_moves_none() {
    let robot = Robot::start_with_gripper("gripper-old");
    let mut page = operator(&robot).await;
    for (what, text) in [
        (json!({"gripper": "Release"}), json!("the link is too slow: nothing was done")),
        (json!({"gripper": "Stop"}), Value::Null),
    ] {
        tokio::time::sleep(TOO_OLD).await;
        page.ask(what).await;
        assert_eq!(page.reply().await["text"], text);
    }
}

#[tokio::test]
async fn unread_stop_keeps_the_fingers_from_opening() {
    let robot = Robot::start_with_gripper("gripper-stop");
    let mut page = operator(&robot).await;
    assert_eq!(ask(&mut page, grasp(0.05, 40.0)).await, Value::Null);
    page.until(holds).await.unwrap();
    page.stop(1).await;
    page.ask(json!({"gripper": "Release"})).await;
    assert_eq!(page.reply().await["text"], "the robot has been stopped meanwhile: nothing was done");
    page.newer().await;
    assert!(holds(&page), "{:?}", page.gripper());
}
