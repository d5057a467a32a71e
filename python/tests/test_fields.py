"""The stub lists the fields of a state that the table of a sample gives. MOCA_BLESS=1 writes it again."""

import os
import pathlib

import pytest

from moca import _moca

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("kind", ["State", "States"])
def test_stub_has_fields_of_sample_table(kind):
    def of(single):
        return "float" if single and kind == "State" else "NDArray[np.float64]"

    lines = [f"    {name}: {of(single)}\n" for name, single in _moca.State.fields()]
    stub = ROOT / "python" / "moca" / "__init__.pyi"
    text = stub.read_text()
    before, _, rest = text.partition(f"class {kind}:\n")
    after = rest[rest.index("    @property") :]
    wanted = f"{before}class {kind}:\n{''.join(lines)}{after}"
    if os.environ.get("MOCA_BLESS"):
        stub.write_text(wanted)
    assert text == wanted, "MOCA_BLESS=1 python -m pytest python/tests/test_fields.py"
