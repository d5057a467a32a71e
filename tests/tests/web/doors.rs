//! The doors: tokens, origins, hosts, codes, roles.

use super::{browser::Browser, robot::Robot};
use moca_web::{
    SiteCertificate,
    access::{
        Role,
        devices::{Store, WRONG_CODES_MAX},
    },
};
use serde_json::json;

/// The authority of one robot stands for that of a site.
#[tokio::test]
async fn site_with_its_own_certificate_needs_no_authority() {
    let site = Robot::start("site").state();
    let own = SiteCertificate { chain: site.join("server.pem"), key: site.join("server-key.pem") };
    let robot = Robot::start_with("own-certificate", Some(own), false, "");
    assert!(!robot.state().join("authority.pem").exists());
    let mut browser = Browser::new(robot.gateway, &site);
    let code = Store::open(&robot.state()).unwrap().new_code(Role::Viewer).unwrap();
    assert_eq!(browser.pair(&code, "tablet").await.status, 200);
    browser.token.clear();
    let answer = browser.get("/authority.crt").await;
    assert_eq!(answer.status, 404);
    assert!(answer.text.contains("a certificate of its own"), "{}", answer.text);
}

#[tokio::test]
async fn request_without_a_token_or_with_a_wrong_one_gets_401() {
    let robot = Robot::start("token");
    let mut browser = robot.browser();
    for token in ["", "0", &"0".repeat(64)] {
        browser.token = token.into();
        for path in ["/me", "/urdf", "/parameters", "/logs", "/logs/a.mcap"] {
            assert_eq!(browser.get(path).await.status, 401, "{path} with token {token:?}");
        }
        assert_eq!(browser.send("POST", "/stop", "").await.status, 401);
        assert_eq!(browser.page().await.err(), Some(401));
    }
}

#[tokio::test]
async fn page_of_another_site_gets_403_and_is_written_down() {
    let robot = Robot::start("origin");
    let mut browser = robot.paired(Role::Operator, "Op").await;
    let own = browser.origin.clone().unwrap();
    let http = own.replace("https", "http");
    for origin in [None, Some("null"), Some("https://evil.example"), Some(&*http), Some("https://localhost")]
    {
        browser.origin = origin.map(str::to_owned);
        assert_eq!(browser.page().await.err(), Some(403), "{origin:?}");
        assert_eq!(browser.send("POST", "/stop", "").await.status, 403, "{origin:?}");
        assert_eq!(browser.pair("00000000", "x").await.status, 403, "{origin:?}");
        let read = if origin.is_some() { 403 } else { 200 };
        assert_eq!(browser.get("/me").await.status, read, "{origin:?}");
    }
    assert!(robot.audited("127.0.0.1", "another site") > 0);
}

#[tokio::test]
async fn foreign_host_header_gets_421() {
    let robot = Robot::start("host");
    let mut browser = robot.paired(Role::Operator, "Op").await;
    for host in ["evil.example", "localhost", "localhost:1", ""] {
        browser.host = host.into();
        browser.origin = Some(format!("https://{host}"));
        assert_eq!(browser.get("/").await.status, 421, "{host}");
        assert_eq!(browser.send("POST", "/stop", "").await.status, 421, "{host}");
    }
}

#[tokio::test]
async fn every_answer_forbids_content_of_other_hosts() {
    let robot = Robot::start("policy");
    let browser = robot.browser();
    for path in ["/", "/me", "/nonsense"] {
        let answer = browser.get(path).await;
        let policy = answer.header("content-security-policy").unwrap_or_default();
        assert!(
            policy.starts_with("default-src 'none'; script-src 'self'; style-src 'self';"),
            "{path}: {policy}"
        );
        assert!(policy.contains("frame-ancestors 'none'") && !policy.contains("unsafe"), "{path}: {policy}");
        assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
    }
}

#[tokio::test]
async fn code_is_good_once_and_void_after_five_wrong_ones() {
    let robot = Robot::start("codes");
    let store = Store::open(&robot.state()).unwrap();
    let code = store.new_code(Role::Viewer).unwrap();
    let browser = robot.browser();
    assert_eq!(browser.pair(&code.to_lowercase(), "First").await.status, 200);
    assert_eq!(browser.pair(&code, "Second").await.status, 403, "used");
    let code = store.new_code(Role::Operator).unwrap();
    assert_eq!(browser.pair(&code, "First").await.status, 403, "the name is taken");
    for _ in 0..WRONG_CODES_MAX {
        assert_eq!(browser.pair("00000000", "Guess").await.status, 403);
    }
    assert_eq!(browser.pair(&code, "Third").await.status, 403, "void");
    let names: Vec<_> = store.devices().unwrap().into_values().map(|device| device.name).collect();
    assert_eq!(names, ["First"]);
}

#[tokio::test]
async fn old_code_and_old_pairing_are_refused() {
    let robot = Robot::start("expired");
    let store = Store::open(&robot.state()).unwrap();
    let code = store.new_code(Role::Operator).unwrap();
    let age = |file: &str| {
        let path = robot.state().join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
        let entries = if file == "codes.json" { &mut value["codes"] } else { &mut value };
        for entry in entries.as_object_mut().unwrap().values_mut() {
            entry["until_unix_s"] = json!(1);
        }
        std::fs::write(&path, value.to_string()).unwrap();
    };
    age("codes.json");
    assert_eq!(robot.browser().pair(&code, "Late").await.status, 403);
    let browser = robot.paired(Role::Operator, "Op").await;
    assert_eq!(browser.get("/me").await.status, 200);
    age("devices.json");
    let hangs = tokio::time::Instant::now() + super::browser::HANGS_AFTER;
    while browser.get("/me").await.status != 401 {
        assert!(tokio::time::Instant::now() < hangs, "an old pairing is still let in");
    }
}

#[tokio::test]
async fn damaged_file_of_devices_lets_nobody_in() {
    let robot = Robot::start("damaged");
    let browser = robot.paired(Role::Operator, "Op").await;
    let mut page = browser.page().await.unwrap();
    std::fs::write(robot.state().join("devices.json"), "{\"damaged").unwrap();
    let (code, why) = page.until(|_| false).await.unwrap_err();
    assert_eq!((code, why.as_str()), (1008, "the rights of this device have been taken away"));
    assert_eq!(browser.get("/me").await.status, 401);
}

#[tokio::test]
async fn logs_are_for_operators_and_of_one_folder_only() {
    let robot = Robot::start("logs");
    std::fs::write(robot.logs().join("2026-01-01.mcap"), "bytes of a log").unwrap();
    std::fs::write(robot.logs().join("notes.txt"), "not a log").unwrap();
    std::os::unix::fs::symlink("/etc/passwd", robot.logs().join("link.mcap")).unwrap();
    let viewer = robot.paired(Role::Viewer, "Viewer").await;
    assert_eq!(viewer.get("/logs").await.status, 403);
    assert_eq!(viewer.get("/logs/2026-01-01.mcap").await.status, 403);
    let operator = robot.paired(Role::Operator, "Op").await;
    let list = operator.get("/logs").await.text;
    assert!(list.ends_with(r#"[{"bytes":14,"name":"2026-01-01.mcap"}]"#), "{list}");
    let log = operator.get("/logs/2026-01-01.mcap").await;
    assert!(log.status == 200 && log.text.contains("bytes of a log"), "{}", log.text);
    for path in [
        "..%2fstate%2fdevices.json",
        "%2e%2e/state/devices.json",
        "notes.txt",
        "link.mcap",
        "..%2f..%2fmocad.toml",
    ] {
        let answer = operator.get(&format!("/logs/{path}")).await;
        assert_eq!(answer.status, 404, "{path}: {}", answer.text);
    }
}

/// Every request of a page, and the least role that it is obeyed from.
fn requests() -> Vec<(serde_json::Value, Role)> {
    vec![
        (json!("tare"), Role::Operator),
        (json!("resume"), Role::Operator),
        (json!({"law": "follow-me"}), Role::Operator),
        (json!({"law": "impedance"}), Role::Operator),
        (json!({"press-taxel": {"taxel": 0, "force_n": 0.0}}), Role::Operator),
        (json!({"mask-taxel": {"taxel": 0, "masked": true}}), Role::Maintainer),
        (json!({"mask-taxel": {"taxel": 0, "masked": false}}), Role::Maintainer),
        (
            json!({"set-parameter": {"name": "control.gains.damping_ratio", "values": [1.0]}}),
            Role::Maintainer,
        ),
        (json!({"calibrate": {"taxel": 0, "presses": 1}}), Role::Maintainer),
        (json!({"gripper": "Stop"}), Role::Operator),
        (json!({"gripper": "Release"}), Role::Operator),
        (json!("cancel-calibration"), Role::Maintainer),
        (json!({"save-calibration": {"model": 0}}), Role::Maintainer),
    ]
}

#[tokio::test]
async fn request_is_obeyed_from_its_least_role_on_and_never_below() {
    let robot = Robot::start("roles");
    for role in Role::ALL {
        let browser = robot.paired(role, role.name()).await;
        let mut page = browser.page().await.unwrap();
        page.until(|page| page.mode() == "ready" && page.drawn > 2).await.unwrap();
        for (what, least) in requests() {
            // A page that has not seen a stop yet asks in vain.
            page.newer().await;
            page.ask(what.clone()).await;
            let reply = page.reply().await;
            let refused = reply["text"].as_str().is_some_and(|text| text.ends_with("may not do this"));
            assert_eq!(refused, role < least, "{} asks {what}: {reply}", role.name());
            // A tare takes its time, and no other request is taken meanwhile.
            page.until(|page| {
                page.mode() != "taring" && page.state["holder"].is_null()
                    || page.state["holder"] == role.name()
            })
            .await
            .unwrap();
        }
        page.newer().await;
        if page.mode() == "protective stop" {
            // A masked taxel has stopped the robot, and has no zero since it is back in use.
            for what in ["tare", "resume"] {
                page.ask(json!(what)).await;
                let reply = page.reply().await;
                assert_eq!(reply["ok"], true, "{what}: {reply}");
                // The tare begins, then ends, and the page sees it.
                page.newer().await;
                page.until(|page| page.mode() != "taring").await.unwrap();
                page.newer().await;
            }
            assert_eq!(page.mode(), "ready");
        }
        // A calibration that is over gives the command back by itself.
        page.until(|page| page.state["holder"].is_null()).await.unwrap();
        let operates = role >= Role::Operator;
        page.press += 1;
        page.beat().await;
        if operates {
            page.until(|page| page.mode() == "impedance").await.unwrap();
            page.press = 0;
            page.beat().await;
            page.until(|page| page.mode() == "ready").await.unwrap();
        } else {
            let reply = page.reply().await;
            assert_eq!(reply["text"], "a viewer may not do this");
            assert_eq!(page.mode(), "ready");
        }
        let parameters = browser.get("/parameters").await.status;
        assert_eq!(parameters, if role == Role::Maintainer { 200 } else { 403 });
    }
}
