//! A camera that orbits about a point of the world, with perspective. World axes: x forward, y left, z up.

use crate::logic::limited::Limited;

/// Distance of the picture plane in half heights of the picture: a field of view of 40 degrees.
const FOCAL: f64 = 2.747;
/// Nearest and farthest, m.
const DISTANCE_M: (f64, f64) = (0.8, 12.0);
/// Lowest and highest angle above the floor, rad.
const ELEVATION_RAD: (f64, f64) = (0.05, std::f64::consts::FRAC_PI_2);

/// Pose of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrbitCamera {
    /// Angle about z: 0 looks along x, from behind the robot, rad.
    pub azimuth_rad: f64,
    /// Angle above the floor; a quarter turn looks straight down, rad.
    pub elevation_rad: f64,
    /// From the point it looks at, m.
    pub distance_m: f64,
}

impl Default for OrbitCamera {
    fn default() -> Self {
        Self { azimuth_rad: -2.4, elevation_rad: 0.5, distance_m: 2.8 }
    }
}

impl OrbitCamera {
    /// Straight down, x up: the picture beside it, in perspective.
    pub const TOP: Self =
        Self { azimuth_rad: 0.0, elevation_rad: std::f64::consts::FRAC_PI_2, distance_m: 3.6 };
    /// From the right side.
    pub const SIDE: Self =
        Self { azimuth_rad: std::f64::consts::FRAC_PI_2, elevation_rad: 0.12, distance_m: 2.8 };

    /// Turns it, rad; what is not finite does nothing.
    pub fn orbit(&mut self, azimuth_rad: f64, elevation_rad: f64) {
        if azimuth_rad.is_finite() && elevation_rad.is_finite() {
            self.azimuth_rad = (self.azimuth_rad + azimuth_rad).rem_euclid(std::f64::consts::TAU);
            self.elevation_rad =
                (self.elevation_rad + elevation_rad).limited(ELEVATION_RAD.0, ELEVATION_RAD.1);
        }
    }

    /// Moves it away by `factor`.
    pub fn zoom(&mut self, factor: f64) {
        if factor.is_finite() {
            self.distance_m = (self.distance_m * factor).limited(DISTANCE_M.0, DISTANCE_M.1);
        }
    }

    /// The camera as it looks at `target`, a point of the world, m.
    pub fn looking_at(self, target: [f64; 3]) -> Projection {
        let ((sa, ca), (se, ce)) = (self.azimuth_rad.sin_cos(), self.elevation_rad.sin_cos());
        Projection {
            target,
            right: [sa, -ca, 0.0],
            up: [se * ca, se * sa, ce],
            forward: [ce * ca, ce * sa, -se],
            distance_m: self.distance_m,
        }
    }
}

/// From points of the world to points of the picture.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    target: [f64; 3],
    right: [f64; 3],
    up: [f64; 3],
    forward: [f64; 3],
    distance_m: f64,
}

/// A point of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projected {
    /// To the right of the middle, half heights of the picture.
    pub x: f64,
    /// Above the middle, half heights.
    pub y: f64,
    /// Distance along the view, m.
    pub depth_m: f64,
}

impl Projection {
    /// Returns the place of a point of the world in the picture; `None` for one behind the camera or not finite.
    pub fn project(&self, point: [f64; 3]) -> Option<Projected> {
        let from_target = difference(point, self.target);
        let depth_m = dot(self.forward, from_target) + self.distance_m;
        let scale = FOCAL / depth_m;
        let (x, y) = (dot(self.right, from_target) * scale, dot(self.up, from_target) * scale);
        (depth_m > 0.1 && x.is_finite() && y.is_finite()).then_some(Projected { x, y, depth_m })
    }

    /// Half heights of the picture that a metre at `depth_m` is long.
    pub fn scale(&self, depth_m: f64) -> f64 {
        FOCAL / depth_m
    }

    /// Returns true if a surface at `point` with outward `normal` shows its front.
    pub fn faces(&self, point: [f64; 3], normal: [f64; 3]) -> bool {
        let from_target = difference(point, self.target);
        let view: [f64; 3] = std::array::from_fn(|i| from_target[i] + self.forward[i] * self.distance_m);
        dot(view, normal) < 0.0
    }
}

fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_above_x_is_up_y_is_left_and_a_metre_has_its_length() {
        let view = OrbitCamera::TOP.looking_at([2.0, 1.0, 0.0]);
        let at = |point| view.project(point).unwrap();
        assert!((at([2.0, 1.0, 0.0]).depth_m - 3.6).abs() < 1e-9);
        let (ahead, left) = (at([3.0, 1.0, 0.0]), at([2.0, 2.0, 0.0]));
        assert!(ahead.x.abs() < 1e-9 && (ahead.y - view.scale(3.6)).abs() < 1e-9, "{ahead:?}");
        assert!(left.y.abs() < 1e-9 && (left.x + view.scale(3.6)).abs() < 1e-9, "{left:?}");
        assert!(
            view.faces([2.0, 1.0, 0.5], [0.0, 0.0, 1.0]) && !view.faces([2.0, 1.0, 0.5], [0.0, 0.0, -1.0])
        );
    }

    #[test]
    fn what_is_near_is_large_and_what_is_behind_is_not_drawn() {
        let camera = OrbitCamera { azimuth_rad: 0.0, elevation_rad: 0.05, distance_m: 2.0 };
        let view = camera.looking_at([0.0; 3]);
        let width = |x: f64| view.project([x, 0.0, 0.0]).zip(view.project([x, -1.0, 0.0]));
        let (near, far) = (width(-1.0).unwrap(), width(1.0).unwrap());
        assert!(near.1.x - near.0.x > 2.0 * (far.1.x - far.0.x));
        assert_eq!(view.project([-3.0, 0.0, 0.0]), None);
        assert_eq!(view.project([f64::NAN, 0.0, 0.0]), None);
    }

    #[test]
    fn it_neither_dives_under_the_floor_nor_turns_over_nor_leaves() {
        let mut camera = OrbitCamera::default();
        camera.orbit(f64::NAN, 0.0);
        assert_eq!(camera, OrbitCamera::default());
        camera.orbit(100.0, 9.0);
        assert!(
            camera.elevation_rad <= ELEVATION_RAD.1
                && (0.0..std::f64::consts::TAU).contains(&camera.azimuth_rad)
        );
        camera.orbit(0.0, -9.0);
        assert!(camera.elevation_rad >= ELEVATION_RAD.0);
        camera.zoom(0.0);
        assert!(camera.distance_m >= DISTANCE_M.0);
        camera.zoom(1e9);
        assert!(camera.distance_m <= DISTANCE_M.1);
    }
}
