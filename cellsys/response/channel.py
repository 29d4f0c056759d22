"""One channel of a system, by name or number."""

from __future__ import annotations

from dataclasses import replace

from cellsys.errors import DimensionError, ParameterError
from cellsys.spectra.realization import Realization


def one_channel(
    system: Realization, input: str | int | None = None, output: str | int | None = None
) -> Realization:
    """The system from one input to one output.

    Raises
    ------
    DimensionError
        Several channels and none named.
    ParameterError
        A name or number that there is not.
    """
    j = _place(input, system.inputs, system.n_inputs, "input")
    i = _place(output, system.outputs, system.n_outputs, "output")
    return replace(
        system,
        B=system.B[:, j : j + 1],
        C=system.C[i : i + 1],
        D=system.D[i : i + 1, j : j + 1],
        inputs=system.inputs[j : j + 1],
        outputs=system.outputs[i : i + 1],
    )


def _place(wanted: str | int | None, names: tuple[str, ...], count: int, side: str) -> int:
    if wanted is None:
        if count != 1:
            raise DimensionError(
                f"this is read off one channel, and the system has {count} {side}s "
                f"({', '.join(names[:6])}{', ...' if count > 6 else ''}); name one: {side}=..."
            )
        return 0
    if isinstance(wanted, str):
        if wanted not in names:
            raise ParameterError(
                f"{side} = {wanted!r} is none of {', '.join(names[:20])}"
                f"{', ...' if count > 20 else ''}"
            )
        return names.index(wanted)
    if not 0 <= wanted < count:
        raise ParameterError(f"{side} = {wanted!r} must lie in 0..{count - 1}")
    return wanted
