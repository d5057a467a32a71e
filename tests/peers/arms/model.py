"""Arms in URDF files, as this script finds them and as Pinocchio computes them."""

import copy
import dataclasses
import functools
import pathlib
import re
import xml.etree.ElementTree as xml

import numpy as np
import pinocchio

TURNS = ("revolute", "continuous")
NOT_OF_AN_ARM = re.compile(
    r"leg|hip|knee|ankle|foot|toe|wheel|thigh|shank|calf|finger|thumb|index_|middle_|ring_|little_", re.IGNORECASE
)
POSTURES = 8
JOINT = "joint of "
# Share of its largest torque with which a motor carries the arm at home.
CARRIED = 0.7
# Bodies where a file has none that can be: as heavy as this at the first joint, each next one as much lighter; solid balls.
BODY_KG, LIGHTER, BALL_M, LEAST_BALL_M = 4.0, 0.7, 0.06, 0.02


def document(path: pathlib.Path) -> xml.Element | None:
    """As lenient as readers of URDFs are: no namespaces, no blank before the declaration."""
    text = path.read_text(errors="replace").lstrip("\ufeff \t\r\n")
    text = re.sub(r"<(/?)[A-Za-z_][\w.-]*:([\w.-]+)", r"<\1other_\2", text)
    text = re.sub(r"\s(?!xmlns)[A-Za-z_][\w.-]*:([\w.-]+)=", r" other_\1=", text)
    try:
        return xml.fromstring(text)
    except xml.ParseError:
        return None


@dataclasses.dataclass(frozen=True)
class Arm:
    path: pathlib.Path
    short: str
    base: str
    tip: str
    joints: tuple[str, ...]

    @functools.cached_property
    def root(self) -> xml.Element:
        return document(self.path)

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = [], []
        joints = {joint.get("name"): joint for joint in self.root.findall("joint")}
        for name in self.joints:
            limit = joints[name].find("limit")
            lower, upper = (float((limit.get(end) if limit is not None else None) or 0.0) for end in ("lower", "upper"))
            known = joints[name].get("type") == "revolute" and lower < upper
            low.append(max(lower, -np.pi) if known else -np.pi)
            high.append(min(upper, np.pi) if known else np.pi)
        return np.array(low), np.array(high)

    @functools.cached_property
    def peer(self) -> "Peer | None":
        try:
            return Peer(self)
        except Exception:
            return None

    def home(self, lists: dict[str, list[float]]) -> list[float]:
        """The most dexterous of many postures well inside the ranges that the motors carry upright."""
        lowest, highest = self.limits()
        if "arm.q_min_rad" in lists and "arm.q_max_rad" in lists:
            lowest, highest = np.maximum(lowest, lists["arm.q_min_rad"]), np.minimum(highest, lists["arm.q_max_rad"])
        middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
        random = np.random.default_rng(1)
        if self.peer is None:
            return [float(q) for q in middle + 0.3 * half]
        candidates = middle + half * random.uniform(-0.8, 0.8, (400, len(self.joints)))
        most = np.array(lists.get("arm.torque_max_nm") or self.efforts())
        carried = [q for q in candidates if np.all(np.abs(self.peer.upright(q)) < CARRIED * most)]
        return [float(round(q, 6)) for q in max(carried or candidates, key=self.peer.dexterity)]

    def efforts(self) -> list[float]:
        """Largest torques as the file says them; 0 and nothing are no limit yet."""
        joints = {joint.get("name"): joint.find("limit") for joint in self.root.findall("joint")}
        said = [float(joints[name].get("effort") or 0.0) if joints[name] is not None else 0.0 for name in self.joints]
        return [effort if effort > 0.0 else np.inf for effort in said]

    def torques(self) -> list[float]:
        """Three times what gravity asks for in any of many postures, upright or not, at least 1 N·m."""
        low, high = self.limits()
        random = np.random.default_rng(2)
        if self.peer is None:
            return [100.0] * len(self.joints)
        most = np.max([np.abs(self.peer.gravity(q)) for q in random.uniform(low, high, (200, len(low)))], axis=0)
        return [float(round(min(max(3.0 * torque, 1.0), 1000.0), 2)) for torque in most]

    def postures(self, lists: dict[str, list[float]]) -> np.ndarray:
        low, high = self.limits()
        random = np.random.default_rng(3)
        return np.vstack([lists["arm.home_rad"], random.uniform(low, high, (POSTURES, len(low)))])

    def reference(self, postures: np.ndarray) -> list[dict] | None:
        return None if self.peer is None else [self.peer.numbers(q) for q in postures]


class Peer:
    """The arm as Pinocchio computes it: everything beside its chain held where `mocad` holds it."""

    def __init__(self, arm: Arm) -> None:
        root = copy.deepcopy(arm.root)
        for link in root.findall("link"):
            for shape in link.findall("visual") + link.findall("collision"):
                link.remove(shape)
            for inertial in link.findall("inertial"):
                mass = inertial.find("mass")
                if mass is not None and float(mass.get("value") or 0.0) == 0.0:
                    # an inertia without a mass: mocad refuses it, and a user takes it out
                    link.remove(inertial)
        for joint in root.findall("joint"):
            # a joint and a link may have one name in a URDF, frames may not
            joint.set("name", JOINT + joint.get("name"))
            mimic = joint.find("mimic")
            if mimic is not None:
                mimic.set("joint", JOINT + mimic.get("joint"))
            if joint.get("type") in (*TURNS, "prismatic"):
                # urdfdom wants what the numbers do not depend on
                limit = joint.find("limit")
                limit = xml.SubElement(joint, "limit") if limit is None else limit
                for number in ("lower", "upper", "effort", "velocity"):
                    limit.set(number, limit.get(number) or "0")
        whole = pinocchio.buildModelFromXML(xml.tostring(root, encoding="unicode"))
        held = pinocchio.neutral(whole)
        elements = {joint.get("name"): joint for joint in arm.root.findall("joint")}
        locked = []
        for number in range(1, whole.njoints):
            name = whole.names[number].removeprefix(JOINT)
            if name in arm.joints:
                continue
            locked.append(number)
            position, joint = held_at(elements, name, 0), whole.joints[number]
            if joint.nq == 1:
                held[joint.idx_q] = position
        self.model = pinocchio.buildReducedModel(whole, locked, held)
        self.data = self.model.createData()
        self.ids = [self.model.getJointId(JOINT + name) for name in arm.joints]
        self.order = [self.model.joints[number].idx_v for number in self.ids]
        self.base, self.tip = (self.model.getFrameId(link, pinocchio.FrameType.BODY) for link in (arm.base, arm.tip))

    def bodies(self) -> tuple[str, dict[str, list[float]]]:
        """Bodies for `[arm]`, in frames that turn about z, and how: the file's, mended as little as makes a body of them, or made up
        where a link that a joint moves has no mass. The model here keeps them, too."""
        how = "made up" if any(self.model.inertias[joint].mass <= 0.0 for joint in self.ids) else "mended"
        masses, centres, inertias = [0.0], [0.0] * 3, [0.0] * 6
        for number, joint in enumerate(self.ids):
            body = self.model.inertias[joint]
            mass, centre, inertia = body.mass, body.lever.copy(), body.inertia.copy()
            if mass <= 0.0:
                mass = BODY_KG * LIGHTER**number
                following = self.ids[number + 1] if number + 1 < len(self.ids) else None
                centre = 0.5 * self.model.jointPlacements[following].translation if following else np.zeros(3)
                inertia = 0.4 * mass * BALL_M**2 * np.eye(3)
            least, middle, most = np.linalg.eigvalsh(inertia)
            if least < 1e-12:
                inertia = inertia + 0.4 * mass * LEAST_BALL_M**2 * np.eye(3)
            elif most > least + middle:
                inertia = inertia + 1.001 * (most - least - middle) * np.eye(3)
            self.model.inertias[joint] = pinocchio.Inertia(mass, centre, inertia)
            turn = z_to(self.axis(joint))
            own = turn.T @ inertia @ turn
            masses.append(mass)
            centres += (turn.T @ centre).tolist()
            inertias += [own[0, 0], own[0, 1], own[0, 2], own[1, 1], own[1, 2], own[2, 2]]
        self.data = self.model.createData()
        lists = {"arm.mass_kg": masses, "arm.com_m": centres, "arm.inertia_com": [float(value) for value in inertias]}
        return how, lists

    def axis(self, joint: int) -> np.ndarray:
        """Unit axis of a joint in its own frame."""
        motion = self.model.joints[joint].createData()
        self.model.joints[joint].calc(motion, pinocchio.neutral(self.model), np.ones(self.model.nv))
        return np.array(motion.S).reshape(6)[3:]

    def upright(self, q: np.ndarray) -> np.ndarray:
        """Torques that hold the arm on an upright base link."""
        full = self.position(q)
        pinocchio.framesForwardKinematics(self.model, self.data, full)
        self.model.gravity.linear = self.data.oMf[self.base].rotation @ np.array([0.0, 0.0, -9.81])
        return pinocchio.computeGeneralizedGravity(self.model, self.data, full)[self.order]

    def position(self, q: np.ndarray) -> np.ndarray:
        full = pinocchio.neutral(self.model)
        for number, angle in zip(self.ids, q):
            joint = self.model.joints[number]
            values = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
            full[joint.idx_q : joint.idx_q + joint.nq] = values
        return full

    def numbers(self, q: np.ndarray) -> dict:
        full = self.position(q)
        pinocchio.framesForwardKinematics(self.model, self.data, full)
        pose = self.data.oMf[self.base].inverse() * self.data.oMf[self.tip]
        mass = pinocchio.crba(self.model, self.data, full)
        mass = np.triu(mass) + np.triu(mass, 1).T
        return {
            "position_m": pose.translation.tolist(),
            "rotation": pose.rotation.flatten().tolist(),
            "mass": mass[np.ix_(self.order, self.order)].flatten().tolist(),
        }

    def dexterity(self, q: np.ndarray) -> float:
        frame = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pinocchio.computeFrameJacobian(self.model, self.data, self.position(q), self.tip, frame)[:, self.order]
        reach = np.linalg.norm(jacobian[:3], axis=0).max() or 1.0
        jacobian[:3] /= reach
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1])

    def gravity(self, q: np.ndarray) -> np.ndarray:
        full = self.position(q)
        directions = []
        for axis in np.eye(3):
            self.model.gravity.linear = 9.81 * axis
            directions.append(pinocchio.computeGeneralizedGravity(self.model, self.data, full)[self.order])
        return np.linalg.norm(directions, axis=0)


def z_to(axis: np.ndarray) -> np.ndarray:
    """The turn that brings z to a unit axis, as `mocad` turns the frames of its links."""
    x, y, z = axis
    if x == 0.0 and y == 0.0 and z > 0.0:
        return np.eye(3)
    roll, pitch = np.arctan2(-y, np.hypot(x, z)), np.arctan2(x, z)
    return pinocchio.rpy.rpyToMatrix(roll, pitch, 0.0)


def held_at(elements: dict[str, xml.Element], name: str, depth: int) -> float:
    joint = elements[name]
    mimic, limit = joint.find("mimic"), joint.find("limit")
    if mimic is not None and depth < 16:
        master = held_at(elements, mimic.get("joint"), depth + 1) if mimic.get("joint") in elements else 0.0
        return float(mimic.get("multiplier") or 1.0) * master + float(mimic.get("offset") or 0.0)
    if limit is None or joint.get("type") == "continuous":
        return 0.0
    return max(min(0.0, float(limit.get("upper") or 0.0)), float(limit.get("lower") or 0.0))


def difference(ours: dict, theirs: dict) -> float:
    """Largest difference, each quantity over its largest number (positions and rotations over at least 1)."""
    most = 0.0
    for key, least in (("position_m", 1.0), ("rotation", 1.0), ("mass", 0.0)):
        a, b = np.array(ours[key]), np.array(theirs[key])
        most = max(most, float(np.abs(a - b).max() / max(np.abs(b).max(), least)))
    return most


def arms(path: pathlib.Path, folder: pathlib.Path) -> list[Arm]:
    """Runs of 6 or 7 turning joints without a branch that turns, from where the robot branches to where it does again."""
    root = document(path)
    if root is None or root.tag != "robot":
        return []
    joints = [joint for joint in root.findall("joint") if joint.find("parent") is not None and joint.find("child") is not None]
    below: dict[str, list] = {}
    for joint in joints:
        below.setdefault(joint.find("parent").get("link"), []).append(joint)
    children = {joint.find("child").get("link") for joint in joints}

    def child(joint: xml.Element) -> str:
        return joint.find("child").get("link")

    def turns(joint: xml.Element) -> bool:
        return joint.get("type") in TURNS and joint.find("mimic") is None

    @functools.cache
    def turning_below(link: str) -> bool:
        return any(turns(joint) or turning_below(child(joint)) for joint in below.get(link, []))

    found = []

    def follow(start: str, link: str, run: list[str]) -> None:
        branches = [joint for joint in below.get(link, []) if turns(joint) or turning_below(child(joint))]
        if len(branches) == 1:
            [joint] = branches
            if turns(joint) or joint.get("type") == "fixed":
                return follow(start, child(joint), [*run, joint.get("name")] if turns(joint) else run)
        if len(run) in (6, 7) and not any(NOT_OF_AN_ARM.search(name) for name in run):
            short = str(path.relative_to(folder))
            found.append(Arm(path.resolve(), short, start, link, tuple(run)))
        for joint in branches:
            first = turns(joint) and len(branches) > 1
            follow(link if first or joint.get("type") == "fixed" else child(joint), child(joint), [joint.get("name")] if first else [])
        return None

    for link in [link.get("name") for link in root.findall("link") if link.get("name") not in children]:
        follow(link, link, [])
    return found
