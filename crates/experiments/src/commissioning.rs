//! Commissioning of a simulated robot: its stopping distance, by the ladder of [`moca_control::stopping`].

use anyhow::Result;
use moca_control::config::Config;
use moca_control::stopping;
use moca_lockstep::simulated_robot;
use moca_sim::Scene;

/// Lets `config` believe what the ladder measures of the base of `scene`.
///
/// # Errors
/// A scene that cannot be built, and a base that does not go as it is told.
pub fn commission(config: &mut Config, scene: &Scene) -> Result<()> {
    let stops = simulated_robot::stops(config, scene)?;
    stopping::believe(config, &stops, format!("simulated, {} speeds", stops.len()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use moca_msgs::Law;

    fn believed(assignments: &[&str]) -> Config {
        let mut settings = Settings::paper(Law::Impedance);
        settings.set_all(assignments).unwrap();
        let scene = settings.free_scene();
        commission(&mut settings.config, &scene).unwrap();
        settings.check().unwrap();
        settings.config
    }

    #[test]
    fn commissioning_finds_delay_of_simulated_base() {
        for (delay_ms, assignment) in
            [(0.0, "true.base.order_delay_ms=0"), (50.0, "true.base.order_delay_ms=50")]
        {
            let p = believed(&[assignment]).protection;
            println!(
                "{assignment}: {:.2} ± {:.2} ms, {:?}",
                p.order_delay_ms, p.order_delay_error_ms, p.stopping_distance_m
            );
            assert!((p.order_delay_ms - delay_ms).abs() < 3.0, "{} of {delay_ms} ms", p.order_delay_ms);
        }
        let plain = believed(&[]).protection;
        let weak = believed(&[
            "true.base.deceleration=1",
            "true.base.order_jitter_ms=10",
            "true.base.order_period_ms=20",
        ]);
        let longer = |i: usize| weak.protection.stopping_distance_m[i] / plain.stopping_distance_m[i];
        assert!(longer(5) > 1.3, "{}", longer(5));
    }
}
