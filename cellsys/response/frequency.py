"""Frequency response in state space, with the accuracy reached at each frequency."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import LinearSystem
from cellsys.drawable import Drawable
from cellsys.errors import DataError, DimensionError, ParameterError
from cellsys.response import grid
from cellsys.response.phase import anchored, continuous_phase
from cellsys.spectra.realization import LARGEST, Realization, realization
from cellsys.spectra.resolvent import Resolvent, s_plane
from cellsys.units import real_array

if TYPE_CHECKING:
    import control


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class FrequencyResponse(Drawable):
    """G(j omega), or G(exp(j omega dt)), on a grid.

    Attributes
    ----------
    omega : array (k,)
        rad/s.
    response : complex array (p, m, k)
        Outputs, inputs, frequencies: the layout of ``control.FRD``.
    accuracy : array (p, m, k) or None
        Bound of the relative error of each entry; inf where nothing is known.
    dt : float
        0 in continuous time, else the sampling time, s.
    inputs, outputs : tuple of str
        Names.
    system : Realization, optional
        Whose response it is: where its phase starts is read from it.
    """

    _figure: ClassVar[str] = "bode"
    omega: np.ndarray
    response: np.ndarray
    accuracy: np.ndarray | None
    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    system: Realization | None = field(default=None, repr=False)

    @property
    def magnitude(self) -> np.ndarray:
        """|G|, (p, m, k)."""
        return np.abs(self.response)

    @cached_property
    def phase(self) -> np.ndarray:
        """Phase in rad, (p, m, k): a continuous curve from the low-frequency asymptote on.

            G -> K/s^m as s -> 0:  -90 m deg for K > 0, -90 m - 180 deg for K < 0

        1/s^3 starts at -270 deg. Without a system: unwrapped along the frequencies, from
        (-270, 90] deg.
        """
        if self.system is None:
            return anchored(np.unwrap(np.angle(self.response), axis=-1), 0.0)
        return continuous_phase(self.system, self.omega, self.response)

    @property
    def singular_values(self) -> np.ndarray:
        """Singular values of G at each frequency, falling, (min(p, m), k)."""
        G = np.moveaxis(self.response, -1, 0)
        if min(G.shape[1:]) == 0:
            return np.zeros((0, len(G)))
        return np.linalg.svd(G, compute_uv=False).T

    def to_frd(self) -> control.FrequencyResponseData:
        """As ``control.FrequencyResponseData``, names kept."""
        import control

        return control.frd(
            self.response,
            self.omega,
            self.dt,
            inputs=list(self.inputs),
            outputs=list(self.outputs),
        )

    def __len__(self) -> int:
        return len(self.omega)

    def __str__(self) -> str:
        p, m, k = self.response.shape
        text = f"frequency response, {p} outputs x {m} inputs, {k} frequencies"
        if k:
            text += f" {self.omega.min():.4g} .. {self.omega.max():.4g} rad/s"
        if self.response.size:
            text += f"; largest |G| {self.magnitude.max():.4g}"
            if self.accuracy is not None:
                text += f"; relative accuracy {self.accuracy.max():.1e} or better"
        return text


def check_omega(omega: object, system: Realization) -> np.ndarray:
    """Frequencies as a finite 1-D array within the Nyquist band, or a clear error."""
    array = np.atleast_1d(real_array(omega, "omega"))
    if array.ndim != 1:
        raise DimensionError(f"omega must be one-dimensional, got shape {array.shape}")
    if not np.all(np.isfinite(array)):
        raise DataError(f"omega[{int(np.flatnonzero(~np.isfinite(array))[0])}] is not finite")
    largest = float(np.abs(array).max(initial=0.0))
    if largest > LARGEST:
        raise DataError(f"omega reaches {largest:.3g} rad/s; it must stay below {LARGEST:g}")
    if system.is_discrete and np.any(np.abs(array) > np.pi / system.dt * (1 + 1e-9)):
        raise ParameterError(
            f"omega reaches {np.abs(array).max():.6g} rad/s, beyond the Nyquist frequency "
            f"pi/dt = {np.pi / system.dt:.6g} rad/s of this discrete system"
        )
    return array


@checked
def frequency_response(
    sys: LinearSystem, omega: np.ndarray | None = None, *, accuracy: bool = True
) -> FrequencyResponse:
    """Frequency response G = C (s I - A)^-1 B + D, never by way of a polynomial.

    The system is balanced and brought once to Hessenberg form per input (Schur form when inputs
    and outputs together are more than eight); then all frequencies are solved together in blocks.
    A sparse A (`Realization`) takes one sparse LU per frequency and is never made dense.

    Parameters
    ----------
    sys : control.StateSpace, TransferFunction (SISO), Realization or tuple of arrays
    omega : array (k,), optional
        rad/s. Left out: a grid from the poles and zeros, refined where G turns quickly.
    accuracy : bool
        Also give the bound of the relative error at each frequency,
        ``(10 + sqrt n) eps ((|A|_F + |s|) |C R| |R B| + |C| |R B| + |C R| |B|) / |G|`` with
        R = (s I - A)^-1, in balanced coordinates. Doubles the time.

    Returns
    -------
    FrequencyResponse
        ``.response`` (p, m, k) as in ``control.FRD``; ``.to_frd()`` makes one.

    Raises
    ------
    ParameterError
        A frequency is a pole, or lies beyond pi/dt of a discrete system.
    DataError, DimensionError
        NaN or inf, sizes that do not fit.
    MemoryBudgetError
        No omega given and A sparse with more than 1000 states.

    References
    ----------
    Laub, IEEE Trans. Automatic Control 26 (1981) 407; Wilkinson (1965) p. 426 (Hyman's method).
    """
    system = realization(sys)
    evaluate = Resolvent(system)
    if omega is None:
        array = grid.automatic(system)
        if min(system.n_inputs, system.n_outputs):
            array, _ = grid.refine(lambda w: _flat(evaluate(s_plane(w, system.dt))), array)
    else:
        array = check_omega(omega, system)
    s = s_plane(array, system.dt)
    G, bound = evaluate.with_accuracy(s) if accuracy else (evaluate(s), None)
    usable = np.isfinite(G).all(axis=(0, 1))
    if omega is None and not np.all(usable):  # the grid met an undamped pole
        array, G = array[usable], G[:, :, usable]
        bound = None if bound is None else bound[:, :, usable]
    elif not np.all(usable):
        bad = int(np.flatnonzero(~usable)[0])
        raise ParameterError(
            f"omega[{bad}] = {array[bad]!r} rad/s is a pole of the system (an integrator has one "
            "at 0); leave this frequency out"
        )
    if bound is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            bound = np.where(bound == 0, 0.0, bound / np.abs(G))
    return FrequencyResponse(
        omega=array,
        response=G,
        accuracy=bound,
        dt=system.dt,
        inputs=system.inputs,
        outputs=system.outputs,
        system=system,
    )


def _flat(G: np.ndarray) -> np.ndarray:
    """(p, m, k) -> (p m, k)."""
    return G.reshape(-1, G.shape[-1])
