"""What the process family works with: changed texts, forged archives, scripts of processes."""

import json
import os
import re
import resource
from contextlib import contextmanager
from io import BytesIO

import numpy as np

from tests.loop.systems import make

EXTREMES = (
    "0", "-1", "1e9", "1000000000", "1e12 s", "1e-12 s", "1e300 um", "nan", "inf", "-inf",
    '"1e9 s"', '"1e12 s"', '"0 um"', '"-5 um"', '"1e-300 um"', '"1e300 Pa"', '"nan um"', "true",
    "[]", "{}", '""', '"../../etc/passwd"', '"/dev/zero"', '"\\u0000"', "99999999999999999999999",
    '["1 um"]', "[1, 2, 3]", "1979-05-27", '"1/0 1/s"', '"1e200 1/s"', '"5 mm"', '"1e-9 um"',
)  # fmt: skip


FACTORS = (0.0, -1.0, 1e-12, 1e-6, 1e-3, 0.1, 0.5, 2.0, 10.0, 1e3, 1e6, 1e12, 1e100, 1e300)


def mutated(text, seed, changes):
    """A scene file with some values, lines or characters changed."""
    rng = np.random.default_rng(seed)
    for _ in range(changes):
        lines = text.split("\n")
        k = int(rng.integers(len(lines)))
        match int(rng.integers(12)):
            case 6 | 7 | 8 | 9 | 10 | 11:
                # right in kind, far from any sensible size
                found = list(re.finditer(r'"(-?[0-9]+\.?[0-9]*)( [^"]+)"', lines[k]))
                if found:
                    m = found[int(rng.integers(len(found)))]
                    new = f"{float(m[1]) * FACTORS[int(rng.integers(len(FACTORS)))]:g}"
                    lines[k] = lines[k][: m.start(1)] + new + lines[k][m.end(1) :]
            case 0 | 1:
                if "=" in lines[k]:
                    key = lines[k].split("=")[0]
                    lines[k] = f"{key}= {EXTREMES[int(rng.integers(len(EXTREMES)))]}"
            case 2:
                digits = [i for i, c in enumerate(lines[k]) if c.isdigit()]
                if digits:
                    i = digits[int(rng.integers(len(digits)))]
                    new = str(rng.choice(["0", "9", "e9", "-", ".", "1e-9", "99999"]))
                    lines[k] = lines[k][:i] + new + lines[k][i + 1 :]
            case 3:
                lines.insert(int(rng.integers(len(lines))), lines[k])
            case 4:
                del lines[k]
            case 5:
                if lines[k]:
                    i = int(rng.integers(len(lines[k])))
                    lines[k] = lines[k][:i] + chr(int(rng.integers(1, 256))) + lines[k][i + 1 :]
        text = "\n".join(lines)
    return text


HEADER = {"kind": "latent model", "version": 1}
META = {
    "dt": None, "n_states": None, "input_names": [], "states": None, "auxiliaries": None,
    "card": None, "notes": {},
}  # fmt: skip
ODD = (
    None, True, -1, 0, 3.5, 10**30, "text", "../../evil", [], [1], [[]], {}, {"a": 1}, float("nan"),
    [["x", [2], "um", "component", "position"]], [["x", [-2], "um", "component", "position"]],
    [["x", [10**12], "um", "component", "position"]], [["x"]], [1, 2, 3],
)  # fmt: skip
ARRAYS = (
    np.zeros((2, 2)), np.zeros((0, 0)), np.zeros(4), np.array("x"), np.zeros((2, 2), complex),
    np.full((2, 2), np.nan), np.zeros((2, 2), bool), np.array([["a", "b"], ["c", "d"]]),
    np.zeros((2, 2), "M8[s]"), np.zeros((2, 2, 2)), np.zeros((2, 3)), np.array(1.0),
    np.zeros(2, [("a", float), ("b", int)]), np.ones((2, 2), np.float16), np.ones((2, 2), ">f8"),
)  # fmt: skip


def npy(array):
    """Bytes of a .npy file."""
    out = BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def forged(shape, descr="<f8"):
    """A .npy whose header promises more than follows."""
    out = BytesIO()
    np.lib.format.write_array_header_1_0(
        out, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return out.getvalue() + bytes(64)


class Payload:
    def __reduce__(self):
        return (os.mkdir, ("pickle was run",))


WRITER = """
import sys
from cellsys.store import RunWriter
writer = RunWriter(sys.argv[1], {"x": (40, 3), "eta": (39, 5)}, {})
print("writing", flush=True)
sys.stdin.read()
"""


SAVER = """
import sys
import numpy as np
from cellsys.store import load_archive, save_archive
print("saving", flush=True)
k = 0
while True:
    k += 1
    save_archive(sys.argv[1], "m", 1, {"A": np.full(200000, float(k))}, {"k": k})
"""


SMALL_DISK = """
import resource, signal, sys
import numpy as np
from cellsys.errors import CellsysError
from cellsys.store import RunWriter, load_archive, save_archive
save_archive(sys.argv[1] + "/m.npz", "m", 1, {"A": np.zeros(10)}, {})
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
for attempt in (
    lambda: save_archive(sys.argv[1] + "/m.npz", "m", 1, {"A": np.zeros(10**5)}, {}),
    lambda: RunWriter(sys.argv[1] + "/run", {"x": (10**5, 3)}, {}),
):
    try:
        attempt()
        print("wrote")
    except (CellsysError, OSError) as error:
        print(type(error).__name__)
print(load_archive(sys.argv[1] + "/m.npz", "m", 1)[0]["A"].size)
"""


FULL = """
import sys
import numpy as np
from cellsys.errors import CellsysError
from cellsys.store import RunWriter
shapes = {"x": (60_000, 3), "eta": (60_000, 3)}
if sys.argv[2] == "naive":
    from tests import naive
    naive.mapped_rows(sys.argv[1], shapes)
RunWriter._check_room = lambda self: None  # as if another process took the room just after
try:
    RunWriter(sys.argv[1] + "/run", shapes, {})
except CellsysError as error:
    print(type(error).__name__)
"""


def header(metadata=META):
    """The header entry of a model file."""
    return np.array(json.dumps(HEADER | {"metadata": metadata}))


@contextmanager
def bounded(gigabytes):
    """The block must not raise the peak of resident memory by more than this."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e6
    assert grown < gigabytes, f"peak memory grew by {grown:.2f} GB"


@contextmanager
def nothing_outside(folder):
    """The block works in `folder` / work, and writes nothing beside it."""
    (folder / "work").mkdir()
    (folder / "witness").write_text("as it was")
    yield folder / "work"
    assert sorted(p.name for p in folder.iterdir()) == ["witness", "work"]
    assert (folder / "witness").read_text() == "as it was"


def model_file(folder, seed=0):
    """A saved closed-loop model, and the model."""
    model = make(seed=seed).model
    return model.save(folder / "m.npz"), model


def same_model(a, b):
    return all(
        np.array_equal(getattr(a, k), getattr(b, k), equal_nan=True) for k in ("A", "B", "offset")
    )
