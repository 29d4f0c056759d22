"""A few numbers of any run: how far cells spread and crawled, how far the matrix moved."""

from __future__ import annotations

import numpy as np

from cellsys.observe.spreading import contact_radius
from cellsys.trajectory import Trajectory


def read_outs(run: Trajectory) -> dict[str, float]:
    """Means over the cells at the end of a run; what a run does not have is left out.

    Returns
    -------
    dict
        ``contact_radius_um``, ``height_um`` and ``crawl_um`` (path of the centre, straight) of
        cells with a membrane, ``centre_um`` (mean shift of crawlers on a chain),
        ``matrix_displacement_um`` (rms over the nodes) and ``heading_change_deg``.
    """
    names = [b.name for b in run.states]
    cells = [n for n in names if n.startswith("cell") and n.count(".") == 1]
    membranes = [n for n in cells if n.endswith(".position")]
    out: dict[str, float] = {}
    if membranes:
        paths = [run.block(name) for name in membranes]
        out["contact_radius_um"] = float(np.mean([contact_radius(x[-1]) for x in paths]))
        out["height_um"] = float(np.mean([np.ptp(x[-1, :, 2]) for x in paths]))
        shift = [x[-1].mean(axis=0) - x[0].mean(axis=0) for x in paths]
        out["crawl_um"] = float(np.mean(np.linalg.norm(shift, axis=1)))
    leads = [n.rpartition(".")[0] for n in cells if n.endswith(".lead")]
    if leads:
        ends = [0.5 * (run.block(f"{n}.lead") + run.block(f"{n}.trail")) for n in leads]
        out["centre_um"] = float(np.mean([np.abs(x[-1] - x[0]) for x in ends]))
    for name in ("matrix.displacement", "chain.displacement"):
        if name in names:
            u = run.block(name)[-1]
            out["matrix_displacement_um"] = float(np.sqrt((u**2).sum() / len(u)))
    if run.p is not None:
        along = np.einsum("ij,ij->i", run.p[0], run.p[-1])
        out["heading_change_deg"] = float(np.degrees(np.arccos(np.clip(along, -1, 1))).mean())
    return out
