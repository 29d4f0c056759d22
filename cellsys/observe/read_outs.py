"""A few numbers of any run: how far cells spread and crawled, how far the matrix moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import ReadOut
from cellsys.errors import ParameterError
from cellsys.observe.headings import heading_change_deg
from cellsys.observe.spreading import centre_height, contact_radius, crawl_distance
from cellsys.observe.tractions import pulling
from cellsys.trajectory import Trajectory, cell_names
from cellsys.units import real_number


@checked
def read_outs(run: Trajectory, more: Sequence[ReadOut] = ()) -> dict[str, float]:
    """Means over the cells of a run; what a run does not have is left out.

    Parameters
    ----------
    run : Trajectory
    more : sequence of functions of a run, optional
        Read-outs of your own, each a mapping of name to number; their names are new ones and end
        with the unit.

    Returns
    -------
    dict
        ``contact_radius_end_um``, ``height_end_um`` (of the cell), ``centre_height_end_um`` and
        ``crawl_um`` (`crawl_distance`) of cells with a membrane; ``crawl_um`` of crawlers on a
        chain is that of the middle between lead and trail. ``matrix_displacement_max_um`` over all
        nodes and samples, ``matrix_displacement_rms_end_um`` over the nodes at the last one, and
        ``heading_change_deg`` (how far cells turned, either way). Besides, what
        `traction_read_outs` tells of cells: tractions over the last sampling interval where the
        run holds auxiliaries, contact area, volume, strength of the cue.

    Raises
    ------
    ParameterError
        A name that is there already, or a value that is no number.
    """
    out: dict[str, float] = {}
    paths = [run.block(f"{name}.position") for name in cell_names(run.states)]
    if paths:
        out["contact_radius_end_um"] = float(np.mean([contact_radius(x[-1]) for x in paths]))
        out["height_end_um"] = float(np.mean([np.ptp(x[-1, :, 2]) for x in paths]))
        out["centre_height_end_um"] = float(np.mean([centre_height(x[-1]) for x in paths]))
        out["crawl_um"] = float(np.mean([crawl_distance(x) for x in paths]))
        out |= _means([pulling(run, name) for name in cell_names(run.states)])
    leads = [b.name.rpartition(".")[0] for b in run.states if b.name.endswith(".lead")]
    if leads:
        ends = [0.5 * (run.block(f"{n}.lead") + run.block(f"{n}.trail")) for n in leads]
        out["crawl_um"] = float(np.mean([np.abs(x[-1] - x[0]) for x in ends]))
    for name in ("matrix.displacement", "chain.displacement"):
        if name in run.states:
            u = run.block(name).reshape(len(run), -1, 3 if name.startswith("matrix") else 1)
            size = np.linalg.norm(u, axis=2)
            out["matrix_displacement_max_um"] = float(size.max())
            out["matrix_displacement_rms_end_um"] = float(np.sqrt(np.mean(size[-1] ** 2)))
    if run.p is not None:
        out["heading_change_deg"] = float(np.abs(heading_change_deg(run.p)).mean())
    for own in more:
        for name, value in own(run).items():
            if name in out:
                raise ParameterError(f"read-out {name!r} is there already; give yours another name")
            out[name] = real_number(value, f"read-out {name!r}")
    return out


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Mean over the cells of what all of them have."""
    names = [n for n in rows[0] if all(n in row for row in rows)]
    return {n: float(np.mean([row[n] for row in rows])) for n in names}


@checked
def read_out_errors(run: Trajectory) -> dict[str, float]:
    """How far each of `read_outs` may be off by the integrator and rounding, in its unit.

    From `Trajectory.error_of`, which an integrator with a tolerance finds by solving again: a
    centre is off by no more than a node, a difference of two nodes by twice as much. Read-outs
    without an entry have no such bound here.
    """
    out: dict[str, float] = {}
    cells = [run.error_of(f"{name}.position") for name in cell_names(run.states)]
    if cells:
        worst = max(cells)
        out |= {"crawl_um": worst, "centre_height_end_um": worst}
        out |= {"height_end_um": 2.0 * worst, "contact_radius_end_um": 2.0 * worst}
    if "matrix.displacement" in run.states:
        matrix = run.error_of("matrix.displacement")
        out |= dict.fromkeys(
            ("matrix_displacement_max_um", "matrix_displacement_rms_end_um"), matrix
        )
    return out
