//! Messages for ROS users on top of what every viewer is shown: taxel forces with validity and age, the flange's
//! wrench, diagnostics. Frames are those of the robot's URDF.

use crate::messages::{
    DiagnosticArray, DiagnosticStatus, Float64MultiArray, Header, KeyValue, MultiArrayDimension,
    MultiArrayLayout, Time, Vector3, Wrench, WrenchStamped,
};
use moca_msgs::{Mode, Sample, TaxelStatus};

/// Columns of [`taxels`].
pub const TAXEL_COLUMNS: u32 = 3;
/// Levels of diagnostics.
const OK: u8 = 0;
const WARNING: u8 = 1;
const ERROR: u8 = 2;

/// One row for each taxel, T1 first: force, N; 1 if it is valid, else 0; age, s. A force that is not valid is NaN, and so is
/// an age before the first frame: stale is not zero.
pub fn taxels(sample: &Sample) -> Float64MultiArray {
    let count = u32::try_from(sample.taxels.len()).unwrap_or(u32::MAX);
    let age_s = if sample.frame_age_s < 0.0 { f64::NAN } else { sample.frame_age_s };
    let rows = sample.taxels.iter().flat_map(|taxel| {
        let valid = taxel.status == TaxelStatus::Ok;
        [if valid { taxel.force_n } else { f64::NAN }, f64::from(u8::from(valid)), age_s]
    });
    let dimension = |label: &str, size, stride| MultiArrayDimension { label: label.into(), size, stride };
    let dim = vec![
        dimension("taxel", count, count.saturating_mul(TAXEL_COLUMNS)),
        dimension("force_n valid age_s", TAXEL_COLUMNS, TAXEL_COLUMNS),
    ];
    Float64MultiArray { layout: MultiArrayLayout { dim, data_offset: 0 }, data: rows.collect() }
}

/// The external wrench on the robot about the flange's origin, in the flange's axes.
pub fn flange_wrench(sample: &Sample, stamp: Time) -> WrenchStamped {
    let [fx, fy, fz, mx, my, mz] = sample.flange_wrench_world;
    let [x, y, z, w] = sample.flange_quaternion_world;
    // World axes into the flange's: the turn back.
    let turn = |v: [f64; 3]| Vector3::from(turned([-x, -y, -z, w], v));
    let wrench = Wrench { force: turn([fx, fy, fz]), torque: turn([mx, my, mz]) };
    WrenchStamped { header: Header { stamp, frame_id: "flange".into() }, wrench }
}

/// Supervisor, cover and loop.
pub fn diagnostics(name: &str, sample: &Sample, stamp: Time) -> DiagnosticArray {
    let status = |part: &str, level, message: String, values: Vec<KeyValue>| DiagnosticStatus {
        level,
        name: format!("moca: {part}"),
        message,
        hardware_id: name.into(),
        values,
    };
    let value = |key: &str, value: String| KeyValue { key: key.into(), value };
    let robot = match sample.fault {
        Some(fault) => {
            let text = format!("{} {}", fault.text(), fault.remedy());
            (ERROR, text, vec![value("fault", fault.code().into())])
        }
        None => (if sample.mode == Mode::Starting { WARNING } else { OK }, String::new(), Vec::new()),
    };
    let (level, text, mut values) = robot;
    values.push(value("mode", sample.mode.name().into()));
    values.push(value("speed limit, m/s", sample.speed_limit.m_s.to_string()));
    let mut parts = vec![status("robot", level, text, values)];
    if !sample.taxels.is_empty() {
        let bad = sample.taxels.iter().filter(|taxel| taxel.status != TaxelStatus::Ok).count();
        let values = vec![
            value("taxels not valid", bad.to_string()),
            value("frame age, s", sample.frame_age_s.to_string()),
            value("frame rate, Hz", sample.frame_rate_hz.to_string()),
            value("frames rejected", sample.frames_bad.to_string()),
        ];
        let level = if bad > 0 || sample.frame_age_s < 0.0 { ERROR } else { OK };
        parts.push(status("cover", level, sample.board.text().into(), values));
    }
    let values = vec![
        value("slots missed", sample.overruns.to_string()),
        value("lateness, s", sample.lateness_s.to_string()),
    ];
    parts.push(status("loop", OK, String::new(), values));
    DiagnosticArray { header: Header { stamp, frame_id: String::new() }, status: parts }
}

/// `v` turned by a unit quaternion: v + 2·u × (u × v + w·v).
fn turned([x, y, z, w]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let u = [x, y, z];
    let inner: [f64; 3] = {
        let c = cross(u, v);
        std::array::from_fn(|i| c[i] + w * v[i])
    };
    let outer = cross(u, inner);
    std::array::from_fn(|i| v[i] + 2.0 * outer[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{Fault, TaxelReading};

    #[test]
    fn a_force_that_is_not_valid_is_not_a_number_and_says_so() {
        let mut sample = Sample { frame_age_s: 0.02, ..Sample::default() };
        sample.taxels.push(TaxelReading { force_n: 12.0, status: TaxelStatus::Ok }).unwrap();
        sample.taxels.push(TaxelReading { force_n: 0.0, status: TaxelStatus::Stale }).unwrap();
        let message = taxels(&sample);
        assert_eq!(message.data[..3], [12.0, 1.0, 0.02]);
        assert!(message.data[3].is_nan() && message.data[4..] == [0.0, 0.02]);
        let sizes: Vec<_> = message.layout.dim.iter().map(|dim| (dim.size, dim.stride)).collect();
        assert_eq!(sizes, [(2, 6), (3, 3)]);
        let cover = &diagnostics("lab", &sample, Time::default()).status[1];
        assert_eq!((cover.level, cover.values[0].value.as_str()), (ERROR, "1"));
        sample.frame_age_s = -1.0;
        assert!(taxels(&sample).data[2].is_nan(), "no frame yet");
    }

    #[test]
    fn the_wrench_is_in_the_axes_of_the_frame_it_names() {
        let half = std::f64::consts::FRAC_PI_4;
        let sample = Sample {
            flange_wrench_world: [0.0, 5.0, 0.0, 1.0, 0.0, 0.0],
            flange_quaternion_world: [0.0, 0.0, half.sin(), half.cos()],
            ..Sample::default()
        };
        let WrenchStamped { header, wrench } = flange_wrench(&sample, Time::default());
        assert_eq!(header.frame_id, "flange");
        let near =
            |v: Vector3, wanted: [f64; 3]| v.array().iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(near(wrench.force, [5.0, 0.0, 0.0]) && near(wrench.torque, [0.0, -1.0, 0.0]));
    }

    #[test]
    fn a_fault_is_an_error_with_its_code_and_what_to_do() {
        let sample =
            Sample { fault: Some(Fault::BaseStale), mode: Mode::ProtectiveStop, ..Sample::default() };
        let robot = &diagnostics("lab", &sample, Time::default()).status[0];
        assert_eq!((robot.level, robot.values[0].value.as_str()), (ERROR, "base-stale"));
        assert!(robot.message.contains(Fault::BaseStale.remedy()));
    }
}
