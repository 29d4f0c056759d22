"""What a study of one steered cell computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel
from cellsys.loop import ClosedLoop, Linearisation
from cellsys.model import LatentModel
from cellsys.response import Margins, RootSet
from cellsys.scene import Scene
from cellsys.shown import Shown
from cellsys.study.equivariant import EquivariantStudy
from cellsys.study.measure import OrderSweep, read_out_name, texts
from cellsys.study.summary import StudySummary, table_of
from cellsys.trajectory import Trajectory


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class StudyResult(Shown):
    """What `study` computed; everything the report shows.

    Attributes
    ----------
    run : Trajectory
        The scene itself, full-order.
    models : mapping of (method, order) to ReducedModel
    model : LatentModel
        The plant of the loop: PCR at the order of the Bode plot.
    sweep : OrderSweep
    poles : RootSet
        Of the plant, 1/s, with the larger of the bounds of rounding and data.
    loop, reduced, linear, margins
        Closed loop, its simulation, linearisation and margins on kappa; None without polarity.
    told : StudySummary
        What ``summary.json`` holds; `summary` is the same as plain tables.
    out : Path
    equivariant : EquivariantStudy
        The equivariant model and its loop, or why there is none.
    """

    scene: Scene
    run: Trajectory
    models: Mapping[tuple[str, int], ReducedModel]
    model: LatentModel
    sweep: OrderSweep
    poles: RootSet
    loop: ClosedLoop | None
    reduced: Trajectory | None
    linear: Linearisation | None
    margins: Margins | None
    magnitudes: Mapping[str, float]
    told: StudySummary
    out: Path
    equivariant: EquivariantStudy

    @property
    def summary(self) -> Mapping[str, object]:
        """What ``summary.json`` holds, as plain tables."""
        return table_of(self.told)

    def __str__(self) -> str:
        return self.told.trust

    def report(self) -> str:
        """The study in words and tables, for a terminal."""
        lines = [str(self.run), ""]
        told = texts(self.magnitudes).items()
        lines += [f"  {read_out_name(k):34s} {v}" for k, v in told]
        lines += ["", f"poles of the reduced model (PCR, m = {self.model.order}), 1/s:"]
        if self.told.why_lower_order:
            lines.append(f"  ({self.told.why_lower_order})")
        for pole, bound in zip(np.asarray(self.poles), self.poles.error_bound, strict=True):
            lines.append(f"  {pole.real: .3e} {pole.imag:+.3e}j   +- {bound:.1e}")
        stable = self.told.stability
        lines += [f"  {stable.verdict}: {stable.reason}", ""]
        if self.margins is None:
            lines.append(f"no polarity loop: {self.told.loop.why_not}")
        else:
            lines += [
                "polarity loop, cut at kappa:",
                *(f"  {m}" for m in str(self.margins).split("\n")),
            ]
        lines += ["", str(self.sweep)]
        lines.append(f"  full-order model: {self.sweep.full_order_s:.3g} s for the same run")
        lines += ["", *self.equivariant.lines()]
        return "\n".join([*lines, "", str(self)])
