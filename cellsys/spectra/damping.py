"""Damping table: what a person reads off a list of poles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.spectra.certainty import PoleCertainty, side
from cellsys.spectra.poles import poles
from cellsys.spectra.roots import RootSet


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class DampingTable(Drawable):
    """One row per pole; arrays (n,), ordered like `poles` (falling real part).

    Attributes
    ----------
    poles : RootSet
        1/s, or numbers of the z plane.
    frequency : array
        |s|, rad/s; of s = log(z)/dt in discrete time.
    damping : array
        Damping ratio -Re s / |s|; nan for s = 0 (an integrator).
    time_constant : array
        -1 / Re s, s: negative for a growing mode, inf on the axis (to within the error bound).
    condition : array
        Condition number of the eigenvalue.
    error_bound : array
        Error bound of the pole; the larger of rounding and data where a certainty is given.
    cluster_size : int array
        Number of poles that cannot be told apart from it, itself included.
    """

    _figure: ClassVar[str] = "pole_zero_map"
    poles: RootSet
    frequency: np.ndarray
    damping: np.ndarray
    time_constant: np.ndarray
    condition: np.ndarray
    error_bound: np.ndarray
    cluster_size: np.ndarray

    def __len__(self) -> int:
        return len(self.poles)

    def __str__(self) -> str:
        head = f"{'pole':>26} {'rad/s':>10} {'damping':>8} {'tau (s)':>10} {'cond':>8} {'+-':>8} n"
        lines = [head] if not self.poles.note else [self.poles.note, head]
        for i in range(min(len(self), 40)):
            s = complex(self.poles[i])
            lines.append(
                f"{s.real:>13.5g}{s.imag:>+12.5g}j {self.frequency[i]:>10.4g} "
                f"{self.damping[i]:>8.4f} {self.time_constant[i]:>10.4g} "
                f"{self.condition[i]:>8.1e} {self.error_bound[i]:>8.1e} {self.cluster_size[i]}"
            )
        if len(self) > 40:
            lines.append(f"... and {len(self) - 40} more")
        return "\n".join(lines)


@checked
def damping(sys: LinearSystem, *, certainty: PoleCertainty | None = None) -> DampingTable:
    """Damping table of the poles, of continuous and discrete systems.

        s = sigma + j omega:  frequency |s|,  ratio zeta = -sigma/|s|,  time constant -1/sigma

    Discrete poles z are read through s = log(z)/dt.

    Parameters
    ----------
    sys : control.StateSpace or what `poles` takes
    certainty : PoleCertainty, optional
        See `poles`.

    Returns
    -------
    DampingTable

    Raises
    ------
    DataError, DimensionError, ParameterError, MemoryBudgetError
        As for `poles`.
    """
    found = poles(sys, certainty=certainty)
    z = np.asarray(found)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.log(z) / found.dt if found.dt > 0 else z
        size = np.abs(s)
        ratio = np.where(np.isinf(size), 1.0, -s.real / size)  # z = 0: gone after one step
        tau = -1.0 / s.real
    excess = np.abs(z) - 1 if found.dt > 0 else z.real
    on_axis = side(excess, found.error_bound) == 0
    tau = np.where(on_axis, np.inf, np.where(np.isinf(size), 0.0, tau))
    ratio = np.where(size == 0, np.nan, ratio)
    return DampingTable(
        poles=found,
        frequency=size,
        damping=ratio,
        time_constant=tau,
        condition=found.condition,
        error_bound=found.error_bound,
        cluster_size=found.cluster_size,
    )
