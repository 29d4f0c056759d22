"""The loop: plant, controller, sensor, closed together."""

from cellsys.loop.closed_loop import ClosedLoop, Linearisation
from cellsys.loop.input_map import MPol
from cellsys.loop.join import closed_loop, loop_copies, parametric_loop
from cellsys.loop.literal import LiteralLoop, literal_loop
from cellsys.loop.polarity import AntiparallelStay, AntiparallelTurn, PolarityLaw
from cellsys.loop.scheduled import ScheduledLoop
from cellsys.model.sensor import StiffnessSensor
from cellsys.renamed import old_names

__getattr__ = old_names(__name__)

__all__ = [
    "AntiparallelStay",
    "AntiparallelTurn",
    "ClosedLoop",
    "Linearisation",
    "LiteralLoop",
    "MPol",
    "PolarityLaw",
    "ScheduledLoop",
    "StiffnessSensor",
    "closed_loop",
    "literal_loop",
    "loop_copies",
    "parametric_loop",
]
