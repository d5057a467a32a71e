import os
import subprocess
import threading
import time
from contextlib import contextmanager
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


@contextmanager
def running(mocad, folder, more="", arguments=()):
    """A live robot without a cover, which no busy machine can stop; it arms nothing by itself. Gives address and process."""
    address = f"unix:{folder}/mocad.sock"
    config = folder / "mocad.toml"
    config.write_text(
        f'[telemetry]\nlisten = "{address}"\n[startup]\narm = false\n[simulation.hand]\ntaxels = []\n'
        f'[plant]\nparts = "arm"\n{more}'
    )
    process = subprocess.Popen([mocad, "--config", config, *arguments], stdout=subprocess.DEVNULL)
    try:
        yield address, process
    finally:
        process.kill()
        process.wait(60)


@pytest.fixture
def daemon(mocad, tmp_path):
    """Address of a live robot."""
    with running(mocad, tmp_path) as (address, _):
        yield address


def wait_for(robot, mode):
    until = time.monotonic() + 60
    while (state := robot.state).mode != mode:
        assert time.monotonic() < until, f"never {mode}: {state}"
    return state


@pytest.fixture
def distant(mocad, tmp_path, monkeypatch):
    """A robot as another machine reaches it, and a function that gives this program a certificate of a role."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    config = tmp_path / "mocad.toml"
    config.write_text(
        f'[telemetry]\nlisten = "unix:{tmp_path}/mocad.sock"\ntls = "127.0.0.1:0"\n[startup]\narm = false\n'
        '[simulation.hand]\ntaxels = []\n[plant]\nparts = "arm"\n'
    )
    process = subprocess.Popen([mocad, "--config", config], stdout=subprocess.PIPE, text=True)
    address = next(word for line in process.stdout for word in line.split() if word.startswith("tls://"))
    # A pipe that nobody reads would end the daemon.
    threading.Thread(target=process.stdout.read, daemon=True).start()

    def with_certificate(name, role):
        subprocess.run([mocad, "access", "new", name, "--role", role], cwd=tmp_path, check=True)
        monkeypatch.setenv("MOCA_ACCESS_FILE", str(tmp_path / f"{name}.pem"))
        return address

    try:
        yield with_certificate
    finally:
        process.kill()
        process.wait(60)
