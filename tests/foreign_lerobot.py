"""Reads an exported LeRobot data set with a library that is not ours: PyPI `pyarrow` (pip install pyarrow).

usage: foreign_lerobot.py DIR

Exits non-zero if a file is missing or unreadable, a column is not what meta/info.json says, the frames are not at equal
distances and numbered without a gap, an episode does not lie where it is said to, or statistics are missing or wrong.
"""

import json
import pathlib
import sys

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

root = pathlib.Path(sys.argv[1])
info = json.loads((root / "meta/info.json").read_text())
stats = json.loads((root / "meta/stats.json").read_text())
assert info["codebase_version"] == "v3.0" and info["total_tasks"] == 1
episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
places = dict.fromkeys((episode["data/chunk_index"], episode["data/file_index"]) for episode in episodes)
files = [root / info["data_path"].format(chunk_index=chunk, file_index=file) for chunk, file in places]
assert sorted(root.glob("data/*/*")) == files, "files that no episode names, or out of order"
data = pa.concat_tables(pq.read_table(file) for file in files)
assert data.num_rows == info["total_frames"], (data.num_rows, info["total_frames"])
assert set(data.column_names) == set(info["features"])

types = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
for name, feature in info["features"].items():
    column, kind, (width,) = data[name], types[feature["dtype"]], feature["shape"]
    if width == 1:
        assert column.type == kind, (name, column.type)
    else:
        assert pa.types.is_list(column.type) and column.type.value_type == kind, (name, column.type)
        assert pc.unique(pc.list_value_length(column)).to_pylist() == [width], name
        assert len(feature["names"]) == width, name
        column = pc.list_flatten(column)
    assert column.null_count == 0, name
    of = stats[name]
    for statistic in ["min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99"]:
        assert len(of[statistic]) == width, (name, statistic)
    assert of["count"] == [data.num_rows], name
    if feature["dtype"] == "float32":
        assert pc.all(pc.is_finite(column)).as_py(), f"{name} has a number that is none"
        assert abs(pc.max(column).as_py() - max(of["max"])) < 1e-6, name

assert data["index"].to_pylist() == list(range(data.num_rows))
for frame, time in zip(data["frame_index"].to_pylist(), data["timestamp"].to_pylist()):
    assert abs(time - frame / info["fps"]) < 1e-4, (frame, time)

assert len(episodes) == info["total_episodes"]
tasks = pq.read_table(root / "meta/tasks.parquet")
assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
for number, episode in enumerate(episodes):
    rows = data.slice(episode["dataset_from_index"], episode["length"])
    assert episode["dataset_to_index"] - episode["dataset_from_index"] == episode["length"] == rows.num_rows
    assert set(rows["episode_index"].to_pylist()) == {number}
    assert rows["frame_index"].to_pylist() == list(range(rows.num_rows))
    assert episode["tasks"] == tasks["task"].to_pylist()
    file = pq.read_table(files[list(places).index((episode["data/chunk_index"], episode["data/file_index"]))])
    assert number in file["episode_index"].to_pylist(), f"episode {number} is not in its file"
print(f"{len(episodes)} episodes, {data.num_rows} frames, {len(info['features'])} features")
