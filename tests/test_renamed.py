"""Names of earlier versions: the same object, and a warning that names the new one."""

import importlib
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import cellsys as cs
from cellsys.renamed import MODULES, NAMES

ROOT = Path(__file__).resolve().parent.parent
EVERY = [(module, old, new) for module, names in NAMES.items() for old, new in names.items()]


@pytest.mark.parametrize(("module", "old", "new"), EVERY)
def test_an_old_name_is_the_new_object_and_says_so(module, old, new):
    parent, _, name = new.rpartition(".")
    with warnings.catch_warnings():  # naive: an alias that only points says nothing
        warnings.simplefilter("error")
        expected = getattr(importlib.import_module(parent), name)
    with pytest.warns(DeprecationWarning, match=f"^{module}.{old} is now {new}$") as told:
        assert getattr(importlib.import_module(module), old) is expected
    assert told[0].filename == __file__  # the line that asked, not the table
    assert old not in getattr(importlib.import_module(module), "__all__", ())


@pytest.mark.parametrize(("old", "new"), MODULES.items())
def test_an_old_module_has_what_the_new_one_has(old, new):
    room, _, name = old.rpartition(".")
    now = importlib.import_module(new)
    # The import system puts a module that it has loaded into its room, past `__getattr__`.
    vars(importlib.import_module(room)).pop(name, None)
    with pytest.warns(DeprecationWarning, match=f"^{old} is now {new}$"):
        assert getattr(importlib.import_module(room), name) is now
    stub = importlib.import_module(old)
    public = [n for n, value in vars(now).items() if getattr(value, "__module__", None) == new]
    assert public
    for item in public:
        with pytest.warns(DeprecationWarning, match=f"is now {new}.{item}$"):
            assert getattr(stub, item) is getattr(now, item)
    with pytest.raises(AttributeError, match="nothing"):
        _ = stub.nothing


def test_every_table_is_asked_by_its_module():
    for module in NAMES:
        with pytest.raises(AttributeError):
            _ = importlib.import_module(module).never_there
    assert {room for room, _, _ in (m.rpartition(".") for m in MODULES)} == {"cellsys.response"}
    assert cs.response.root_locus is cs.root_locus  # the function, not the module of that name


def test_nothing_of_ours_uses_an_old_name():
    """`import cellsys` and a first use of its rooms warn of nothing."""
    rooms = [m for m in NAMES if m != "cellsys"] + ["cellsys.response"]
    code = (
        "import importlib, warnings; "
        "warnings.filterwarnings('error', 'cellsys', DeprecationWarning); "
        f"[importlib.import_module(m) for m in ['cellsys', *{rooms!r}]]"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=60)
