"""Problems posed on a loop: parameters from recordings, commands that bring a cell to a place."""

from cellsys.design.attraction import Attraction, pair_attraction
from cellsys.design.fit import fit
from cellsys.design.fitted import Fitted, ParameterProfile
from cellsys.design.polarity_fit import PolarityFit, fit_polarity
from cellsys.design.recording import Recording
from cellsys.design.steer import steer
from cellsys.design.steered import Miss, Steered, SteeredRun
from cellsys.design.target import Obstacle, Target

__all__ = [
    "Attraction",
    "Fitted",
    "Miss",
    "Obstacle",
    "ParameterProfile",
    "PolarityFit",
    "Recording",
    "Steered",
    "SteeredRun",
    "Target",
    "fit",
    "fit_polarity",
    "pair_attraction",
    "steer",
]
