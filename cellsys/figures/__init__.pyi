"""What `cellsys.figures` hands out, for type checkers: most functions share a file's name."""

from .accuracy import work_precision as work_precision
from .bondgraph import bond_graph as bond_graph
from .comparison import (
    comparison as comparison,
)
from .comparison import (
    learning_curve as learning_curve,
)
from .comparison import (
    selection as selection,
)
from .crawler import (
    chain_displacement as chain_displacement,
)
from .crawler import (
    crawler_predictions as crawler_predictions,
)
from .crawler import (
    crawler_run as crawler_run,
)
from .crawler import (
    error_against_amplitude as error_against_amplitude,
)
from .crawler import (
    row_displacement as row_displacement,
)
from .diagram import block_diagram as block_diagram
from .equivariant import (
    bode_family as bode_family,
)
from .equivariant import (
    equivariant_model as equivariant_model,
)
from .equivariant import (
    forecast as forecast,
)
from .frequency import (
    bode as bode,
)
from .frequency import (
    nyquist as nyquist,
)
from .gel import gel_course as gel_course
from .gel import gel_section as gel_section
from .gel import gel_side as gel_side
from .gel import gel_thickness as gel_thickness
from .hard import hard_sweep as hard_sweep
from .loop import headings as headings
from .loop import linearisation as linearisation
from .movie import write_movie as write_movie
from .norms import system_norm as system_norm
from .population import (
    coupled_cells as coupled_cells,
)
from .population import (
    coupled_loop as coupled_loop,
)
from .population import (
    coupled_poles as coupled_poles,
)
from .population import (
    coupled_stability as coupled_stability,
)
from .population import (
    poles_against_cells as poles_against_cells,
)
from .reduction import (
    error_against_time as error_against_time,
)
from .reduction import (
    latent_model as latent_model,
)
from .reduction import (
    order_sweep as order_sweep,
)
from .reduction import (
    pole_certainty as pole_certainty,
)
from .reduction import (
    pole_map as pole_map,
)
from .response import (
    error_system as error_system,
)
from .response import (
    hankel as hankel,
)
from .response import (
    participation as participation,
)
from .response import (
    pole_zero_map as pole_zero_map,
)
from .response import (
    pseudospectra as pseudospectra,
)
from .response import (
    root_locus as root_locus,
)
from .response import (
    sensitivity as sensitivity,
)
from .response import (
    singular_values as singular_values,
)
from .response import (
    stability as stability,
)
from .response import (
    time_response as time_response,
)
from .sheet import save_png as save_png
from .sheet import sheet as sheet
from .spreading import (
    cell_from_above as cell_from_above,
)
from .spreading import (
    cell_from_side as cell_from_side,
)
from .spreading import (
    cells_from_above as cells_from_above,
)
from .spreading import (
    displacement_field as displacement_field,
)
from .spreading import (
    pair_gaps as pair_gaps,
)
from .spreading import (
    trajectory as trajectory,
)
from .tractions import traction_field as traction_field
