"""`cellsys couple` and the figures of coupled cells."""

import json

import numpy as np

from cellsys.population import Feedback, couple
from tests.population.systems import model


def test_couple_command(call, tmp_path):
    m = model(m=4, gap=[0.9, 0.5, 1e-9, 0.0])
    path = m.save(tmp_path / "m.npz")
    code, out, _ = call("couple", path, "--cells", 1000, "--json")
    assert code == 0
    table = json.loads(out)
    assert table["cells"] == 1000
    assert sum(row["multiplicity"] for row in table["poles"]) == 4000
    assert table["purely_matrix_directions"] == 1
    assert table["determined"] is False
    assert sum(row["multiplicity"] for row in table["alternative_poles"]) == 4000
    assert table["integrators"] == 999
    code, out, _ = call("couple", path, "--cells", 3)
    assert code == 0
    assert "not determined by the data" in out
    np.save(tmp_path / "map.npy", -0.1 * np.eye(4))
    code, out, _ = call("couple", path, "--cells", 3, "--form", "mapped", "--map", "map.npy")
    assert code == 0
    assert "MappedSuperposition" in out
    assert call("couple", path, "--cells", 3, "--form", "feedback")[0] == 0
    for wrong in (
        ["--cells", 0],
        ["--cells", 3, "--form", "other"],
        ["--cells", 3, "--form", "mapped"],
        ["--cells", 3, "--rank-tol", 2],
        ["--cells", 3, "--form", "mapped", "--map", path],
    ):
        code, out, err = call("couple", path, *wrong)
        assert (code, out) == (2, ""), err
        assert len(err.strip().split("\n")) == 1


def test_results_draw_themselves():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from cellsys.figures import poles_against_cells

    cells = couple(model(m=4, gap=[0.9, 0.5, 1e-9, 0.0], steered=True), 3)
    at = (np.ones(4), np.array([1.0, 0.0, 0.0]))
    for result in (cells, cells.pole_set(), cells.stability(), cells.linearize(at)):
        assert result.plot() is not None
        assert str(result)
    feedback = couple(model(m=4), 3, Feedback())
    ax = poles_against_cells([3], [feedback.pole_set()], limit=feedback.limit_poles())
    assert len(ax.lines) == 3
    plt.close("all")
