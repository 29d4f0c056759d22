"""Physical read-outs of runs, full-order or reconstructed."""

from cellsys.mechanics.contact import contour_gap, edge_gap, until_contact
from cellsys.observe.everything import observe
from cellsys.observe.gel import (
    CellPull,
    GelContraction,
    cell_pull,
    densification,
    gel_contraction,
    gel_read_outs,
    local_volumes,
    range_exponent,
)
from cellsys.observe.headings import heading_change_deg, heading_deg, heading_error_deg
from cellsys.observe.motion import MeanSquares, mean_squares, movement, persistence
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
from cellsys.observe.polygons import (
    ShapeOfContour,
    axis_difference_deg,
    contour_shape,
    directionality_deg,
)
from cellsys.observe.read_outs import read_out_errors, read_outs
from cellsys.observe.spreading import (
    centre_height,
    contact_radius,
    crawl_distance,
    node_speed,
    summary_of_run,
)
from cellsys.observe.table import ReadOutTable
from cellsys.observe.top_view import top_view
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
    "CellPull",
    "GelContraction",
    "MeanSquares",
    "PairReadout",
    "ReadOutTable",
    "ShapeOfContour",
    "TractionMap",
    "Tractions",
    "alone_scenes",
    "attenuation_length",
    "axis_difference_deg",
    "cell_pull",
    "centre_height",
    "contact_area",
    "contact_radius",
    "contour_gap",
    "contour_shape",
    "crawl_distance",
    "densification",
    "directionality_deg",
    "edge_gap",
    "gel_contraction",
    "gel_read_outs",
    "heading_change_deg",
    "heading_deg",
    "heading_error_deg",
    "local_volumes",
    "mean_squares",
    "movement",
    "node_speed",
    "observe",
    "observe_neighbours",
    "observe_pair",
    "pair_of",
    "pair_regions",
    "persistence",
    "pulling",
    "range_exponent",
    "read_out_errors",
    "read_outs",
    "speed_against_spacing",
    "summary_of_run",
    "top_view",
    "traction_read_outs",
    "tractions",
    "until_contact",
    "volume_course",
]
