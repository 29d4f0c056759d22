"""K cells on one shared field: printed couplings, load ports, modal split, interaction graph."""

from cellsys.population.couple import couple
from cellsys.population.graph import InteractionGraph
from cellsys.population.poleset import PoleSet
from cellsys.population.ported.linear_cells import PortedCells
from cellsys.population.ported.load_ports import LoadPorts
from cellsys.population.printed.cells import CoupledCells
from cellsys.population.printed.forms import Feedback, MappedSuperposition, Superposition
from cellsys.population.printed.interface import PrintedInterface, printed_interface
from cellsys.population.printed.maps import ForceMap, P_c, P_F_phi, P_phi, fit_P_map
from cellsys.population.printed.split import FieldSplit
from cellsys.population.verdict import CoupledStability
from cellsys.ports.field_sensor import FieldSensor
from cellsys.ports.footprint import LinearField, PatchPort
from cellsys.ports.ports import CellPort, PortPassivity

__all__ = [
    "CellPort",
    "CoupledCells",
    "CoupledStability",
    "Feedback",
    "FieldSensor",
    "FieldSplit",
    "ForceMap",
    "InteractionGraph",
    "LinearField",
    "LoadPorts",
    "MappedSuperposition",
    "P_F_phi",
    "P_c",
    "P_phi",
    "PatchPort",
    "PoleSet",
    "PortPassivity",
    "PortedCells",
    "PrintedInterface",
    "Superposition",
    "couple",
    "fit_P_map",
    "printed_interface",
]
