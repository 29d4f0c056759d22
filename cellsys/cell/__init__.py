"""The equivariant cell: a reduced cell that respects rotations and mirror images.

A model is read and asked without what trains it: compiled kernels are loaded where they are used.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach(
    __name__,
    submod_attrs={
        "forecast": ["ErrorBands", "Forecast", "ValidityMonitor"],
        "model": ["EquivariantModel"],
        "on_field": ["CellsOnField"],
        "on_matrix": ["with_matrix"],
        "port": ["PolarPort"],
        "radial": ["RadialCell"],
        "reductor": ["Equivariant"],
        "schedule": ["Clock"],
        "worth": ["realisation_floor"],
    },
)
