"""Plants of models reduced from a real scene carry the offset: python-control against `predict`."""

import numpy as np
import pytest

import cellsys as cs
from tests.cell import runs
from tests.model.test_plant_offset import TOLERANCE, check_offset, commands, distance


def reduced(method):
    data, test = runs.data()
    return cs.reduce(data, order=4, method=method, test=test)


@pytest.mark.parametrize(
    "made",
    [
        lambda: reduced(cs.PCR()),
        lambda: reduced(cs.LeastSquares()),
        lambda: reduced(cs.Contractive()),
        lambda: runs.model().at(40.0),
    ],
    ids=["PCR", "LeastSquares", "Contractive", "Equivariant"],
)
def test_forced_response_is_predict(made):
    check_offset(made())


def test_plant_of_an_equivariant_cell_is_that_at_its_horizon():
    model = runs.model()
    t = model.dt * np.arange(31)
    z0 = np.asarray(model.z_start)
    u = commands(model, 30, held=True)
    assert distance(model.at(model.horizon), model.plant(), z0, u, t) < TOLERANCE
