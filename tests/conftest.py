"""One thread each for linear algebra, and the command line called in this process."""

import os
import sys

import pytest

# The tests run in two processes on two cores. The libraries read the environment when they are
# loaded, which is after this.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")


@pytest.fixture(autouse=True)
def cache(request, monkeypatch):
    """A cache of runs for every test: none finds what another one, or the user, has made."""
    own = "tmp_path" in request.fixturenames
    folder = request.getfixturevalue("tmp_path") / "out" / "runs" if own else os.devnull
    monkeypatch.setenv("CELLSYS_CACHE", str(folder))


@pytest.fixture
def call(monkeypatch, capsys, tmp_path):
    """Run ``cellsys ...`` in this process, in an empty folder: (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["cellsys", *map(str, arguments)])
        from cellsys import cli

        capsys.readouterr()
        try:
            cli.main()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        out, err = capsys.readouterr()
        return code, out, err

    return run
