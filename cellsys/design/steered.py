"""`Steered`: commands that bring cells somewhere, what the reduced loop says, and the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellsys.arguments import checked
from cellsys.design.target import Target
from cellsys.effects.commands import Commands, History
from cellsys.errors import DimensionError
from cellsys.scene.ensemble import run_scene
from cellsys.scene.scene import Scene
from cellsys.shown import Shown
from cellsys.trajectory import Trajectory


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Miss(Shown):
    """How far from the target: each NaN where the target does not say.

    Attributes
    ----------
    place : float
        Of the cell that is farthest off, um.
    heading : float
        rad, of the cell that is farthest off.
    gap : float
        um, signed: too wide is positive.
    """

    place: float
    heading: float
    gap: float

    def within(self, target: Target, *, band: float = 0.0) -> bool:
        """Whether all of it is within the target's tolerances, places within these less `band`."""
        far = [abs(v) for v in (self.place, self.gap) if np.isfinite(v)]
        turned = np.isfinite(self.heading) and self.heading > target.turned_within
        return all(v <= target.within - band for v in far) and not turned

    def __str__(self) -> str:
        parts = []
        if np.isfinite(self.place):
            parts.append(f"{self.place:.2f} um from the place")
        if np.isfinite(self.heading):
            parts.append(f"{np.degrees(self.heading):.1f} deg from the heading")
        if np.isfinite(self.gap):
            parts.append(f"gap {self.gap:+.2f} um")
        return ", ".join(parts)


def miss_of(target: Target, places: np.ndarray, headings: np.ndarray, line: np.ndarray) -> Miss:
    """`Miss` of centroids (K, 2) and headings (K,); `line` (2,) joins two cells at the start."""
    far, turned, gap = float("nan"), float("nan"), float("nan")
    if target.place is not None:
        off = np.nan_to_num(places - target.place)
        far = float(np.linalg.norm(off, axis=1).max())
    if target.heading is not None:
        turned = float(np.abs(np.angle(np.exp(1j * (headings - target.heading)))).max())
    if target.gap is not None:
        gap = float(line @ (places[1] - places[0])) - target.gap
    return Miss(place=far, heading=turned, gap=gap)


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class SteeredRun:
    """The commands on the full-order model.

    Attributes
    ----------
    run : Trajectory
    places : (T, K, 2)
        Centroids, um.
    miss : Miss
        At the end.
    closest : float
        Least distance of a centroid from the edge of an obstacle, um; inf without one.
    """

    run: Trajectory
    places: np.ndarray
    miss: Miss
    closest: float


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Steered(Shown):
    """What `cs.steer` found.

    Attributes
    ----------
    target : Target
    t : (N,)
        Knots of the commands, s.
    amplitude, heading : (N, K)
        Commands at the knots, linear between them; rad.
    times, places : (T,), (T, K, 2)
        The way of the centroids on the reduced loop, um.
    miss : Miss
        Of the reduced loop at the end.
    band : float
        Half width of the model's 95 % band of a coordinate of the centroid at the end, um; NaN
        where the model has none.
    clear : float
        Least distance of the reduced loop's centroids from the edge of an obstacle, um.
    effort : float
        Mean of (amplitude - 1)^2 and of the squared turn between knots, rad^2, together.
    full : SteeredRun or None
        The same commands on the full-order model.
    spent : mapping of str to float
        Iterations of IPOPT over all starts, and s.
    """

    target: Target
    t: np.ndarray
    amplitude: np.ndarray
    heading: np.ndarray
    times: np.ndarray
    places: np.ndarray
    miss: Miss
    band: float
    clear: float
    effort: float
    full: SteeredRun | None
    spent: Mapping[str, float]

    @property
    def verdict(self) -> str:
        """What is said before the run: reaches, may reach, or will not reach."""
        band = self.band if np.isfinite(self.band) else 0.0
        if self.miss.within(self.target, band=band) and np.isfinite(self.band):
            return "reaches"
        if self.miss.within(self.target):
            return "may reach"
        return "may reach" if self.miss.within(self.target, band=-band) else "will not reach"

    @property
    def commands(self) -> tuple[Commands, ...]:
        """Of each cell, as a scene takes them."""
        return tuple(
            Commands(
                heading=History(tuple(self.t.tolist()), tuple(h.tolist())),
                amplitude=History(tuple(self.t.tolist()), tuple(a.tolist())),
            )
            for h, a in zip(self.heading.T, self.amplitude.T, strict=True)
        )

    def scene(self, scene: Scene) -> Scene:
        """The scene under these commands, as long as they are."""
        cells = scene.membranes
        if len(cells) != self.heading.shape[1]:
            raise DimensionError(
                f"scene has {len(cells)} cells, the commands are for {self.heading.shape[1]}"
            )
        told = tuple(replace(c, commands=m) for c, m in zip(cells, self.commands, strict=True))
        return replace(scene, cells=told, commands=Commands(), duration=float(self.t[-1]))

    def check(self, scene: Scene, folder: str | None = None) -> Steered:
        """The same with `full`: run on the full-order model of the scene, cached in `folder`."""
        run = run_scene(self.scene(scene), folder)
        K = self.heading.shape[1]
        nodes = [np.asarray(run.block(f"cell{k + 1}.position")) for k in range(K)]
        places = np.stack([n.mean(axis=1)[:, :2] for n in nodes], axis=1)
        p = np.asarray(run.p)[-1]
        line = unit_line(self.places[0])
        miss = miss_of(self.target, places[-1], np.arctan2(p[:, 1], p[:, 0]), line)
        return replace(
            self, full=SteeredRun(run=run, places=places, miss=miss, closest=float("nan"))
        )

    def __str__(self) -> str:
        band = f"+- {self.band:.2f} um at 95 %" if np.isfinite(self.band) else "without a band"
        lines = [
            f"{self.verdict}: {self.target} in {self.t[-1]:g} s",
            f"  reduced loop {self.miss} ({band}), effort {self.effort:.3g}",
        ]
        if np.isfinite(self.clear):
            lines.append(f"  {self.clear:.2f} um clear of obstacles")
        if self.full is not None:
            inside = "reached" if self.full.miss.within(self.target) else "not reached"
            lines.append(f"  full order   {self.full.miss}: {inside}")
        return "\n".join(lines)


def unit_line(places: np.ndarray) -> np.ndarray:
    """Direction (2,) from the first to the second place; zero for one."""
    if len(places) < 2:
        return np.zeros(2)
    line = places[1] - places[0]
    return line / max(float(np.linalg.norm(line)), 1e-300)
