//! Exported files, read back by the library that wrote them.

use super::frames::{episodes, frames};
use super::quantities::join_quaternions;
use super::{Form, TableArguments, lerobot, run};
use moca_msgs::{Mode, Sample, TaxelReading, TaxelStatus};
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogWriter, Meta};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, Row};
use std::fs::File;
use std::path::{Path, PathBuf};

/// A folder of its own for each test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("moca-export-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// 2 s at 1 kHz; the hand is on T6 in the second one, and T3 fails at 1.5 s.
fn sample(tick: u64) -> Sample {
    let mut sample = Sample {
        tick,
        time_ns: tick * 1_000_000,
        mode: Mode::Impedance,
        frame_age_s: 0.025,
        ..Sample::default()
    };
    sample.base_pose_world[0] = 1e-3 * f64::from(u32::try_from(tick).unwrap());
    sample.base_pose_world[2] = std::f64::consts::FRAC_PI_2;
    sample.base_velocity_world[0] = 0.5;
    // The same orientation, whatever its sign.
    let sign = if tick % 3 == 0 { -1.0 } else { 1.0 };
    sample.flange_quaternion_world = [sign * 0.8, 0.0, 0.0, sign * -0.6];
    sample.flange_desired_quaternion_world = [-sign, 0.0, 0.0, 0.0];
    sample.q_rad.extend([0.5; 7]);
    sample.dq_rad_s.extend([0.0; 7]);
    sample.arm_torque_nm.extend([2.0; 7]);
    for taxel in 0..11 {
        let force_n = if taxel == 5 && tick >= 1000 { 20.0 } else { 0.0 };
        let status = if taxel == 2 && tick >= 1500 { TaxelStatus::Stuck } else { TaxelStatus::Ok };
        let _ = sample.taxels.push(TaxelReading { force_n, status });
        let _ = sample.counts.push(700);
    }
    sample
}

fn log(folder: &Path, name: &str, ticks: impl Iterator<Item = u64>) -> PathBuf {
    let path = folder.join(name);
    let meta = Meta { description: RobotDescription::paper("test", true), start_unix_ns: 0 };
    let mut writer = LogWriter::new(File::create(&path).unwrap(), &meta).unwrap();
    ticks.for_each(|tick| writer.sample(&sample(tick)).unwrap());
    writer.finish().unwrap();
    path
}

fn parsed(arguments: &[&str]) -> lerobot::Arguments {
    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        arguments: lerobot::Arguments,
    }
    let arguments = std::iter::once("lerobot").chain(arguments.iter().copied());
    <Command as clap::Parser>::parse_from(arguments).arguments
}

fn rows(path: &Path) -> Vec<Row> {
    let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
    reader.get_row_iter(None).unwrap().map(Result::unwrap).collect()
}

fn field<'a>(row: &'a Row, name: &str) -> &'a Field {
    row.get_column_iter().find(|(column, _)| *column == name).unwrap().1
}

fn list(row: &Row, name: &str) -> Vec<Field> {
    let Field::ListInternal(list) = field(row, name) else { panic!("{name} is no list") };
    list.elements().to_vec()
}

#[test]
fn a_gap_ends_an_episode_and_frames_stand_at_equal_distances() {
    let samples: Vec<Sample> = (0..100).chain(400..500).map(sample).collect();
    let all = |_: &Sample| true;
    let lengths: Vec<usize> = episodes(&samples, all).map(|stretch| frames(stretch, 50).len()).collect();
    assert_eq!(lengths, [5, 5]);
    let last = episodes(&samples, all).last().unwrap();
    let at: Vec<_> = frames(last, 30).iter().map(|frame| (frame.sample.tick, frame.age_s)).collect();
    assert_eq!(at.iter().map(|(tick, _)| *tick).collect::<Vec<_>>(), [400, 433, 466]);
    assert!((at[1].1 - 0.000_333_333).abs() < 1e-9, "as old as it is: {at:?}");
}

/// A log, changed, as a data set; what it says, and the frames of each episode.
fn data_set(folder: &Folder, change: impl Fn(&mut Sample)) -> anyhow::Result<(String, Vec<Row>)> {
    let (path, out) = (folder.0.join("run.mcap"), folder.0.join("set"));
    let meta = Meta { description: RobotDescription::paper("test", true), start_unix_ns: 0 };
    let mut writer = LogWriter::new(File::create(&path)?, &meta)?;
    for tick in 0..2000 {
        let mut sample = sample(tick);
        change(&mut sample);
        writer.sample(&sample)?;
    }
    writer.finish()?;
    let told = lerobot::run(&parsed(&[&path.display().to_string(), "--out", &out.display().to_string()]))?;
    Ok((told, rows(&out.join("data/chunk-000/file-000.parquet"))))
}

#[test]
fn episodes_leave_out_waiting_and_unknown_states() {
    let folder = Folder::new("waits");
    let (told, rows) = data_set(&folder, |sample| {
        if sample.tick < 400 {
            sample.mode = Mode::Ready;
            sample.flange_desired_quaternion_world = [0.0; 4];
        } else if (1000..1200).contains(&sample.tick) {
            sample.q_rad[3] = f64::NAN;
        } else if sample.tick >= 1600 {
            sample.mode = Mode::ProtectiveStop;
        }
    })
    .unwrap();
    assert!(told.ends_with("2 episodes, 50 frames at 50 Hz"), "{told}");
    let base_x = |row: usize| list(&rows[row], "observation.base")[0].clone();
    assert_eq!(base_x(0), Field::Float(0.4), "the first frame is the first of the law's");
    assert_eq!((base_x(29), base_x(30)), (Field::Float(0.98), Field::Float(1.2)));
    assert_eq!(list(&rows[30], "observation.joints")[3], Field::Float(0.5));
}

#[test]
fn a_log_in_which_no_law_was_in_control_is_no_data_set() {
    let folder = Folder::new("never");
    let error = data_set(&folder, |sample| sample.mode = Mode::Ready).unwrap_err();
    assert!(error.to_string().ends_with("run.mcap: no law was in control"), "{error}");
    assert!(!folder.0.join("set").exists());
}

#[test]
fn quaternions_turn_without_a_jump() {
    // Two turns about z: every element passes through zero, and the recorded sign is that of a positive real part.
    let angle = |k: u32| f64::from(k) * 0.02;
    let mut samples: Vec<Sample> = (0..628)
        .map(|k| {
            let (sin, cos) = (angle(k) / 2.0).sin_cos();
            let sign = cos.signum();
            let mut sample = sample(k.into());
            sample.flange_quaternion_world = [0.0, 0.0, sign * sin, sign * cos];
            sample
        })
        .collect();
    join_quaternions(&mut samples);
    for (k, sample) in (0..).zip(&samples) {
        let (sin, cos) = (angle(k) / 2.0).sin_cos();
        assert_eq!(sample.flange_quaternion_world, [0.0, 0.0, sin, cos], "{k}");
        assert_eq!(sample.flange_desired_quaternion_world, [1.0, 0.0, 0.0, 0.0], "{k}");
    }
}

#[test]
fn a_data_set_says_what_it_holds_and_holds_it() {
    let folder = Folder::new("lerobot");
    let logs = [log(&folder.0, "a.mcap", 0..2000), log(&folder.0, "b.mcap", (0..500).chain(1500..2000))];
    let out = folder.0.join("set");
    let [a, b] = logs.map(|path| path.display().to_string());
    let told =
        lerobot::run(&parsed(&[&a, &b, "--out", &out.display().to_string(), "--task", "be led"])).unwrap();
    assert!(told.ends_with("3 episodes, 150 frames at 50 Hz"), "{told}");

    let info: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("meta/info.json")).unwrap()).unwrap();
    assert_eq!((info["codebase_version"].as_str(), info["total_frames"].as_u64()), (Some("v3.0"), Some(150)));
    let features = info["features"].as_object().unwrap();
    assert_eq!(features["observation.tactile.valid"]["dtype"], "bool");
    let named = |feature: &str| features[feature]["names"].as_array().unwrap();
    assert_eq!((named("observation.base").len(), named("observation.joints").len()), (3, 14));
    // What was measured stands where it was commanded.
    for (measured, commanded) in named("observation.state").iter().zip(named("action")) {
        assert_eq!(measured.as_str().unwrap(), commanded.as_str().unwrap().replace("_desired", ""));
    }
    assert_eq!((named("observation.state").len(), named("action").len()), (10, 10));

    let rows = rows(&out.join("data/chunk-000/file-000.parquet"));
    assert_eq!(rows.len(), 150);
    for (index, row) in (0_i64..).zip(&rows) {
        // Every feature has its column, of its shape.
        for (name, feature) in features {
            let width = usize::try_from(feature["shape"][0].as_u64().unwrap()).unwrap();
            let held = if width == 1 { 1 } else { list(row, name).len() };
            assert_eq!((field(row, name).clone() != Field::Null, held), (true, width), "{name}");
        }
        assert_eq!(*field(row, "index"), Field::Long(index));
        let episode = match index {
            0..100 => 0,
            100..125 => 1,
            _ => 2,
        };
        assert_eq!(*field(row, "episode_index"), Field::Long(episode));
    }
    // A second in, T6 is pressed; half a second later T3 means nothing any more.
    let force = |row: usize| list(&rows[row], "observation.tactile.force");
    assert_eq!((force(49)[5].clone(), force(50)[5].clone()), (Field::Float(0.0), Field::Float(20.0)));
    let valid = |row: usize| list(&rows[row], "observation.tactile.valid")[2].clone();
    assert_eq!((valid(74), valid(75)), (Field::Bool(true), Field::Bool(false)));
    assert_eq!(*field(&rows[60], "timestamp"), Field::Float(1.2));
    assert_eq!(*field(&rows[60], "observation.tactile.age"), Field::Float(0.025));
    assert_eq!(list(&rows[60], "observation.base")[0], Field::Float(1.2));
    // A quarter turn to the left: what goes along x in the world goes to the robot's right.
    assert_eq!(list(&rows[60], "observation.state")[1], Field::Float(-0.5));

    let first = named("observation.state").iter().position(|name| name == "flange_qx").unwrap();
    assert!(rows.iter().all(|row| list(row, "observation.state")[first] == Field::Float(0.8)), "one sign");

    let stats: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("meta/stats.json")).unwrap()).unwrap();
    assert_eq!(stats["observation.tactile.force"]["max"][5], 20.0);
    assert_eq!(stats["observation.tactile.force"]["count"][0], 150);
    let episodes = self::rows(&out.join("meta/episodes/chunk-000/file-000.parquet"));
    assert_eq!(*field(&episodes[1], "dataset_from_index"), Field::Long(100));
    assert_eq!(list(&episodes[1], "tasks"), [Field::Str("be led".into())]);
    assert_eq!(list(&episodes[2], "stats/observation.state/max").len(), 10);
}

#[test]
fn exported_table_has_all_samples_and_units() {
    let folder = Folder::new("table");
    let logs = vec![log(&folder.0, "run.mcap", 0..1000), log(&folder.0, "run-2.mcap", 1000..2000)];
    let (csv, parquet) = (folder.0.join("run.csv"), folder.0.join("run.parquet"));
    let table = |out: &Path| TableArguments { logs: logs.clone(), out: out.into() };
    run(&super::Arguments { form: Form::Csv(table(&csv)) }).unwrap();
    run(&super::Arguments { form: Form::Parquet(table(&parquet)) }).unwrap();
    let text = std::fs::read_to_string(&csv).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    assert!(
        names
            .iter()
            .all(|name| name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_'))
    );
    let place = |name: &str| names.iter().position(|other| *other == name).unwrap();
    let lines: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert!(lines.len() == 100 && lines.iter().all(|line| line.len() == names.len()));
    assert_eq!((lines[60][place("time_s")], lines[60][place("mode")]), ("1.2", Mode::Impedance.name()));
    assert!(lines.iter().all(|line| line[place("flange_qw")] == "-0.6"), "one sign");
    assert_eq!((lines[60][place("t6_n")], lines[80][place("t3_n")]), ("20", ""), "no force is no zero");
    let rows = rows(&parquet);
    assert_eq!(rows.len(), 100);
    assert_eq!(*field(&rows[60], "t6_n"), Field::Double(20.0));
    let Field::Double(missing) = field(&rows[80], "t3_n") else { panic!("no number") };
    assert!(missing.is_nan());
    assert!(run(&super::Arguments { form: Form::Csv(table(&csv)) }).is_err(), "nothing is overwritten");
}
