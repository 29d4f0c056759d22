"""Public names of earlier versions: the new object, and a DeprecationWarning that names it.

One table for the whole package. A module that once had a name takes its ``__getattr__`` from
`old_names`; what stands here is kept for one version.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping

# module -> old name -> where the object is now
NAMES: Mapping[str, Mapping[str, str]] = {
    "cellsys": {
        "BudgetError": "cellsys.MemoryBudgetError",
        "Perturb": "cellsys.AntiparallelTurn",
        "Stay": "cellsys.AntiparallelStay",
        "grid": "cellsys.candidates",
        "sensitivities": "cellsys.parameter_sensitivities",
    },
    "cellsys.bondgraph": {"Element": "cellsys.bondgraph.BondElement"},
    "cellsys.errors": {"BudgetError": "cellsys.errors.MemoryBudgetError"},
    "cellsys.integrate": {"sensitivities": "cellsys.integrate.parameter_sensitivities"},
    "cellsys.loop": {
        "Perturb": "cellsys.loop.AntiparallelTurn",
        "Stay": "cellsys.loop.AntiparallelStay",
    },
    "cellsys.reduction": {
        "grid": "cellsys.reduction.candidates",
        **{
            name: f"cellsys.{name}"
            for name in (
                "Card", "CellsOnField", "Clock", "Contraction", "Equivariant",
                "EquivariantModel", "ErrorBands", "FieldPassivity", "Flag", "Forecast",
                "FullField", "GalerkinField", "LatentModel", "PolarPort", "RunData", "Snapshots",
                "StiffnessSensor", "TrainedRange", "ValidityMonitor", "assess", "contraction",
                "fit_sensor", "full_field", "realisation_floor", "snapshots", "with_matrix",
            )
        },
    },
}  # fmt: skip
# old module -> the module that took its place
MODULES: Mapping[str, str] = {
    "cellsys.response.loci": "cellsys.response.eigenvalue_loci",
    "cellsys.response.locus": "cellsys.response.root_locus",
    "cellsys.response.loop": "cellsys.response.sensitivity_functions",
}


def old_names(
    module: str, otherwise: Callable[[str], object] | None = None, *, frames: int = 0
) -> Callable[[str], object]:
    """``__getattr__`` of a module that once had other names.

    Parameters
    ----------
    module : str
        Its ``__name__``. A module of `MODULES` answers with what the new module has.
    otherwise : callable, optional
        The ``__getattr__`` that the module has already, asked for every other name.
    frames : int
        Calls between the line that asked for the name and the returned function.
    """

    def __getattr__(name: str) -> object:
        here = f"{module}.{name}"
        if here in MODULES:
            _warn(here, MODULES[here], frames)
            return importlib.import_module(MODULES[here])
        if name in NAMES.get(module, {}):
            there = NAMES[module][name]
            _warn(here, there, frames)
            parent, _, attribute = there.rpartition(".")
            return getattr(importlib.import_module(parent), attribute)
        if module in MODULES and not name.startswith("__"):
            new = importlib.import_module(MODULES[module])
            if name in vars(new):
                _warn(here, f"{MODULES[module]}.{name}", frames)
                return vars(new)[name]
        if otherwise is not None:
            return otherwise(name)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return __getattr__


def _warn(old: str, new: str, frames: int) -> None:
    # 3: past `__getattr__`, to the line that asked.
    warnings.warn(f"{old} is now {new}", DeprecationWarning, stacklevel=3 + frames)
