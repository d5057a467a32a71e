import subprocess

import numpy as np
import pytest

import moca


@pytest.fixture(scope="module")
def log_file(mocad, tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    (folder / "mocad.toml").write_text('[telemetry]\nlisten = ""\n')
    path = folder / "run.mcap"
    command = [mocad, "--config", folder / "mocad.toml", "--as-fast-as-possible", "--duration", "60", "--record", path]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=240)
    return path


def test_a_log_is_read_as_columns(log_file):
    log = moca.read(log_file)
    columns = {name: log[name] for name in log.keys()}
    assert log.cut is None and 2_900 < len(log) < 6_000
    assert columns["q_rad"].shape == (len(log), 7) and columns["taxel_force_n"].shape == (len(log), 11)
    assert np.all(np.diff(columns["time_s"]) > 0) and columns["time_s"][-1] > 59
    assert set(columns["mode"]) >= {"taring", "impedance"}
    assert np.nanmax(columns["taxel_force_n"]) > 5


def test_columns_do_not_depend_on_the_order_in_which_they_are_asked_for(log_file):
    one_by_one, at_once = moca.read(log_file), moca.read(log_file)
    at_once._inner.load()
    for name in reversed(one_by_one.keys()):
        np.testing.assert_array_equal(one_by_one[name], at_once[name])
    assert len(one_by_one) == len(at_once["time_s"])


def test_a_cut_log_gives_every_whole_chunk(log_file, tmp_path):
    whole = moca.read(log_file)
    (tmp_path / "cut.mcap").write_bytes(log_file.read_bytes()[: log_file.stat().st_size // 2])
    cut = moca.read(tmp_path / "cut.mcap")
    assert cut.cut and 1_000 < len(cut) < len(whole)
    np.testing.assert_array_equal(cut["q_rad"], whole["q_rad"][: len(cut)])


def test_a_column_that_is_none_and_a_file_that_is_no_log(log_file, tmp_path):
    with pytest.raises(KeyError):
        moca.read(log_file)["no_such_column"]
    (tmp_path / "no.mcap").write_text("no")
    with pytest.raises(ValueError, match="not an MCAP file"):
        moca.read(tmp_path / "no.mcap")


def test_a_log_that_ends_within_its_header_is_refused_as_such(tmp_path):
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(ValueError, match="cut.mcap ends within its header: nothing in it can be read"):
        moca.read(tmp_path / "cut.mcap")


def test_a_missing_log_is_a_file_that_is_not_found(tmp_path):
    with pytest.raises(FileNotFoundError, match="no-such.mcap"):
        moca.read(tmp_path / "no-such.mcap")
