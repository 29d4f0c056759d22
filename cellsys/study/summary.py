"""What ``summary.json`` holds of each kind of study, and how it becomes plain values."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from cellsys.study.measure import OrderRow
from cellsys.system import Event

_LEFT_OUT = {"left out": True}  # of a field that is not written where it is None
Row: TypeAlias = Mapping[str, float]


def tabled(value: object) -> object:
    """Dataclasses as tables of their fields, tuples as lists; numbers and texts as they are."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return table_of(value)
    if isinstance(value, Mapping):
        return {key: tabled(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [tabled(part) for part in value]
    return value


def table_of(summary: object) -> dict[str, object]:
    """The fields of a dataclass by name, but for those left out where they are None."""
    if isinstance(summary, type) or not dataclasses.is_dataclass(summary):
        return {}
    found = {f.name: getattr(summary, f.name) for f in dataclasses.fields(summary)}
    hidden = {f.name for f in dataclasses.fields(summary) if "left out" in f.metadata}
    return {k: tabled(v) for k, v in found.items() if v is not None or k not in hidden}


@dataclass(frozen=True)
class PoleRow:
    """A pole of the plant, 1/s, and its bound."""

    real: float
    imag: float
    bound: float


@dataclass(frozen=True)
class ChargedPole:
    """A pole of the equivariant model, 1/s, and its charge."""

    real: float
    imag: float
    charge: int


@dataclass(frozen=True)
class Verdict:
    """Stable or not, and why."""

    verdict: str
    reason: str


@dataclass(frozen=True)
class SensorError:
    """Error of a sensor: of its direction, deg, or of the contrast that a graded cue stands for."""

    training: float
    held_out: float
    constant_direction: float


@dataclass(frozen=True)
class HeadingError:
    """Heading of a reduced loop against the full-order one, deg."""

    rms: float
    end: float


@dataclass(frozen=True, kw_only=True)
class LoopSummary:
    """The polarity loop on the plant, or why there is none."""

    why_not: str | None
    sensor_error_deg: SensorError | None = dataclasses.field(default=None, metadata=_LEFT_OUT)
    sensor_error_of_g: SensorError | None = dataclasses.field(default=None, metadata=_LEFT_OUT)
    heading_error_deg: HeadingError | None = dataclasses.field(default=None, metadata=_LEFT_OUT)
    linearisation: str | None = dataclasses.field(default=None, metadata=_LEFT_OUT)


@dataclass(frozen=True)
class NotThere:
    """Why something is missing."""

    why_not: str


@dataclass(frozen=True)
class ClockedLoop:
    """The polarity loop on the equivariant model."""

    heading_error_deg: HeadingError
    margins: Mapping[str, object] | None
    why_no_margins: str | None


@dataclass(frozen=True, kw_only=True)
class EquivariantSummary:
    """The equivariant model."""

    why_not: None = None
    card: Mapping[str, object]
    poles: tuple[ChargedPole, ...]
    fit_seconds: float
    loop: ClockedLoop | NotThere


@dataclass(frozen=True, kw_only=True)
class StudySummary:
    """A study of one steered cell on a matrix."""

    scene: str
    fingerprint: str
    magnitudes: Row
    step_residual_share: Row
    card: Mapping[str, object]
    poles: tuple[PoleRow, ...]
    stability: Verdict
    margins: Mapping[str, object] | None
    loop: LoopSummary
    orders: tuple[OrderRow, ...]
    full_order_s: float
    why_lower_order: str | None
    equivariant: EquivariantSummary | NotThere
    trust: str
    wall_time_s: float | None = dataclasses.field(default=None, metadata=_LEFT_OUT)


@dataclass(frozen=True, kw_only=True)
class ReducedSummary:
    """Reduced cells against the full-order run: errors as shares, deg, s."""

    error_on_cells: float
    error_on_matrix: float
    error_of_superposed_cells_alone: float
    heading_rms_deg: float
    steered: bool
    seconds: float
    events: tuple[Event, ...]


@dataclass(frozen=True, kw_only=True)
class CellsSummary:
    """A study of several cells, of none, or of none that is steered."""

    scene: str
    fingerprint: str
    cells: Mapping[str, Row]
    matrix: Row
    pairs: Mapping[str, Row]
    events: tuple[Event, ...]
    reduced: ReducedSummary | None
    full_order_s: float
    step_residual_share: Row
    verdict: str
    wall_time_s: float | None = dataclasses.field(default=None, metadata=_LEFT_OUT)


@dataclass(frozen=True, kw_only=True)
class CrawlerSummary:
    """A study of a scene on a chain."""

    scene: str
    fingerprint: str
    outcome: str
    reason: str
    switches: int
    chatter: int
    cells: Mapping[str, Row]
    integrator: str
    full_order_s: float
    wall_time_s: float | None = dataclasses.field(default=None, metadata=_LEFT_OUT)
