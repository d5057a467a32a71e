//! Capsules around the `<collision>` shapes of a URDF.

use super::chain::Part;
use super::document::{Shape, model, shapes};
use super::frames::{moved, then};
use super::text;
use moca_msgs::robot::LinkCapsule;
use moca_wbc::nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Largest mesh file, bytes.
const MESH_MAX: u64 = 64 << 20;
/// Points on each rim of a cylinder.
const RIM: u32 = 48;
/// Distance by which a capsule may stand out of another one that replaces it, m.
const INSIDE_M: f64 = 1e-6;

/// Capsules around the shapes of every part of an arm; one that lies inside another one is left out. Meshes are looked for from
/// `folder` on.
///
/// # Errors
/// The first mistake in a shape, with its line, link and what to do.
pub fn capsules(text: &str, parts: &[Part], folder: &Path) -> Result<Vec<LinkCapsule>, String> {
    let text = text::prepared(text)?;
    let document = text::parse(&text)?;
    let model = model(&document)?;
    let mut found: Vec<LinkCapsule> = Vec::new();
    for part in parts {
        let Some(link) = model.links.get(part.link.as_str()) else { continue };
        for (origin, shape) in shapes(*link, &part.link)? {
            let at = then(&part.at, &origin);
            let points: Vec<Vector3<f64>> = match &shape {
                Shape::Sphere { radius_m } => {
                    found.push(LinkCapsule {
                        link: part.body,
                        ends_m: [moved(&[0.0; 3], &at); 2],
                        radius_m: *radius_m,
                    });
                    continue;
                }
                Shape::Cylinder { radius_m, length_m } => rims(*radius_m, *length_m),
                Shape::Box { size_m } => corners(size_m),
                Shape::Mesh { file, scale } => {
                    let mesh = mesh(file, folder).map_err(|why| {
                        format!(
                            "link \"{}\": <mesh filename=\"{file}\">: {why}; correct it, or write a cylinder, box or sphere, or set \
                             arm.capsule_link and what goes with it",
                            part.link
                        )
                    })?;
                    mesh.into_iter().map(|v| v.component_mul(&Vector3::from(*scale))).collect()
                }
            };
            let ([from, to], radius_m) = around(&points);
            found.push(LinkCapsule {
                link: part.body,
                ends_m: [from, to].map(|end| moved(&end.into(), &at)),
                radius_m,
            });
        }
    }
    let inside = |inner: &LinkCapsule, outer: &LinkCapsule| {
        inner.link == outer.link
            && inner.ends_m.iter().all(|end| beyond(end, outer) + inner.radius_m <= outer.radius_m + INSIDE_M)
    };
    let mut kept: Vec<LinkCapsule> = Vec::new();
    for (i, capsule) in found.iter().enumerate() {
        let later = found[i + 1..].iter().any(|other| inside(capsule, other) && !inside(other, capsule));
        if !later && !kept.iter().any(|other| inside(capsule, other)) {
            kept.push(*capsule);
        }
    }
    Ok(kept)
}

/// Distance of a point from a capsule's axis, m.
fn beyond(point: &[f64; 3], capsule: &LinkCapsule) -> f64 {
    let [from, to] = capsule.ends_m.map(Vector3::from);
    let (along, point) = (to - from, Vector3::from(*point));
    let share = if along == Vector3::zeros() {
        0.0
    } else {
        ((point - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0)
    };
    (point - from - along * share).norm()
}

/// Both rims of a cylinder along z, on a circle so much larger that the polygon holds the true one.
fn rims(radius_m: f64, length_m: f64) -> Vec<Vector3<f64>> {
    let radius_m = radius_m / (0.5 * TAU / f64::from(RIM)).cos();
    let rim = |z: f64| {
        (0..RIM).map(move |i| {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(RIM)).sin_cos();
            Vector3::new(radius_m * cos, radius_m * sin, z)
        })
    };
    rim(-0.5 * length_m).chain(rim(0.5 * length_m)).collect()
}

fn corners([x, y, z]: &[f64; 3]) -> Vec<Vector3<f64>> {
    let signs = [-0.5, 0.5];
    let corner = |a| {
        signs.into_iter().flat_map(move |b| signs.into_iter().map(move |c| Vector3::new(a * x, b * y, c * z)))
    };
    signs.into_iter().flat_map(corner).collect()
}

/// The smallest capsule around points among those along their principal axes and along x, y and z: both ends and the radius, m.
fn around(points: &[Vector3<f64>]) -> ([Vector3<f64>; 2], f64) {
    #[expect(clippy::cast_precision_loss, reason = "a count of points")]
    let count = points.len().max(1) as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let principal = spread.symmetric_eigen().eigenvectors;
    let axes = [principal, Matrix3::identity()];
    let candidates = axes.iter().flat_map(|axes| (0..3).map(|i| along(points, &axes.column(i).into_owned())));
    let volume = |([from, to], radius): &([Vector3<f64>; 2], f64)| {
        radius.powi(2) * ((to - from).norm() + 4.0 / 3.0 * radius)
    };
    candidates.min_by(|a, b| volume(a).total_cmp(&volume(b))).unwrap_or(([mean; 2], 0.0))
}

/// The capsule around points with its axis along the unit vector `axis`.
fn along(points: &[Vector3<f64>], axis: &Vector3<f64>) -> ([Vector3<f64>; 2], f64) {
    let side = if axis.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let across = axis.cross(&side).normalize();
    let other = axis.cross(&across);
    let extent = |direction: &Vector3<f64>| {
        let ends = (f64::INFINITY, f64::NEG_INFINITY);
        points.iter().map(|p| p.dot(direction)).fold(ends, |(low, high), v| (low.min(v), high.max(v)))
    };
    let middle = |(low, high): (f64, f64)| 0.5 * (low + high);
    let centre = across * middle(extent(&across)) + other * middle(extent(&other));
    let from_axis = |p: &Vector3<f64>| {
        let off = p - centre;
        (off - axis * off.dot(axis)).norm()
    };
    let radius = points.iter().map(from_axis).fold(0.0, f64::max);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for point in points {
        // the round end reaches so far beyond the end of the axis
        let reach = (radius.powi(2) - from_axis(point).powi(2)).max(0.0).sqrt();
        low = low.min(point.dot(axis) + reach);
        high = high.max(point.dot(axis) - reach);
    }
    if low > high {
        (low, high) = (middle((low, high)), middle((low, high)));
    }
    ([centre + axis * low, centre + axis * high], radius)
}

/// Corners of a mesh, m.
fn mesh(file: &str, folder: &Path) -> Result<Vec<Vector3<f64>>, String> {
    let path = found(file, folder)?;
    let size = std::fs::metadata(&path).map_err(|error| format!("{}: {error}", path.display()))?.len();
    if size > MESH_MAX {
        return Err(format!("{} has {size} bytes; at most {MESH_MAX} are allowed", path.display()));
    }
    let bytes = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let end = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let points = match end.as_str() {
        "stl" => stl(&bytes),
        "obj" => corners_in_text(&bytes, "v"),
        _ => return Err("it is neither STL nor OBJ".into()),
    };
    match points {
        Some(points) if points.len() >= 3 && points.iter().all(|p| p.iter().all(|v| v.is_finite())) => {
            Ok(points)
        }
        _ => Err(format!("{} is no mesh of finite corners", path.display())),
    }
}

/// File of a mesh: as written, or without its package, from `folder` on.
fn found(file: &str, folder: &Path) -> Result<PathBuf, String> {
    let plain = file.strip_prefix("file://").unwrap_or(file);
    let candidates = match plain.strip_prefix("package://") {
        None => vec![folder.join(plain)],
        Some(rest) => {
            let inside = rest.split_once('/').map_or(rest, |(_, inside)| inside);
            vec![folder.join(rest), folder.join(inside)]
        }
    };
    let looked: Vec<String> = candidates.iter().map(|path| path.display().to_string()).collect();
    let there = candidates.into_iter().find(|path| path.is_file());
    there.ok_or_else(|| format!("no file {}", looked.join(" or ")))
}

/// Corners of an STL file, binary or text.
fn stl(bytes: &[u8]) -> Option<Vec<Vector3<f64>>> {
    const HEAD: usize = 84;
    const TRIANGLE: usize = 50;
    let count = bytes.get(80..HEAD).and_then(|count| count.try_into().ok()).map(u32::from_le_bytes);
    let length =
        count.and_then(|count| usize::try_from(count).ok()?.checked_mul(TRIANGLE)?.checked_add(HEAD));
    if length != Some(bytes.len()) {
        return corners_in_text(bytes, "vertex");
    }
    let number = |bytes: &[u8; 4]| f64::from(f32::from_le_bytes(*bytes));
    let triangles = bytes.get(HEAD..)?.chunks_exact(TRIANGLE);
    // a normal of three numbers, then three corners
    let corners = triangles.flat_map(|triangle| triangle.as_chunks::<12>().0.iter().skip(1).take(3));
    corners
        .map(|corner| match corner.as_chunks::<4>().0 {
            [x, y, z] => Some(Vector3::new(number(x), number(y), number(z))),
            _ => None,
        })
        .collect()
}

/// Three numbers after each `word` that begins a line.
fn corners_in_text(bytes: &[u8], word: &str) -> Option<Vec<Vector3<f64>>> {
    let text = std::str::from_utf8(bytes).ok()?;
    let lines = text.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        (words.next() == Some(word)).then_some(words)
    });
    lines
        .map(|words| {
            let numbers: Vec<f64> = words.take(3).map(str::parse).collect::<Result<_, _>>().ok()?;
            let three: [f64; 3] = numbers.try_into().ok()?;
            Some(Vector3::from(three))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use std::fmt::Write as _;

    const MAKERS_UR10E: &str = include_str!("../../../../../examples/robots/ur10e.urdf");

    /// A folder of its own, gone at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("moca-capsules-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&folder).unwrap();
            Self(folder)
        }

        fn write(&self, file: &str, bytes: &[u8]) {
            std::fs::write(self.0.join(file), bytes).unwrap();
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            std::fs::remove_dir_all(&self.0).unwrap();
        }
    }

    /// The capsules of a link with these shapes.
    fn of(folder: &Folder, collisions: &str) -> Result<Vec<LinkCapsule>, String> {
        let text = format!("<robot name=\"r\"><link name=\"a\">{collisions}</link></robot>");
        let part = Part { link: "a".into(), body: 3, at: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0] };
        capsules(&text, &[part], &folder.0)
    }

    fn shape(origin: &str, geometry: &str) -> String {
        format!("<collision><origin xyz=\"{origin}\"/><geometry>{geometry}</geometry></collision>")
    }

    /// Both ends and the radius, the lower end first.
    fn one(found: &Result<Vec<LinkCapsule>, String>) -> ([[f64; 3]; 2], f64) {
        let [capsule] = found.as_deref().unwrap() else { panic!("{found:?}") };
        assert_eq!(capsule.link, 3);
        let [a, b] = capsule.ends_m;
        let turned = (b[2], b[0]) < (a[2], a[0]);
        (if turned { [b, a] } else { [a, b] }, capsule.radius_m)
    }

    fn near(a: [[f64; 3]; 2], b: [[f64; 3]; 2]) -> bool {
        a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-9)
    }

    /// Equality but for the digits that a binary mesh has not.
    fn same_f32(a: &LinkCapsule, b: &LinkCapsule) -> bool {
        let ends = a.ends_m.as_flattened().iter().zip(b.ends_m.as_flattened());
        ends.chain([(&a.radius_m, &b.radius_m)]).all(|(a, b)| (a - b).abs() < f64::from(f32::EPSILON))
    }

    #[test]
    fn every_shape_lies_in_its_capsule() {
        let folder = Folder::new("shapes");
        let sphere = one(&of(&folder, &shape("0.1 0 0", "<sphere radius=\"0.05\"/>")));
        assert!(
            near(sphere.0, [[0.1, 0.0, 1.0]; 2]) && sphere.1.to_bits() == 0.05_f64.to_bits(),
            "{sphere:?}"
        );
        let cylinder = one(&of(&folder, &shape("0 0 0.2", "<cylinder radius=\"0.06\" length=\"0.4\"/>")));
        assert!((0.06..0.0603).contains(&cylinder.1), "{cylinder:?}");
        assert!(
            (cylinder.0[0][2] - 1.0).abs() < 0.004 && (cylinder.0[1][2] - 1.4).abs() < 0.004,
            "{cylinder:?}"
        );
        let long = one(&of(&folder, &shape("0 0 0", "<box size=\"0.6 0.06 0.08\"/>")));
        assert!((long.1 - 0.05).abs() < 1e-9, "half of the diagonal across: {long:?}");
        assert!(near(long.0, [[-0.3, 0.0, 1.0], [0.3, 0.0, 1.0]]), "{long:?}");
    }

    #[test]
    fn capped_cylinder_is_one_capsule() {
        let folder = Folder::new("capped");
        let ball = |z: &str| shape(&format!("0 0 {z}"), "<sphere radius=\"0.06\"/>");
        let shapes = format!(
            "{}{}{}",
            ball("-0.1"),
            shape("0 0 0", "<cylinder radius=\"0.06\" length=\"0.2\"/>"),
            ball("0.1")
        );
        let found = of(&folder, &shapes).unwrap();
        assert!(found.len() <= 3 && !found.is_empty(), "{found:?}");
        let twice = format!("{0}{0}", ball("0"));
        assert_eq!(of(&folder, &twice).unwrap().len(), 1, "one of two that are the same");
    }

    #[test]
    fn mesh_lies_in_its_capsule_however_it_is_written() {
        let folder = Folder::new("mesh");
        // a slanted bar
        let corners: Vec<[f32; 3]> = (0..40)
            .map(|i| [0.01 * i as f32, 0.01 * i as f32 + 0.02 * (i % 2) as f32, 0.02 * (i % 3) as f32])
            .collect();
        let triangles = || corners.windows(3);
        let mut binary = vec![0_u8; 80];
        binary.extend(u32::try_from(triangles().count()).unwrap().to_le_bytes());
        let (mut text, mut obj) = ("solid bar\n".to_owned(), String::new());
        for triangle in triangles() {
            binary.extend([0_u8; 12]);
            text += "facet normal 0 0 1\nouter loop\n";
            for [x, y, z] in triangle {
                [x, y, z].into_iter().for_each(|v| binary.extend(v.to_le_bytes()));
                writeln!(text, "vertex {x} {y} {z}").unwrap();
                writeln!(obj, "v {x} {y} {z}").unwrap();
            }
            binary.extend([0_u8; 2]);
            text += "endloop\nendfacet\n";
        }
        folder.write("binary.stl", &binary);
        folder.write("text.STL", text.as_bytes());
        folder.write("bar.obj", obj.as_bytes());
        let mut all = Vec::new();
        for file in ["binary.stl", "package://maker/text.STL", "bar.obj"] {
            let found = of(&folder, &shape("0 0 0", &format!("<mesh filename=\"{file}\" scale=\"1 1 2\"/>")))
                .unwrap();
            let capsule = found[0];
            for [x, y, z] in &corners {
                let point = [f64::from(*x), f64::from(*y), 1.0 + 2.0 * f64::from(*z)];
                assert!(beyond(&point, &capsule) <= capsule.radius_m + 1e-6, "{file}: {point:?} {capsule:?}");
            }
            assert!(capsule.radius_m < 0.06, "along the bar: {capsule:?}");
            all.push(capsule);
        }
        assert!(all.iter().all(|other| same_f32(other, &all[0])), "{all:?}");
    }

    #[test]
    fn shape_that_cannot_be_read_is_named_with_what_to_do() {
        let folder = Folder::new("wrong");
        folder.write("empty.stl", b"solid\n");
        folder.write("nan.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\n");
        for (collision, said) in [
            (shape("0 0 0", "<mesh filename=\"none.stl\"/>"), "no file "),
            (shape("0 0 0", "<mesh filename=\"empty.stl\"/>"), "is no mesh of finite corners"),
            (shape("0 0 0", "<mesh filename=\"nan.obj\"/>"), "is no mesh of finite corners"),
            (
                shape("0 0 0", "<cylinder radius=\"0\" length=\"1\"/>"),
                "<cylinder radius>: 0 m is outside 0 to 10 m; correct it",
            ),
            (shape("0 0 0", "<sphere/>"), "<collision> without radius; add it"),
            (
                shape("0 0 0", "<cone/>"),
                "<cone> is no shape that is read; write a cylinder, sphere, box or mesh",
            ),
            ("<collision/>".into(), "<collision> without a <geometry>; add it"),
        ] {
            let why = of(&folder, &collision).unwrap_err();
            assert!(why.contains(said) && why.contains("link \"a\""), "{why}");
        }
    }

    /// The UR10e's file with shapes: they are read where a distance is asked for, and given back as lists.
    #[test]
    fn arm_from_a_urdf_keeps_the_distance_of_its_shapes() {
        let folder = Folder::new("arm");
        let upper = "<collision><origin xyz=\"-0.3 0 0.17\" rpy=\"0 1.5707963 0\"/><geometry><cylinder radius=\"0.07\" \
                     length=\"0.7\"/></geometry></collision>";
        let fore = "<collision><geometry><mesh filename=\"none.stl\"/></geometry></collision>";
        let with = |link: &str, shape: &str, text: &str| {
            let from = format!("<link name=\"{link}\">");
            assert!(text.contains(&from), "{link}");
            text.replace(&from, &format!("{from}{shape}"))
        };
        let text = with("upper_arm_link", upper, MAKERS_UR10E);
        folder.write("arm.urdf", text.as_bytes());
        let config = |distance: &str| {
            let file = format!(
                "[robot]\narm = \"own\"\n[arm]\nurdf = \"arm.urdf\"\nbase_link = \"base_link\"\ntip_link = \"tool0\"\nhome_rad = \
                 [0.0, -2.0, 2.0, -1.5707963267948966, -1.5707963267948966, 0.0]\n[control.self_collision]\ndistance_m = {distance}\n"
            );
            folder.write("mocad.toml", file.as_bytes());
            Config::load(&folder.0.join("mocad.toml"))
        };
        let on = config("0.02").unwrap();
        assert_eq!(on.robot.arm.capsules.len(), 1);
        assert_eq!(on.robot.arm.capsules[0].link, 2);
        assert!(on.self_collision::<6>().unwrap().is_some_and(|guard| guard.pairs() == 2), "base and floor");
        let again = Config::parse(&toml::to_string(&on.to_toml()).unwrap()).unwrap();
        assert_eq!(again.robot.arm.capsules, on.robot.arm.capsules);
        let off = config("0.0").unwrap();
        assert!(off.robot.arm.capsules.is_empty() && off.self_collision::<6>().unwrap().is_none());
        folder.write("arm.urdf", with("forearm_link", fore, &text).as_bytes());
        assert!(config("0.0").is_ok(), "shapes are not judged where nothing is done with them");
        let why = config("0.02").unwrap_err().to_string();
        assert!(why.contains("link \"forearm_link\": <mesh filename=\"none.stl\">: no file"), "{why}");
        assert!(why.contains("or set arm.capsule_link"), "{why}");
        folder.write("arm.urdf", MAKERS_UR10E.as_bytes());
        let why = config("0.02").unwrap_err().to_string();
        assert!(
            why.contains(
                "needs capsules, and robot.arm = \"own\" has none; give arm.urdf with <collision> shapes"
            ),
            "{why}"
        );
    }
}
