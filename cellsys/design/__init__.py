"""Problems posed on a loop: parameters from recordings, commands that bring a cell to a place."""

from cellsys.design.fit import fit
from cellsys.design.fitted import Fitted, ParameterProfile
from cellsys.design.recording import Recording

__all__ = ["Fitted", "ParameterProfile", "Recording", "fit"]
