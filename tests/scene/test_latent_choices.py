"""What a scene does not call for, a reduced model does not have: sensor, inputs, offset."""

import numpy as np
import pytest

import cellsys as cs
from cellsys.scene import Scene
from tests.mechanics.small_scenes import tiny


def learned(*names, **options):
    table = tiny(*names, cells=1, **options)
    table["duration"], table["sample"] = "40 s", "1 s"
    if "lamellipodium" in names:
        table["commands"] = {
            "heading": {"times": ["0 s", "20 s"], "values": ["0 deg", "80 deg"]},
            "amplitude": {"times": ["0 s", "30 s"], "values": [0.5, 1.5]},
        }
    run = cs.run_scene(Scene.parse(table))
    return cs.reduce(cs.snapshots([run]), order=3), run


def test_a_passive_scene_gives_a_model_without_inputs_and_sensor():
    model, run = learned("membrane_elasticity", "cortical_tension", matrix=False)
    assert model.input_names == ()
    assert model.B.shape == (3, 0)
    assert model.sensor is None
    assert (run.p, run.d, run.amplitude) == (None, None, None)
    with pytest.raises(cs.ParameterError, match="no sensor"):
        cs.closed_loop(model)


def test_a_cell_without_a_sensor_gives_inputs_and_no_sensor():
    """Before, d = p was recorded and a sensor was fitted to it."""
    model, run = learned("membrane_elasticity", "lamellipodium", matrix=False)
    assert model.input_names
    assert run.p is not None
    assert run.d is None
    assert model.sensor is None
    with pytest.raises(cs.ParameterError, match="no sensor"):
        cs.closed_loop(model)


def test_a_cell_that_senses_gives_a_sensor():
    model, run = learned("membrane_elasticity", "lamellipodium", "stiffness_sensing")
    assert model.sensor is not None
    assert np.abs(run.d - run.p).max() > 0.01


def test_a_model_without_offset_has_none():
    assert not cs.LatentModel(A=np.diag([-1.0, -2.0])).offset.any()
