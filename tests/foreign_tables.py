"""Compares an exported CSV table with the Parquet one of the same log, by Python's own reader and PyPI `pyarrow`.

usage: foreign_tables.py CSV PARQUET

Exits non-zero if they differ, a name is not snake_case, or time does not run forwards.
"""

import csv
import math
import re
import sys

import pyarrow.parquet as pq

with open(sys.argv[1], newline="") as file:
    heading, *rows = list(csv.reader(file))
table = pq.read_table(sys.argv[2])
assert heading == table.column_names and len(rows) == table.num_rows > 0, (heading, table.column_names)
for place, name in enumerate(heading):
    assert re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name), name
    texts, values = [row[place] for row in rows], table[name].to_pylist()
    for text, value in zip(texts, values):
        if isinstance(value, str):
            assert text == value, (name, text, value)
        else:
            assert (text == "" and not math.isfinite(value)) or float(text) == value, (name, text, value)
times = table["time_s"].to_pylist()
assert all(before < after for before, after in zip(times, times[1:])), "time does not run forwards"
print(f"{len(rows)} rows, {len(heading)} columns")
