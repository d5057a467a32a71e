"""Logs as a LeRobot data set; `tests/foreign_lerobot.py` reads one with a library that is not ours."""

import json
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

import moca
from conftest import ROOT

parquet = pytest.importorskip("pyarrow.parquet")
from moca import _lerobot  # noqa: E402


@pytest.fixture(scope="session")
def logs(mocad, tmp_path_factory):
    """Two runs in which hands press, of different lengths."""
    folder = tmp_path_factory.mktemp("runs")
    made = []
    for name, seconds in [("a", 12), ("b", 9)]:
        config = folder / f"{name}.toml"
        config.write_text('telemetry.listen = ""\n[simulation.hand]\nforce_n = 25.0\nevery_s = 2.5\nhold_s = 1.0\n')
        made.append(folder / f"{name}.mcap")
        command = [mocad, "--config", config, "--as-fast-as-possible", "--duration", str(seconds), "--record", made[-1]]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return made


def read_by_another(folder):
    program = [sys.executable, ROOT / "tests" / "foreign_lerobot.py", folder]
    return subprocess.run(program, check=True, capture_output=True, text=True).stdout


def test_data_set_has_the_frames_of_its_logs(logs, tmp_path):
    assert moca.export(logs, tmp_path / "set", format="lerobot", task="be led") == [str(tmp_path / "set")]
    assert read_by_another(tmp_path / "set").startswith("2 episodes, ")
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    for i, log in enumerate(map(moca.read, logs)):
        rows = parquet.read_table(tmp_path / "set" / info["data_path"].format(chunk_index=0, file_index=i))
        moves = np.isin(log["mode"], ["impedance", "follow-me"])
        at = np.searchsorted(log["time_s"][moves], log["time_s"][moves][0] + 0.02 * np.arange(len(rows)) + 1e-6, side="right") - 1
        base = np.array(rows["observation.base"].to_pylist())
        assert np.array_equal(base, log["base_pose_world"][moves][at].astype(np.float32))
        forces = np.nan_to_num(log["taxel_force_n"][moves][at]).astype(np.float32)
        assert np.array_equal(np.array(rows["observation.tactile.force"].to_pylist(), np.float32), forces)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["set"], "parts are removed"


def test_data_set_is_the_same_on_processes_and_after_an_interruption(logs, tmp_path):
    moca.export(logs, tmp_path / "whole", format="lerobot")
    (tmp_path / "set.parts").mkdir()
    _lerobot.part(str(logs[0]), str(tmp_path / "set.parts" / "a.50.parquet"), 50)
    with ProcessPoolExecutor(2) as pool:
        moca.export(logs, tmp_path / "set", format="lerobot", pool=pool)
    files = [path.relative_to(tmp_path / "whole") for path in (tmp_path / "whole").rglob("*") if path.is_file()]
    assert len(files) == 6 and all((tmp_path / "set" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes() for file in files)
    before = (tmp_path / "set/meta/info.json").stat().st_mtime_ns
    moca.export(logs, tmp_path / "set", format="lerobot")
    assert (tmp_path / "set/meta/info.json").stat().st_mtime_ns == before, "a whole set is kept"


def test_wrong_request_is_refused_and_leaves_no_set(logs, tmp_path):
    for more, said in [({"fps": 51}, "fps = 51: allowed: 1 to 50"), ({"format": "zarr"}, "format = 'zarr': allowed")]:
        with pytest.raises(ValueError, match=said):
            moca.export(logs, tmp_path / "set", **{"format": "lerobot", **more})
    assert not list(tmp_path.iterdir())


class Made(dict):
    """Two seconds of a log: the hand is on T6 in the second one, and T3 fails at 1.5 s."""

    def __init__(self, change=lambda log, time_s: None):
        time_s = np.round(np.arange(0, 2, 0.02), 6)
        rows = len(time_s)
        force = np.zeros((rows, 11))
        force[time_s >= 1, 5] = 20.0
        force[time_s >= 1.5, 2] = np.nan
        pose = np.column_stack([time_s, np.zeros(rows), np.full(rows, np.pi / 2)])
        signs = np.where(np.arange(rows) % 3 == 0, -1.0, 1.0)[:, np.newaxis]
        super().__init__(
            time_s=time_s,
            base_pose_world=pose,
            base_velocity_world=np.tile([0.5, 0, 0], (rows, 1)),
            base_velocity_command_body=np.zeros((rows, 3)),
            flange_position_world=np.zeros((rows, 3)),
            flange_desired_position_world=np.zeros((rows, 3)),
            flange_quaternion_world=signs * [0.8, 0, 0, -0.6],
            flange_desired_quaternion_world=-signs * [1.0, 0, 0, 0],
            q_rad=np.full((rows, 7), 0.5),
            dq_rad_s=np.zeros((rows, 7)),
            arm_torque_nm=np.zeros((rows, 7)),
            taxel_force_n=force,
            frame_age_s=np.full(rows, 0.005),
        )
        self._path, self.moves = "run.mcap", np.full(rows, True)
        self._inner = SimpleNamespace(moves=lambda: self.moves)
        change(self, time_s)

    def __len__(self):
        return len(self["time_s"])


def test_episodes_leave_out_waiting_and_unknown_states():
    def change(log, time_s):
        log.moves[time_s < 0.4] = log.moves[time_s >= 1.6] = False
        log["q_rad"][(time_s >= 1.0) & (time_s < 1.2), 3] = np.nan

    frames, lengths = _lerobot._frames(Made(change), 50)
    assert lengths == [30, 20]
    base_x = frames["observation.base"][1][:, 0]
    assert base_x[[0, 29, 30]].tolist() == np.float32([0.4, 0.98, 1.2]).tolist()


def test_gap_ends_an_episode_and_frames_are_at_equal_distances():
    def change(log, time_s):
        for name in log:
            log[name] = log[name][(time_s < 0.1) | (time_s >= 0.4)]
        log.moves = log.moves[: len(log)]

    assert _lerobot._frames(Made(change), 50)[1] == [5, 80]
    frames, lengths = _lerobot._frames(Made(), 30)
    assert lengths == [60]
    assert np.allclose(frames["observation.tactile.age"][1][:4, 0], [0.005, 0.005 + 1 / 30 - 0.02, 0.005 + 2 / 30 - 0.06, 0.005])
    assert np.allclose(frames["observation.base"][1][:3, 0], [0.0, 0.02, 0.06])


def test_force_that_is_none_is_zero_and_not_valid():
    frames, _ = _lerobot._frames(Made(), 50)
    force, valid = frames["observation.tactile.force"][1], frames["observation.tactile.valid"][1]
    assert force[[49, 50], 5].tolist() == [0.0, 20.0]
    assert force[75, 2] == 0.0 and valid[[74, 75], 2].tolist() == [True, False]


def test_state_is_in_the_axes_of_its_action_and_turns_without_a_jump():
    frames, _ = _lerobot._frames(Made(), 50)
    (names, state), (actions, action) = frames["observation.state"], frames["action"]
    assert [name.replace("_desired", "") for name in actions] == names and state.shape == action.shape
    # A quarter turn to the left: what goes along x in the world goes to the robot's right.
    assert np.allclose(state[:, :2], [0.0, -0.5], atol=1e-7)
    assert np.allclose(state[:, 6:], [0.8, 0, 0, -0.6]) and np.allclose(action[:, 6:], [1, 0, 0, 0])
    angle = 0.02 * np.arange(628)
    turned = np.column_stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)])
    recorded = turned * np.where(turned[:, 3:] < 0, -1, 1)
    assert np.allclose(_lerobot._joined_signs(recorded), turned)


def test_log_without_a_law_in_control_is_no_data_set():
    def change(log, time_s):
        log.moves[:] = False

    with pytest.raises(ValueError, match="run.mcap: no law was in control"):
        _lerobot._frames(Made(change), 50)
