"""Running a crawler, and saying how the run ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import Integrator
from cellsys.drawable import Drawable
from cellsys.errors import IntegrationError
from cellsys.integrate.simulate import simulate
from cellsys.mechanics.crawler import CrawlerSystem
from cellsys.system import Event
from cellsys.trajectory import Trajectory

QUIET_SHARE = 0.2  # of the run without a switch: a stall
QUIET_STEPS = 5.0  # and at least this many of the run's own intervals
CHATTER = 1e-3  # intervals below this share of the median one are chatter


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class CrawlRun(Drawable):
    """A crawler's run and its outcome.

    Attributes
    ----------
    trajectory : Trajectory or None
        None where the run was stopped.
    outcome : {"finished", "stalled", "stopped"}
    reason : str
        For each cell why it stalled, or why the run was stopped; empty where it finished.
    chatter : int
        Switches of a cell that followed its last one at once, or within a thousandth of its median
        interval. Two cells that switch at the same time do not chatter.
    """

    system: CrawlerSystem
    trajectory: Trajectory | None
    outcome: str
    reason: str
    chatter: int
    _figure: ClassVar[str] = "crawler_run"

    def switches(self, name: str = "") -> np.ndarray:
        """Times (s) of the switches whose name contains `name`, in order."""
        events = self.trajectory.events if self.trajectory is not None else ()
        return np.array([e.time for e in events if name in e.name])

    def __str__(self) -> str:
        n = len(self.switches())
        chatter = f", {self.chatter} of them chatter" if self.chatter else ""
        reason = f": {self.reason}" if self.reason else ""
        return f"crawler {self.outcome}{reason} ({n} switches{chatter})"


@checked
def crawl(
    system: CrawlerSystem, integrator: Integrator, t: np.ndarray, x0: np.ndarray | None = None
) -> CrawlRun:
    """Simulate a crawler and name the outcome.

    Parameters
    ----------
    system : CrawlerSystem
    integrator : DOP853, LSODA or Radau
        LSODA or Radau where the chain's drag is small (below about 0.05 pN s/um).
    t : array (T,)
        Sample times, s.
    x0 : array (n,), optional
        Initial state.

    Returns
    -------
    CrawlRun
        An integrator that gives up or chatters ends the run as "stopped", with its message.
    """
    try:
        run = simulate(system, integrator, t, x0)
    except IntegrationError as error:
        return CrawlRun(
            system=system, trajectory=None, outcome="stopped", reason=str(error), chatter=0
        )
    return judge(system, run)


def judge(system: CrawlerSystem, run: Trajectory) -> CrawlRun:
    """Name the outcome of a crawler's trajectory: finished, or stalled and why."""
    reason = _stall(system, run)
    return CrawlRun(
        system=system,
        trajectory=run,
        outcome="stalled" if reason else "finished",
        reason=reason,
        chatter=chatter(run.events),
    )


def chatter(events: tuple[Event, ...]) -> int:
    """Switches of one cell at once after its last, or within 1e-3 of its median interval."""
    count = 0
    for cell in {e.name.split(" ")[0] for e in events}:
        gaps = np.diff([e.time for e in events if e.name.startswith(cell + " ")])
        usual = float(np.median(gaps[gaps > 0])) if np.any(gaps > 0) else 0.0
        count += int(np.sum(gaps <= CHATTER * usual))
    return count


def _stall(system: CrawlerSystem, run: Trajectory) -> str:
    """Why each cell that no longer switches has stopped; empty where all still switch."""
    span = float(run.t[-1] - run.t[0])
    reasons = []
    for k in range(len(system.cells)):
        name = f"cell{k + 1}"
        times = np.array([e.time for e in run.events if e.name.startswith(name + " ")])
        last = times[-1] if times.size else float(run.t[0])
        usual = float(np.median(np.diff(times))) if times.size > 2 else 0.0
        if run.t[-1] - last > max(QUIET_SHARE * span, QUIET_STEPS * usual):
            reasons.append(f"{name} after {last:.4g} s, {_why(system, np.asarray(run.x)[-1], k)}")
    return "; ".join(reasons)


def _why(system: CrawlerSystem, x: np.ndarray, k: int) -> str:
    cell, K, N = system.cells[k], len(system.cells), system.chain.nodes
    held = x[8 * K + N :].astype(int)
    ahead = int(held[2 * k]) + cell.heading
    if not 1 <= ahead <= N:
        return "its lead holds the last node of the chain"
    for other in range(K):
        if other != k and ahead in held[2 * other : 2 * other + 2]:
            return f"cell{other + 1} holds the node ahead of its lead"
    b = 8 * k
    lead = cell.heading * (x[b + 5] - x[b])
    trail = cell.heading * (x[b + 1] - x[b + 4])
    return (
        f"its lead adhesion stays stretched by {lead:.3g} um (grab {cell.grab:g}) and its trail "
        f"adhesion by {trail:.3g} um (rupture {cell.rupture:g})"
    )
