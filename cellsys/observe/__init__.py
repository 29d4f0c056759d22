"""Physical read-outs of runs, full-order or reconstructed."""

from cellsys.mechanics.contact import contour_gap, edge_gap, until_contact
from cellsys.observe.headings import heading_change_deg, heading_deg, heading_error_deg
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
from cellsys.observe.read_outs import read_out_errors, read_outs
from cellsys.observe.spreading import (
    centre_height,
    contact_radius,
    crawl_distance,
    node_speed,
    summary_of_run,
)
from cellsys.observe.tractions import (
    TractionMap,
    Tractions,
    contact_area,
    pulling,
    traction_read_outs,
    tractions,
    volume_course,
)

__all__ = [
    "Attenuation",
    "PairReadout",
    "TractionMap",
    "Tractions",
    "alone_scenes",
    "attenuation_length",
    "centre_height",
    "contact_area",
    "contact_radius",
    "contour_gap",
    "crawl_distance",
    "edge_gap",
    "heading_change_deg",
    "heading_deg",
    "heading_error_deg",
    "node_speed",
    "observe_neighbours",
    "observe_pair",
    "pair_of",
    "pair_regions",
    "pulling",
    "read_out_errors",
    "read_outs",
    "speed_against_spacing",
    "summary_of_run",
    "traction_read_outs",
    "tractions",
    "until_contact",
    "volume_course",
]
