//! A change of one parameter while the loop runs.

use crate::robot::JOINTS;
use moca_msgs::params::{CONTROLLER, Size};
use moca_msgs::{ParameterValues, Parameters, Refusal};

/// `parameters` of an arm with `joints` joints with other values of the parameter of this number in [`CONTROLLER`].
///
/// # Errors
/// No such parameter, not live, or out of range.
pub fn changed(
    parameters: &Parameters<JOINTS>,
    joints: usize,
    number: usize,
    values: &ParameterValues,
) -> Result<Parameters<JOINTS>, Refusal> {
    let spec = CONTROLLER.get(number).ok_or(Refusal::NoSuchParameter)?;
    if !spec.live {
        return Err(Refusal::NotLive);
    }
    let mut elements = [0.0; JOINTS];
    let values = match (spec.size, values.as_slice()) {
        (Size::Joints, values) if values.len() == joints => {
            elements[..values.len()].copy_from_slice(values);
            &elements[..]
        }
        (Size::Joints, _) => return Err(Refusal::OutOfRange),
        (_, values) => values,
    };
    let mut wanted = *parameters;
    wanted.set(number, &ParameterValues::new(values).ok_or(Refusal::OutOfRange)?)?;
    Ok(wanted)
}
