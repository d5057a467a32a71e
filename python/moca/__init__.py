"""MOCA-S from Python: a running robot, its logs and its simulation.

SI units, radians. Frames: W world, B mobile base, E flange; a name says which. Quaternions are x, y, z, w.

A program that commands is watched over: only a call of its own is a sign of life, and after three seconds without one
it loses the command and a moving robot stops. The end of a `with moca.connect() as robot:` block disarms the robot that
the block commanded; an exception that leaves the block, Ctrl-C and `sys.exit` among them, is a protective stop.
"""

from __future__ import annotations

import os
import time
from typing import Any, Iterator, NamedTuple, Sequence

import numpy as np

from moca._export import export
from moca._export import table as _table
from moca._moca import Batch as _Batch
from moca._moca import Client as _Client
from moca._moca import Disconnected, Refused
from moca._moca import Log as _Log
from moca._moca import Simulation as _Simulation
from moca._moca import State as _State
from moca._moca import stop as _stop
from moca._sweep import Protection, Sweep, experiment
from moca._sweep import assignments as _assignments

__all__ = [
    "Disconnected",
    "Gripper",
    "GripperState",
    "Log",
    "Protection",
    "Refused",
    "Robot",
    "Sim",
    "SimBatch",
    "State",
    "States",
    "Sweep",
    "connect",
    "experiment",
    "export",
    "read",
    "stop",
]

AGE_LIMIT_S = 0.2


def _array(data: bytes) -> np.ndarray:
    return np.frombuffer(data, dtype=np.float64)


def _numbers(values: Any) -> list[float]:
    return np.asarray(values, dtype=np.float64).ravel().tolist()


def _file_or_text(config: str | os.PathLike[str] | None) -> tuple[str | None, str | None]:
    """Splits what a user calls a configuration: a path, or a text of TOML."""
    text = config if isinstance(config, str) and ("\n" in config or "=" in config) else None
    return None if config is None or text is not None else os.fspath(config), text


class State:
    """One tick of a robot. Arrays are read-only; one without elements is of a part that the robot has not."""

    __slots__ = ("_state",)

    def __init__(self, state: _State) -> None:
        self._state = state

    def __getattr__(self, field: str) -> Any:
        numbers = _array(self._state.numbers(field))
        return float(numbers[0]) if field in _SCALARS else numbers

    @property
    def tick(self) -> int:
        """Ticks since the loop started."""
        return self._state.tick

    @property
    def overruns(self) -> int:
        """Ticks that the loop has missed since it started: it was late, and no state has their number."""
        return self._state.overruns

    @property
    def mode(self) -> str:
        """What the robot does: "ready", "impedance", "protective stop" and others."""
        return self._state.mode

    @property
    def law(self) -> str | None:
        """The law that arming starts."""
        return self._state.law

    @property
    def fault(self) -> str | None:
        """Why the robot is stopped, if it is."""
        return self._state.fault

    @property
    def target(self) -> tuple[str, str] | None:
        """Kind and phase of the last target: ("pose", "moving")."""
        return self._state.target

    @property
    def gripper(self) -> GripperState | None:
        """The gripper; None without one."""
        gripper = self._state.gripper
        return None if gripper is None else GripperState(*gripper)

    def __repr__(self) -> str:
        return f"<moca.State tick {self.tick}, {self.mode}>"


_FIELDS = dict(_State.fields())
_SCALARS = {name for name, single in _FIELDS.items() if single}
_WORDS = _Log.word_fields()


class GripperState(NamedTuple):
    """State of a gripper at one tick."""

    width_m: float
    """Distance between the fingers, m."""
    width_max_m: float
    """Largest distance between them, m."""
    phase: str
    """Activity: "resting", "moving", "holding", or "unknown" where it does not answer."""
    holds: bool
    """True if an object of the width that was asked for is held."""
    object_kg: float
    """Mass of the held object as the grasp told it, kg; 0 where nothing is held or nothing was told."""
    fault: str | None
    """Fault since the last request, with its remedy. None of them stops arm or base."""


class Gripper:
    """Two fingers on the flange, in every mode. The latest request counts: it ends the one before.

    A call returns when the fingers rest. On a `Robot` other threads run meanwhile, and may lead the arm. A `Sim` steps,
    with the targets that it has. With `wait=False` a call returns when the request has begun, on a `Sim` after one tick.

    An interrupted call, by Ctrl-C for example, stops the fingers. Only `release`, `home` and a wider `move` let an object go.
    A request that is refused raises `Refused`, and so does one that a fault ended. `grasp` returns False for an object
    that it did not get.
    """

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    @property
    def state(self) -> GripperState:
        """The newest state."""
        return GripperState(*self._inner.gripper_state())

    def home(self, *, wait: bool = True) -> None:
        """Opens, closes and opens the fingers to find their range. It lets an object go."""
        self._inner.gripper("home", [], wait)

    def move(self, width_m: float, speed_m_s: float = 0.05, *, wait: bool = True) -> None:
        """Moves the fingers to a width, m. A larger one than the object's lets it go."""
        self._inner.gripper("move", [width_m, speed_m_s], wait)

    def grasp(
        self,
        width_m: float,
        speed_m_s: float = 0.05,
        force_n: float = 40.0,
        tolerance_m: float = 0.005,
        mass_kg: float = 0.0,
        *,
        wait: bool = True,
    ) -> bool:
        """Closes the fingers on an object of this width, and returns True if it is held when the call returns.

        `tolerance_m` is the largest difference between `width_m` and the object's width. The arm carries `mass_kg` from the
        moment in which the object is held; 0 tells it nothing. `state.fault` says why nothing is held.
        """
        return self._inner.gripper("grasp", [width_m, speed_m_s, force_n, tolerance_m, mass_kg], wait)

    def release(self, *, wait: bool = True) -> None:
        """Opens the fingers as far as they go."""
        self._inner.gripper("release", [], wait)

    def stop(self) -> None:
        """Stops the fingers. An object that is held stays held."""
        self._inner.gripper("stop", [], True)


class _Commanded:
    """What a robot and a simulation may be asked. A refusal raises `Refused` with its reason."""

    _inner: Any

    def tare(self) -> Any:
        """Measures the cover's zero; nobody may touch the robot."""
        return self._request("tare")

    def arm(self) -> Any:
        """Hands the robot to its law."""
        return self._request("arm")

    def disarm(self) -> Any:
        """Takes it back: it holds still."""
        return self._request("disarm")

    def stop(self) -> Any:
        """Protective stop; taken from anybody."""
        return self._request("stop")

    def resume(self) -> Any:
        """Leaves the protective stop."""
        return self._request("resume")

    def recentre(self) -> Any:
        """Drives the base slowly back under the arm; a touch or `end_target` ends it."""
        return self._request("recentre")

    def select_law(self, law: str) -> Any:
        """Chooses "impedance" or "follow-me"."""
        if law not in ("impedance", "follow-me"):
            raise ValueError(f"law = {law!r}: allowed: 'impedance', 'follow-me'")
        return self._request(law)

    def end_target(self) -> Any:
        """Ends target or trajectory: the reference holds."""
        return self._request("end-target")

    def target_pose(self, position: Any, quaternion: Any, *, age_limit: float = AGE_LIMIT_S, touch: str = "wins") -> Any:
        """Leads the flange to a pose in W, m; renew it before it is `age_limit` s old, or the reference holds."""
        return self._target("pose", [*_numbers(position), *_numbers(quaternion)], age_limit, touch)

    def target_twist(
        self, twist: Any, *, axes: str = "world", age_limit: float = AGE_LIMIT_S, touch: str = "wins"
    ) -> Any:
        """Moves the flange, m/s and rad/s, in the axes of "world", "base" or "flange"."""
        if axes not in ("world", "base", "flange"):
            raise ValueError(f"axes = {axes!r}: allowed: 'world', 'base', 'flange'")
        return self._target(f"twist {axes}", _numbers(twist), age_limit, touch)

    def target_posture(self, q: Any, *, age_limit: float = AGE_LIMIT_S, touch: str = "wins") -> Any:
        """Leads all joints to a posture, rad."""
        return self._target("posture", _numbers(q), age_limit, touch)

    def target_base(self, velocity: Any, *, age_limit: float = AGE_LIMIT_S, touch: str = "pass-through") -> Any:
        """Drives the base, in the axes of B: m/s, m/s, rad/s. In follow-me, while nobody touches it."""
        return self._target("base", _numbers(velocity), age_limit, touch)

    def trajectory(self, times: Any, positions: Any, quaternions: Any, *, touch: str = "wins") -> Any:
        """Leads the flange along poses in W: (n,) s, (n, 3) m, (n, 4)."""
        columns = [np.reshape(times, (-1, 1)), np.reshape(positions, (-1, 3)), np.reshape(quaternions, (-1, 4))]
        if len({len(column) for column in columns}) > 1:
            counts = ", ".join(f"{len(column)} {name}" for column, name in zip(columns, ("times", "positions", "quaternions")))
            raise ValueError(f"{counts}: a trajectory needs as many of each")
        return self._result(self._inner.trajectory(_numbers(np.hstack(columns)), touch))

    def press(self, taxel: int, force: float) -> Any:
        """Simulated robots only: presses a taxel (1 is T1) with a steady force, N; 0 lets go."""
        if not 1 <= taxel <= 256:
            raise ValueError(f"taxel {taxel}: allowed: 1 (T1) to the number of taxels")
        return self._result(self._inner.press(taxel - 1, float(force)))

    @property
    def gripper(self) -> Gripper:
        """The gripper on the flange."""
        return Gripper(self._inner)

    def _request(self, name: str) -> Any:
        return self._result(self._inner.request(name))

    def _target(self, kind: str, values: Sequence[float], age_limit: float, touch: str) -> Any:
        raise NotImplementedError

    def _result(self, result: Any) -> Any:
        return result


class Robot(_Commanded):
    """A running daemon. Iterating gives its states, a thousand a second, without end."""

    def __init__(self, address: str | None = None) -> None:
        self._inner = _Client(address)

    @property
    def name(self) -> str:
        """What the robot is called."""
        return self._inner.name

    def arm(self) -> None:
        """Hands the robot to its law. One that armed itself (`startup.arm`) moves already, and takes commands."""
        if self.state.mode not in ("impedance", "follow-me"):
            self._request("arm")

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Present values of all parameters that are numbers."""
        return {name: np.asarray(values) for name, values, _unit in self._inner.parameters()}

    def set_parameter(self, name: str, values: Any) -> None:
        """Changes a live parameter."""
        self._inner.set_parameter(name, _numbers(values))

    @property
    def state(self) -> State:
        """The newest state."""
        return State(self._inner.latest())

    def __iter__(self) -> Iterator[State]:
        return self

    def __next__(self) -> State:
        return State(self._inner.next())

    def release(self) -> None:
        """Gives the command back. An armed robot is disarmed, unless it armed itself and no operator has intervened."""
        self._inner.release()

    def close(self) -> None:
        """Disarms the robot if this program has commanded it, and ends the connection."""
        self._inner.close()

    def __enter__(self) -> Robot:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            # The daemon stops a robot whose commander hangs up without a word.
            self._inner.abandon()

    def _target(self, kind: str, values: Sequence[float], age_limit: float, touch: str) -> None:
        self._inner.target(kind, values, time.time_ns(), age_limit, touch)


class Sim(_Commanded):
    """A simulated robot in lock-step, deterministic: board bytes, law and plant as in `mocad`.

    `config` is the path of a file, a text of TOML, or nothing for the built-in one. Every request takes a tick and
    gives its state. Those of `gripper` step until the fingers rest, and give what a robot's give.
    """

    def __init__(self, config: str | os.PathLike[str] | None = None, *, seed: int | None = None) -> None:
        self._inner = _Simulation(*_file_or_text(config), seed)

    @property
    def period(self) -> float:
        """Of a tick, s."""
        return self._inner.period_s

    def step(self, ticks: int = 1) -> State:
        """Goes on by so many ticks."""
        return State(self._inner.step(ticks))

    def _target(self, kind: str, values: Sequence[float], age_limit: float, touch: str) -> State:
        return State(self._inner.target(kind, values, age_limit, touch))

    def _result(self, result: Any) -> State:
        return State(result)


class States:
    """Newest states of the robots of a batch, under the names of `State`: each array has a row for each robot.

    The arrays are read-only and share the memory of the batch: the next step overwrites them. Copy what has to last.
    NaN is what is not known.
    """

    def __init__(self, batch: _Batch) -> None:
        self._batch = batch
        for name, shared in batch.fields():
            setattr(self, name, np.asarray(shared))

    @property
    def mode(self) -> list[str | None]:
        """Mode of each robot."""
        return self._batch.modes()

    @property
    def fault(self) -> list[str | None]:
        """Why each robot is stopped, if it is."""
        return self._batch.faults()

    @property
    def refused(self) -> list[str | None]:
        """Why each robot refused the press or target of the last step, if it did."""
        return self._batch.refusals()


class SimBatch:
    """Simulated robots that step together on `threads` threads, each bit for bit a `Sim` with the same seed.

    `config` is as for `Sim`; its robots have to arm themselves. `target` is the kind of target that `step` takes:
    "base", "pose", "posture", "twist world", "twist base" or "twist flange". Without `threads` it takes every core.
    """

    def __init__(
        self,
        config: str | os.PathLike[str] | None = None,
        robots: int = 1,
        threads: int | None = None,
        *,
        target: str = "base",
    ) -> None:
        self._inner = _Batch(*_file_or_text(config), robots, threads, target)
        self._robots = robots
        self._targets = np.asarray(self._inner.targets)
        self._presses = np.asarray(self._inner.presses)
        self.states = States(self._inner)

    def __len__(self) -> int:
        return self._robots

    def reset(self, seeds: Any, *, where: Any = None, settings: Any = None) -> States:
        """Makes new robots with these seeds, where `where` is true, and steps each until its law is in control.

        `settings` has for each robot a dict of keys of a sweep that are in the configuration, such as `m_v`,
        `true.foam.scale` or `simulation.hand.force_n`; what it leaves out is as in `config`.
        """
        wanted = np.ones(len(self), bool) if where is None else np.asarray(where, bool)
        own = [_assignments(one) for one in settings or ()]
        self._inner.reset([int(seed) if new else None for seed, new in zip(seeds, wanted, strict=True)], own)
        return self.states

    def step(self, targets: Any = None, ticks: int = 1, presses: Any = None) -> States:
        """Steps every robot so many ticks; a press takes the first one, a target the next.

        `targets` has a row for each robot, in the units of `Sim`'s target of that kind; a row of NaN asks for nothing.
        `presses` has rows of taxel (1 is T1, 0 for none) and force, N. A robot that refuses steps on without the
        request: `refused` of the states says why, and nothing is raised.
        """
        if targets is not None:
            self._targets[:] = targets
        if presses is not None:
            self._presses[:] = presses
        self._inner.step(ticks, targets is not None, presses is not None)
        return self.states


class Log:
    """What a log shows of a run, 50 rows a second and one for whatever happened: `log["q_rad"]` is an (n, 7) array."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = os.fspath(path)
        self._inner = _Log(self._path)
        self._columns: dict[str, np.ndarray] = {}

    @property
    def name(self) -> str:
        """What the robot is called."""
        return self._inner.name

    @property
    def cut(self) -> str | None:
        """Where the file breaks off and why, if it is not whole."""
        return self._inner.cut

    @property
    def start_unix_ns(self) -> int:
        """Unix time of loop time 0."""
        return self._inner.start_unix_ns

    def keys(self) -> list[str]:
        """The names of the columns."""
        return [*_FIELDS, *_WORDS]

    def __len__(self) -> int:
        return len(self._inner)

    def __getitem__(self, field: str) -> np.ndarray:
        if field not in self._columns:
            self._columns[field] = self._read(field)
        return self._columns[field]

    def to_arrow(self) -> Any:
        """The log as a `pyarrow.Table` with robot, run (the file's name without its ending) and Unix time."""
        self._inner.load()
        return _table(self, os.path.splitext(os.path.basename(self._path))[0])

    def _read(self, field: str) -> np.ndarray:
        if field in _WORDS:
            return np.asarray(self._inner.words(field))
        data, width = self._inner.column(field)
        column = _array(data)
        return column if field in _SCALARS else column.reshape(-1, width) if width else column.reshape(len(self), 0)


def connect(address: str | None = None) -> Robot:
    """Connects to a running daemon: unix:PATH, or HOST:PORT; without one where `mocad arm` finds it."""
    return Robot(address)


def stop(address: str | None = None) -> None:
    """Protective stop, from anybody: it needs neither the command nor a place among the daemon's clients."""
    _stop(address)


def read(path: str | os.PathLike[str]) -> Log:
    """Opens a log; a column is read when it is asked for, together with those of its record."""
    return Log(path)
