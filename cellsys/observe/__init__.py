"""Physical read-outs of runs, full-order or reconstructed."""

from cellsys.mechanics.contact import edge_gap, until_contact
from cellsys.observe.pairs import (
    Attenuation,
    PairReadout,
    alone_scenes,
    attenuation_length,
    observe_neighbours,
    observe_pair,
    pair_of,
    pair_regions,
    speed_against_spacing,
)
from cellsys.observe.read_outs import read_outs
from cellsys.observe.spreading import contact_radius, node_speed, summary_of_run

__all__ = [
    "Attenuation",
    "PairReadout",
    "alone_scenes",
    "attenuation_length",
    "contact_radius",
    "edge_gap",
    "node_speed",
    "observe_neighbours",
    "observe_pair",
    "pair_of",
    "pair_regions",
    "read_outs",
    "speed_against_spacing",
    "summary_of_run",
    "until_contact",
]
