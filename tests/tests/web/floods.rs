//! Programs that break the protocol or flood the gateway while somebody else holds the robot.

use super::{browser::Page, robot::Robot};
use moca_web::access::Role;
use serde_json::json;
use std::time::Duration;
use tokio::io::AsyncWriteExt;

/// Holds the robot with `page` while `attack` runs; it must not notice.
async fn holding(page: &mut Page, attack: impl Future<Output = ()>) {
    tokio::select! {
        () = attack => {}
        end = page.until(|page| page.mode() != "impedance") => panic!("{end:?}: {}", page.state),
    }
    let seen = page.drawn;
    page.until(|page| page.drawn > seen + 3).await.unwrap();
    assert_eq!(page.mode(), "impedance");
}

#[tokio::test]
async fn page_that_breaks_the_protocol_is_closed() {
    let robot = Robot::start("broken");
    let browser = robot.paired(Role::Operator, "Op").await;
    let long = format!("{{\"t\": \"beat\"{}}}", " ".repeat(5000));
    for text in [
        json!({"t": "beat", "n": 1, "drawn": 0, "press": 0}).to_string(), // twice
        json!({"t": "beat", "n": 2, "drawn": 4_000_000, "press": 0}).to_string(),
        json!({"t": "ask", "n": 2, "drawn": 1, "what": "arm"}).to_string(),
        json!({"t": "beat", "n": 2, "drawn": 1, "press": 0, "more": 1}).to_string(),
        json!({"t": "beat", "n": -1, "drawn": 1, "press": 0}).to_string(),
        "garbage".into(),
        "[".repeat(900),
        long,
    ] {
        let mut page = browser.page().await.unwrap();
        page.say(&json!({"t": "beat", "n": 1, "drawn": 0, "press": 0}).to_string()).await;
        page.say(&text).await;
        let code = loop {
            if let Err((code, _)) = page.take().await {
                break code;
            }
        };
        assert!([1008, 1006].contains(&code), "{code} after {}", &text[..text.len().min(60)]);
    }
}

#[tokio::test]
async fn flood_of_a_paired_page_closes_it_and_the_holder_goes_on() {
    let robot = Robot::start("flood");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    let mut other = robot.paired(Role::Operator, "Other").await.page().await.unwrap();
    page.run().await;
    holding(&mut page, async {
        for _ in 0..200 {
            other.ask(json!("tare")).await;
        }
        let (code, why) = loop {
            if let Err(end) = other.take().await {
                break end;
            }
        };
        assert!(code == 1006 || why == "too many messages", "{code} {why}");
    })
    .await;
    assert!(robot.audited("Other", "") < 60, "a flood writes no more than its bound");
}

#[tokio::test]
async fn thousands_of_stops_are_obeyed_and_written_down_a_few_times() {
    let robot = Robot::start("stops");
    let mut page = robot.paired(Role::Viewer, "Viewer").await.page().await.unwrap();
    page.until(|page| page.mode() == "ready").await.unwrap();
    for stop in 1..=3000 {
        page.stop(stop).await;
    }
    page.until(|page| page.stop_confirmed() == 3000).await.unwrap();
    assert_eq!(page.mode(), "protective stop");
    let lines = robot.audited("Viewer", "\"stop\"");
    assert!((1..200).contains(&lines), "{lines} lines");
}

#[tokio::test]
async fn flood_of_requests_from_another_address_is_turned_away() {
    let robot = Robot::start("requests");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    let mut flood = robot.browser();
    flood.from = [127, 0, 0, 2];
    page.run().await;
    holding(&mut page, async {
        let mut turned_away = 0;
        for _ in 0..400 {
            turned_away += usize::from(flood.get("/me").await.status == 429);
        }
        println!("{turned_away} of 400 turned away");
    })
    .await;
    // On one connection nothing slows a client down.
    let mut stream = flood.connect().await;
    let request = format!("GET /me HTTP/1.1\r\nHost: {}\r\n\r\n", flood.host);
    stream.write_all(request.repeat(500).as_bytes()).await.unwrap();
    let mut answers = vec![0; 8192];
    let mut turned_away = false;
    while !turned_away {
        let read = tokio::io::AsyncReadExt::read(&mut stream, &mut answers).await.unwrap();
        assert!(read > 0, "500 requests at once and none was turned away");
        turned_away = String::from_utf8_lossy(&answers[..read]).contains("429 Too Many");
    }
}

#[tokio::test]
async fn idle_connections_of_one_address_leave_room_for_others() {
    let robot = Robot::start("idle");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    page.run().await;
    let gateway = robot.gateway;
    holding(&mut page, async {
        let mut idle = Vec::new();
        for _ in 0..150 {
            let socket = tokio::net::TcpSocket::new_v4().unwrap();
            socket.bind(([127, 0, 0, 3], 0).into()).unwrap();
            if let Ok(Ok(stream)) =
                tokio::time::timeout(Duration::from_secs(5), socket.connect(gateway)).await
            {
                idle.push(stream);
            }
        }
        assert_eq!(robot.browser().get("/").await.status, 200);
    })
    .await;
}

#[tokio::test]
async fn pages_that_read_nothing_are_closed_and_the_holder_goes_on() {
    let robot = Robot::start("deaf-pages");
    let mut page = robot.paired(Role::Operator, "Op").await.page().await.unwrap();
    let viewer = robot.paired(Role::Viewer, "Viewer").await;
    page.run().await;
    let mut deaf = Vec::new();
    holding(&mut page, async {
        for _ in 0..5 {
            deaf.push(viewer.page().await.unwrap());
        }
        let hangs = tokio::time::Instant::now() + super::browser::HANGS_AFTER;
        while robot.audited("Viewer", "the page takes nothing") < 5 {
            assert!(tokio::time::Instant::now() < hangs, "pages that read nothing are still served");
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    })
    .await;
}

#[tokio::test]
async fn page_beyond_the_last_place_is_refused_and_may_still_stop() {
    let robot = Robot::start("full");
    let viewer = robot.paired(Role::Viewer, "Viewer").await;
    let mut pages = Vec::new();
    for _ in 0..16 {
        pages.push(viewer.page().await.unwrap());
    }
    assert_eq!(viewer.page().await.err(), Some(503));
    pages[0].until(|page| page.mode() == "ready").await.unwrap();
    assert_eq!(viewer.send("POST", "/stop", "").await.status, 202);
    pages[0].until(|page| page.mode() == "protective stop").await.unwrap();
}
