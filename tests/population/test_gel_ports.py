"""Cells as loads on a gel are refused."""

import numpy as np
import pytest

import cellsys as cs
from tests.effects.test_embedded import small


def test_load_ports_on_a_gel_are_refused_with_the_reason():
    field = cs.full_field(cs.build(small()))
    model = cs.LatentModel(A=-np.eye(2), V=np.eye(2))
    with pytest.raises(cs.RepresentationError, match="run away"):
        cs.couple(model, coupling=cs.LoadPorts(field, positions=np.zeros((1, 2))))


def test_patches_of_load_have_no_top_to_lie_on():
    with pytest.raises(cs.SceneError, match="top of a disc"):
        cs.GalerkinField(cs.build(small()), order=4)
