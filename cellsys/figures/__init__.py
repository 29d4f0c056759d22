"""Matplotlib drawing of every result object; no computing here.

Each function takes the result first and ``ax=None``, returns what it drew, never calls ``show``.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach(
    __name__,
    submod_attrs={
        "accuracy": ["work_precision"],
        "bondgraph": ["bond_graph"],
        "diagram": ["block_diagram"],
        "comparison": ["comparison", "learning_curve", "selection"],
        "crawler": [
            "chain_displacement",
            "crawler_predictions",
            "crawler_run",
            "error_against_amplitude",
            "row_displacement",
        ],
        "equivariant": ["bode_family", "equivariant_model", "forecast"],
        "frequency": ["bode", "nyquist"],
        "gel": ["gel_course", "gel_section", "gel_side", "gel_thickness"],
        "hard": ["hard_sweep"],
        "movie": ["write_movie"],
        "loop": ["headings", "linearisation"],
        "norms": ["system_norm"],
        "population": [
            "coupled_cells",
            "coupled_loop",
            "coupled_poles",
            "coupled_stability",
            "poles_against_cells",
        ],
        "reduction": [
            "error_against_time",
            "latent_model",
            "order_sweep",
            "pole_certainty",
            "pole_map",
        ],
        "sheet": ["save_png", "sheet"],
        "spreading": [
            "cell_from_above",
            "cell_from_side",
            "cells_from_above",
            "displacement_field",
            "pair_gaps",
            "trajectory",
        ],
        "tractions": ["traction_field"],
        "response": [
            "error_system",
            "hankel",
            "participation",
            "pole_zero_map",
            "pseudospectra",
            "root_locus",
            "sensitivity",
            "singular_values",
            "stability",
            "time_response",
        ],
    },
)
