import os
import subprocess
import time
from pathlib import Path

import pytest

import moca

ROOT = Path(__file__).parents[2]
MOCAD = Path(os.environ.get("MOCAD", ROOT / "target/debug/mocad"))
CALM = "simulation.hand.taxels = []\n"


@pytest.fixture(scope="session")
def mocad():
    assert MOCAD.exists(), "cargo build --bin mocad, or MOCAD"
    return MOCAD


@pytest.fixture
def daemon(mocad, tmp_path):
    """A live robot without a cover, which no busy machine can stop; it arms nothing by itself."""
    address = f"unix:{tmp_path}/mocad.sock"
    config = tmp_path / "mocad.toml"
    config.write_text(
        f'[telemetry]\nlisten = "{address}"\n[startup]\narm = false\n[simulation.hand]\ntaxels = []\n'
        '[plant]\nparts = "arm"\n'
    )
    process = subprocess.Popen([mocad, "--config", config], stdout=subprocess.DEVNULL)
    try:
        yield address
    finally:
        process.kill()
        process.wait(60)


def wait_for(robot, mode):
    until = time.monotonic() + 60
    while (state := robot.state).mode != mode:
        assert time.monotonic() < until, f"never {mode}: {state}"
    return state
