"""The effects a scene can name: an explicit list, entry points of other packages, given classes.

A file is imported when a scene names its effect, not before. Another package adds an effect by

    [project.entry-points."cellsys.effects"]
    magnet = "my_package.magnet:Magnet"

and a script by `Scene.parse(table, effects=[Magnet])`. A shipped effect whose file was taken out
of the package is not offered.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path

from cellsys.effects.protocol import Effect
from cellsys.errors import ParameterError
from cellsys.store.hashing import fingerprint

GROUP = "cellsys.effects"
_HOME = "cellsys.effects."
_MATRICES = "cellsys.scene."

# In the order in which their elements are attached, which is the order of the auxiliaries.
LISTED: dict[str, str] = {
    "drag": "matrix:Drag",
    "membrane_elasticity": "membrane:MembraneElasticity",
    "volume": "volume:Volume",
    "cortical_tension": "membrane:CorticalTension",
    "focal_adhesion": "adhesion:FocalAdhesion",
    "lamellipodium": "steering:Lamellipodium",
    "substrate_contact": "substrate_contact:SubstrateContact",
    "matrix_elasticity": "matrix:MatrixElasticity",
    "foundation": "matrix:Foundation",
    "external_load": "external_load:ExternalLoad",
    "stiffness_sensing": "steering:StiffnessSensing",
    "polarity": "steering:Polarity",
    "external_strain": "external_strain:ExternalStrain",
    "fibre_bending": "fibre_bending:FibreBending",
    "matrix_creep": "matrix_creep:MatrixCreep",
    "cortex": "cortex:Cortex",
    "nucleus": "nucleus:Nucleus",
    "stochastic_adhesion": "stochastic_adhesion:StochasticAdhesion",
    "stress_fibres": "stress_fibres:StressFibres",
    "cell_contact": "cell_contact:CellContact",
    "matrix_degradation": "matrix_degradation:MatrixDegradation",
    "noise": "noise:Noise",
    "matrix_contact": "matrix_contact:MatrixContact",
}


class Registry(Mapping[str, type[Effect]]):
    """Effect classes by name, each imported when it is asked for.

    Parameters
    ----------
    given : iterable of Effect classes
        Effects of a script, beside the shipped ones and those of other packages.

    Raises
    ------
    ParameterError
        When two effects share a name, or an entry point does not hold an effect.
    """

    def __init__(self, given: Iterable[type[Effect]] = ()) -> None:
        self.given: dict[str, type[Effect]] = {}
        for effect in given:
            name = check_effect(effect, repr(effect))
            if name in LISTED or name in self.given:
                raise ParameterError(
                    f"there is an effect {name!r} already; give yours another name"
                )
            self.given[name] = effect

    @cached_property
    def shipped(self) -> dict[str, str]:
        """module:class of the listed effects whose file is there."""
        files = {path.partition(":")[0] for path in LISTED.values()}
        there = {file for file in files if find_spec(_HOME + file) is not None}
        return {n: p for n, p in LISTED.items() if p.partition(":")[0] in there}

    @cached_property
    def foreign(self) -> dict[str, EntryPoint]:
        """Entry points of other packages; those of a shipped name are refused when listed."""
        found: dict[str, EntryPoint] = {}
        for point in sorted(entry_points(group=GROUP)):
            if point.name in LISTED or point.name in found:
                raise ParameterError(
                    f"entry point {point.name!r} = {point.value!r} of group {GROUP!r}: there is an "
                    "effect of that name already; rename it in that package, or uninstall it"
                )
            found[point.name] = point
        return found

    def __getitem__(self, name: str) -> type[Effect]:
        if name in self.given:
            return self.given[name]
        if name in self.shipped:
            module, _, kind = self.shipped[name].partition(":")
            return getattr(importlib.import_module(_HOME + module), kind)
        point = self.foreign[name]
        try:
            effect = point.load()
        except (ImportError, AttributeError) as error:
            raise ParameterError(
                f"effect {name!r} = {point.value!r} does not load: {error}"
            ) from error
        if check_effect(effect, point.value) != name:
            raise ParameterError(
                f"entry point {name!r} = {point.value!r} holds the effect {effect.name!r}; "
                "the two names must agree"
            )
        return effect

    def __iter__(self) -> Iterator[str]:
        yield from self.shipped
        yield from self.foreign
        yield from (name for name in self.given if name not in self.foreign)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def names(self, asked: Iterable[str] = ()) -> tuple[str, ...]:
        """Names of all effects; other packages are looked through only for unknown `asked`."""
        near = (*self.shipped, *self.given)
        return near if all(name in near for name in asked) else tuple(self)

    def place(self, name: str) -> tuple[int, str]:
        """Sorts effects: the shipped ones as they are listed, then the others by name."""
        return (list(LISTED).index(name) if name in LISTED else len(LISTED), name)


def check_effect(effect: object, label: str) -> str:
    """Name of an effect class; ParameterError for anything else."""
    if not (isinstance(effect, type) and issubclass(effect, Effect)):
        raise ParameterError(f"{label} is not a class derived from Effect")
    if not effect.name.isidentifier():
        raise ParameterError(
            f"{label} needs a class attribute name, a word such as 'magnet'; got {effect.name!r}"
        )
    return effect.name


EFFECTS = Registry()


def source_of(effect: type) -> str:
    """Where an effect or a matrix comes from and a hash of that file; empty for the shipped ones.

    It is part of a scene's fingerprint: a changed law of a user's effect makes a new run.
    """
    module = sys.modules.get(effect.__module__)
    if effect.__module__.startswith((_HOME, _MATRICES)):
        return ""
    path = getattr(module, "__file__", None)
    code = Path(path).read_bytes() if path is not None and Path(path).is_file() else b""
    return f"{effect.__qualname__} {fingerprint(code)[:16]}"
