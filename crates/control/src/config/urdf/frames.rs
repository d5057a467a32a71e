//! Frames as a URDF writes them, x, y, z m and roll, pitch, yaw rad (R = Rz·Ry·Rx), composed without touching a number
//! that does not have to change.

use moca_msgs::robot::LinkInertial;
use moca_wbc::nalgebra::{Matrix3, Rotation3, Vector3};

/// Place and axes of a child frame in its parent's.
pub(super) type Origin = [f64; 6];

/// Parent and child are one.
pub(super) const HERE: Origin = [0.0; 6];

fn rotation([_, _, _, roll, pitch, yaw]: &Origin) -> Matrix3<f64> {
    Rotation3::from_euler_angles(*roll, *pitch, *yaw).into_inner()
}

fn position([x, y, z, ..]: &Origin) -> Vector3<f64> {
    Vector3::new(*x, *y, *z)
}

/// Exact to rounding at every pitch: roll is found in the axes that yaw leaves.
fn origin(position: &Vector3<f64>, r: &Matrix3<f64>) -> Origin {
    let upright = r[(0, 0)].hypot(r[(1, 0)]) < 1e-12;
    let yaw = if upright { 0.0 } else { r[(1, 0)].atan2(r[(0, 0)]) };
    let (sin, cos) = yaw.sin_cos();
    let pitch = (-r[(2, 0)]).atan2(cos * r[(0, 0)] + sin * r[(1, 0)]);
    let roll = (sin * r[(0, 2)] - cos * r[(1, 2)]).atan2(cos * r[(1, 1)] - sin * r[(0, 1)]);
    [position.x, position.y, position.z, roll, pitch, yaw]
}

/// `child`, given in `parent`'s frame, in the frame that `parent` is given in.
pub(super) fn then(parent: &Origin, child: &Origin) -> Origin {
    if *parent == HERE {
        return *child;
    }
    if *child == HERE {
        return *parent;
    }
    let turn = rotation(parent);
    origin(&(position(parent) + turn * position(child)), &(turn * rotation(child)))
}

/// The parent seen from the child.
pub(super) fn inverse(child: &Origin) -> Origin {
    if *child == HERE {
        return HERE;
    }
    let back = rotation(child).transpose();
    origin(&(back * -position(child)), &back)
}

/// The turn that brings z to a unit `axis`.
pub(super) fn z_to(axis: &[f64; 3]) -> Origin {
    let [x, y, z] = *axis;
    if x == 0.0 && y == 0.0 && z > 0.0 {
        return HERE;
    }
    [0.0, 0.0, 0.0, (-y).atan2(x.hypot(z)), x.atan2(z), 0.0]
}

/// A turn by `angle_rad` about a unit `axis`.
pub(super) fn turned_about(axis: &[f64; 3], angle_rad: f64) -> Origin {
    if angle_rad == 0.0 {
        return HERE;
    }
    let to_axis = z_to(axis);
    then(&then(&to_axis, &[0.0, 0.0, 0.0, 0.0, 0.0, angle_rad]), &inverse(&to_axis))
}

/// A point, given in the frame `at`, in the frame that `at` is given in, m.
pub(super) fn moved(point: &[f64; 3], at: &Origin) -> [f64; 3] {
    (position(at) + rotation(at) * Vector3::from(*point)).into()
}

/// `body`, given in the frame `at`, in the frame that `at` is given in.
pub(super) fn placed(body: &LinkInertial, at: &Origin) -> LinkInertial {
    if *at == HERE {
        return *body;
    }
    let turn = rotation(at);
    let turned = turn * matrix(&body.inertia_com) * turn.transpose();
    LinkInertial {
        mass_kg: body.mass_kg,
        com_m: (position(at) + turn * Vector3::from(body.com_m)).into(),
        inertia_com: [
            turned[(0, 0)],
            turned[(0, 1)],
            turned[(0, 2)],
            turned[(1, 1)],
            turned[(1, 2)],
            turned[(2, 2)],
        ],
    }
}

pub(super) fn matrix([xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> Matrix3<f64> {
    Matrix3::new(*xx, *xy, *xz, *xy, *yy, *yz, *xz, *yz, *zz)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_back_at_every_pitch_and_every_axis_is_reached() {
        let angles = [-3.0, -std::f64::consts::FRAC_PI_2, -1e-9, 0.0, 0.4, std::f64::consts::FRAC_PI_2, 3.1];
        for (roll, pitch, yaw) in angles
            .into_iter()
            .flat_map(|r| angles.into_iter().flat_map(move |p| angles.into_iter().map(move |y| (r, p, y))))
        {
            let given = [0.1, -0.2, 0.3, roll, pitch, yaw];
            let back = origin(&position(&given), &rotation(&given));
            assert!((rotation(&back) - rotation(&given)).amax() < 4e-15, "{given:?} {back:?}");
            let here = then(&given, &inverse(&given));
            assert!((rotation(&here) - Matrix3::identity()).amax() < 4e-15 && position(&here).amax() < 4e-15);
            let axis: Vector3<f64> = rotation(&given).column(2).into();
            let reached = rotation(&z_to(&axis.into())) * Vector3::z();
            assert!((reached - axis).amax() < 4e-15, "{axis:?}");
        }
    }
}
