"""The loop: plant, controller, sensor, closed together."""

from cellsys.loop.closed_loop import ClosedLoop, Linearisation
from cellsys.loop.input_map import MPol
from cellsys.loop.join import closed_loop, loop_copies, parametric_loop
from cellsys.loop.polarity import Perturb, PolarityLaw, Stay
from cellsys.loop.scheduled import ScheduledLoop
from cellsys.model.sensor import StiffnessSensor

__all__ = [
    "ClosedLoop",
    "Linearisation",
    "MPol",
    "Perturb",
    "PolarityLaw",
    "ScheduledLoop",
    "Stay",
    "StiffnessSensor",
    "closed_loop",
    "loop_copies",
    "parametric_loop",
]
