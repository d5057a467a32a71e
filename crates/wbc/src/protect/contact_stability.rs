//! Safety of a cover: stability of the contact between a body and a base that gives way by eq. (2), and the speed that such
//! a base may have.
//!
//! One-dimensional contact: stiffness k, damping d, reading delayed by T, base servo of first order with time constant
//! τ. The loop closes as (M s + D)(1 + τ s) + (k/s + d)·e^(−sT) = 0. With d = 0 and τ = 0 its boundary is
//! D/(kT) = sin u/u, M/(kT²) = cos u/u², u = ωT. Two limits to remember: a heavy virtual mass needs D > k(T + τ) − d,
//! a massless one D > (2/π)·kT; and D = 0 is never stable with a delay.
//!
//! Analysis, not control: f64 only, and every search takes a fixed number of steps.
//!
//! ```
//! use moca_wbc::contact_stability::{Contact, largest_speed, least_damping, reading_delay_s};
//!
//! // a leg on the cover, read every 24.7 ms and 20 ms old, under a servo of 15 ms
//! let delay_s = reading_delay_s(0.020, 0.0247, 1e-3);
//! let contact = Contact { stiffness_n_m: 8000.0, damping_n_s_m: 0.0, delay_s, servo_s: 0.015 };
//! assert!(least_damping(4.0, &contact)? > 80.0, "the paper's 80 N·s/m would chatter");
//! assert!(largest_speed(25.0, 7.1e-3, 3.0, &contact)? < 0.06, "m/s");
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use moca_msgs::{ParameterError, TaxelPlacement};
#[allow(unused_imports, reason = "where std is linked, f64 has these methods by itself")]
use nalgebra::ComplexField as _;

/// A contact as the base's loop sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Stiffness of cover and body in series, N/m, > 0.
    pub stiffness_n_m: f64,
    /// Damping of the same, N·s/m, ≥ 0.
    pub damping_n_s_m: f64,
    /// From a force to the command it changes, s, ≥ 0; see [`reading_delay_s`].
    pub delay_s: f64,
    /// Time constant of the base's velocity servo, s, ≥ 0.
    pub servo_s: f64,
}

/// Distance of a contact from oscillation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// True if the contact settles.
    pub stable: bool,
    /// Frequency at which it would oscillate, rad/s; 0 where the loop's gain never falls below 1.
    pub crossover_rad_s: f64,
    /// Phase left at that frequency, rad; negative if unstable.
    pub phase_rad: f64,
    /// Extra delay that the contact would bear, s; negative if unstable.
    pub delay_s: f64,
}

/// Steps of a bisection: more than a double has bits.
const BISECTIONS: u32 = 100;

/// Margin of a base of virtual `mass` (kg, ≥ 0) and `damping` (N·s/m, ≥ 0) in `contact`.
///
/// The loop's gain falls monotonically with frequency, so it is stable exactly if its phase is above −π where the gain
/// is 1.
///
/// # Errors
/// The first number that is not finite or out of range.
pub fn margin(mass: f64, damping: f64, contact: &Contact) -> Result<Margin, ParameterError> {
    contact.check()?;
    within("virtual mass", "kg", mass, 0.0, 1e6)?;
    within("virtual damping", "N·s/m", damping, 0.0, 1e9)?;
    let Some(crossover) = crossover(mass, damping, contact) else {
        // gain above 1 at every frequency: any delay at all turns the phase past −π
        let phase =
            if contact.delay_s > 0.0 { f64::NEG_INFINITY } else { phase(1e9, mass, damping, contact) };
        return Ok(Margin {
            stable: phase > 0.0,
            crossover_rad_s: 0.0,
            phase_rad: phase,
            delay_s: phase / 1e9,
        });
    };
    let phase = phase(crossover, mass, damping, contact);
    Ok(Margin {
        stable: phase > 0.0,
        crossover_rad_s: crossover,
        phase_rad: phase,
        delay_s: phase / crossover,
    })
}

/// Least virtual damping, N·s/m, with which a base of virtual `mass` (kg) is stable in `contact`.
///
/// # Errors
/// The first number that is not finite or out of range.
pub fn least_damping(mass: f64, contact: &Contact) -> Result<f64, ParameterError> {
    let stable = |damping: f64| margin(mass, damping, contact).map(|margin| margin.stable);
    if stable(0.0)? {
        return Ok(0.0);
    }
    // k(T + τ) + d is enough for any mass: double it until rounding agrees
    let mut high = contact.stiffness_n_m * (contact.delay_s + contact.servo_s) + contact.damping_n_s_m + 1e-9;
    for _ in 0..20 {
        if stable(high)? {
            break;
        }
        high *= 2.0;
    }
    let mut low = 0.0;
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if stable(middle)? {
            high = middle;
        } else {
            low = middle;
        }
    }
    Ok(high)
}

/// Virtual mass (kg) and damping (N·s/m) that oscillate for ever at `frequency` rad/s > 0 in `contact`: the boundary of
/// stability, traced by the frequency.
///
/// # Errors
/// The first number that is not finite or out of range.
pub fn boundary(frequency: f64, contact: &Contact) -> Result<(f64, f64), ParameterError> {
    contact.check()?;
    within("frequency", "rad/s", frequency, 1e-9, 1e9)?;
    let Contact { stiffness_n_m: k, damping_n_s_m: d, delay_s, servo_s } = *contact;
    let w = frequency;
    let (sine, cosine) = (w * delay_s).sin_cos();
    let (real, imaginary) = (k / w * sine - d * cosine, k / w * cosine + d * sine);
    let damping = (real + servo_s * w * imaginary) / (1.0 + (servo_s * w).powi(2));
    Ok((imaginary / w - servo_s * damping, damping))
}

/// Returns the part of a planar virtual mass or damping (x, y, yaw) that a push on a taxel meets. The base gives way along the
/// taxel's direction and turns by its lever arm, 1/M_eff = u_x²/M_x + u_y²/M_y + l²/I.
pub fn at_taxel(planar: &[f64; 3], taxel: &TaxelPlacement) -> f64 {
    let [x, y] = taxel.position_base_m;
    let (uy, ux) = taxel.inward_angle_base_rad.sin_cos();
    let lever = x * uy - y * ux;
    1.0 / (ux * ux / planar[0] + uy * uy / planar[1] + lever * lever / planar[2])
}

/// Delay of a reading that is sampled every `period_s`, held, and `age_s` old when it arrives, in a loop of `tick_s`: a
/// held reading counts as its period less one tick, s.
pub fn reading_delay_s(age_s: f64, period_s: f64, tick_s: f64) -> f64 {
    age_s + (period_s - tick_s).max(0.0)
}

/// Largest speed, m/s, at which a small contact force stays under `force_n`: v = F/(k(T + τ)).
///
/// # Errors
/// The first number that is not finite or out of range.
pub fn speed_for_force(force_n: f64, contact: &Contact) -> Result<f64, ParameterError> {
    contact.check()?;
    within("force limit", "N", force_n, 0.0, 1e6)?;
    Ok(force_n / (contact.stiffness_n_m * (contact.delay_s + contact.servo_s)))
}

/// Largest speed, m/s, from which the base stops within `travel_m`, the way that cover and body yield up to the force
/// limit: the command falls to zero with `deceleration` m/s² one `delay_s` after the touch and the servo follows, in
/// v(T + τ) + v²/(2a).
///
/// # Errors
/// The first number that is not finite or out of range.
pub fn speed_for_stopping(
    travel_m: f64,
    deceleration: f64,
    contact: &Contact,
) -> Result<f64, ParameterError> {
    contact.check()?;
    within("travel", "m", travel_m, 0.0, 10.0)?;
    within("deceleration", "m/s²", deceleration, 1e-3, 1e6)?;
    let lag = contact.delay_s + contact.servo_s;
    // a(√(lag² + 2d/a) − lag), in the form that does not cancel
    Ok(2.0 * travel_m / (lag + (lag * lag + 2.0 * travel_m / deceleration).sqrt()))
}

/// Largest speed, m/s, at which a contact stays under `force_n`: the smaller of [`speed_for_force`] and
/// [`speed_for_stopping`].
///
/// # Errors
/// The first number that is not finite or out of range.
pub fn largest_speed(
    force_n: f64,
    travel_m: f64,
    deceleration: f64,
    contact: &Contact,
) -> Result<f64, ParameterError> {
    let small = speed_for_force(force_n, contact)?;
    Ok(small.min(speed_for_stopping(travel_m, deceleration, contact)?))
}

impl Contact {
    fn check(&self) -> Result<(), ParameterError> {
        within("contact stiffness", "N/m", self.stiffness_n_m, 1e-3, 1e9)?;
        within("contact damping", "N·s/m", self.damping_n_s_m, 0.0, 1e9)?;
        within("delay", "s", self.delay_s, 0.0, 10.0)?;
        within("servo time constant", "s", self.servo_s, 0.0, 10.0)
    }
}

fn within(
    name: &'static str,
    unit: &'static str,
    value: f64,
    min: f64,
    max: f64,
) -> Result<(), ParameterError> {
    if value >= min && value <= max { Ok(()) } else { Err(ParameterError { name, value, unit, min, max }) }
}

/// Square of the loop's gain at `w`.
fn gain_squared(w: f64, mass: f64, damping: f64, contact: &Contact) -> f64 {
    let Contact { stiffness_n_m: k, damping_n_s_m: d, servo_s, .. } = *contact;
    let contact_gain = (k / w).powi(2) + d * d;
    contact_gain / (((mass * w).powi(2) + damping * damping) * (1.0 + (servo_s * w).powi(2)))
}

/// π plus the loop's phase at `w`, rad.
fn phase(w: f64, mass: f64, damping: f64, contact: &Contact) -> f64 {
    let Contact { stiffness_n_m: k, damping_n_s_m: d, delay_s, servo_s } = *contact;
    core::f64::consts::FRAC_PI_2 + (d * w / k).atan()
        - w * delay_s
        - nalgebra::RealField::atan2(mass * w, damping)
        - (servo_s * w).atan()
}

/// Frequency at which the loop's gain is 1, by bisection on a logarithmic scale; `None` if it is above 1 everywhere.
fn crossover(mass: f64, damping: f64, contact: &Contact) -> Option<f64> {
    let (mut low, mut high) = (1e-9_f64, 1e9_f64);
    if gain_squared(high, mass, damping, contact) >= 1.0 {
        return None;
    }
    for _ in 0..BISECTIONS {
        let middle = (low * high).sqrt();
        if gain_squared(middle, mass, damping, contact) > 1.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;
    use moca_msgs::robot::PAPER_COVER;

    const BARE: Contact = Contact { stiffness_n_m: 8000.0, damping_n_s_m: 0.0, delay_s: 0.012, servo_s: 0.0 };

    #[test]
    fn boundary_without_servo_is_sin_u_over_u() {
        let (k, delay) = (BARE.stiffness_n_m, BARE.delay_s);
        for step in 1..31 {
            let u = 0.05 * f64::from(step);
            let (mass, damping) = (k * delay * delay * u.cos() / (u * u), k * delay * u.sin() / u);
            let (m, d) = boundary(u / delay, &BARE).unwrap();
            assert!((m / mass - 1.0).abs() < 1e-12 && (d / damping - 1.0).abs() < 1e-12);
            let on = margin(mass, damping, &BARE).unwrap();
            assert!(on.phase_rad.abs() < 1e-9, "u = {u}: {on:?}");
            assert!((on.crossover_rad_s * delay / u - 1.0).abs() < 1e-9);
            assert!(margin(mass, 1.001 * damping, &BARE).unwrap().stable, "u = {u}");
            assert!(!margin(mass, 0.999 * damping, &BARE).unwrap().stable, "u = {u}");
            assert!((least_damping(mass, &BARE).unwrap() / damping - 1.0).abs() < 1e-6, "u = {u}");
        }
    }

    #[test]
    fn boundary_with_servo_and_damping_has_no_margin() {
        let contact = Contact { damping_n_s_m: 15.0, servo_s: 0.015, ..BARE };
        for w in [5.0, 20.0, 40.0, 60.0] {
            let (mass, damping) = boundary(w, &contact).unwrap();
            let on = margin(mass, damping, &contact).unwrap();
            assert!(
                mass > 0.0 && damping > 0.0 && on.phase_rad.abs() < 1e-9,
                "{w} rad/s: {mass} {damping} {on:?}"
            );
        }
    }

    #[test]
    fn heavy_and_massless_bases_need_the_damping_of_the_two_limits() {
        let contact = Contact { damping_n_s_m: 10.0, servo_s: 0.015, ..BARE };
        let heavy = contact.stiffness_n_m * (contact.delay_s + contact.servo_s) - contact.damping_n_s_m;
        assert!((least_damping(1e5, &contact).unwrap() / heavy - 1.0).abs() < 1e-2);
        let massless = 2.0 / PI * BARE.stiffness_n_m * BARE.delay_s;
        assert!((least_damping(0.0, &BARE).unwrap() / massless - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_base_without_damping_is_never_stable_with_a_delay() {
        for mass in [0.0, 0.01, 4.0, 1000.0] {
            assert!(!margin(mass, 0.0, &BARE).unwrap().stable, "{mass} kg");
        }
    }

    #[test]
    fn a_corner_taxel_is_lighter_than_one_in_the_middle() {
        let mass = [4.0, 4.0, 2.0];
        assert!((at_taxel(&mass, &PAPER_COVER[5]) - 4.0).abs() < 1e-12);
        let corner = 1.0 / (1.0 / 4.0 + 0.36675 * 0.36675 / 2.0);
        assert!((at_taxel(&mass, &PAPER_COVER[0]) - corner).abs() < 1e-12);
    }

    /// One-dimensional simulation of full braking on the collision foam: 7.13 mm of foam and person up to 25 N.
    #[test]
    fn stopping_speeds_agree_with_simulation() {
        let table = [(3.0, [0.169, 0.146, 0.118, 0.082]), (8.0, [0.253, 0.206, 0.152, 0.094])];
        for (deceleration, speeds) in table {
            for (delay_s, simulated) in [0.0, 0.010, 0.025, 0.055].into_iter().zip(speeds) {
                let contact = Contact { delay_s, servo_s: 0.015, ..BARE };
                let speed = speed_for_stopping(7.13e-3, deceleration, &contact).unwrap();
                assert!(
                    (speed / simulated - 1.0).abs() < 0.07,
                    "{deceleration} {delay_s}: {speed} {simulated}"
                );
            }
        }
    }

    #[test]
    fn a_held_reading_is_late_by_its_period_less_a_tick() {
        assert!((reading_delay_s(0.020, 0.0247, 0.001) - 0.0437).abs() < 1e-12);
        let v = speed_for_force(25.0, &Contact { servo_s: 0.015, ..BARE }).unwrap();
        assert!((v - 25.0 / (8000.0 * 0.027)).abs() < 1e-12);
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(margin(bad, 80.0, &BARE).is_err() && margin(4.0, bad, &BARE).is_err());
            let contact = Contact { delay_s: bad, ..BARE };
            assert_eq!(margin(4.0, 80.0, &contact).unwrap_err().name, "delay");
        }
    }
}
