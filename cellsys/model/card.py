"""The card of a model: what was learned from what, how wrong it is, and the verdict in words.

Errors are taken over whole roll-outs from the start with the commands as only input:

    relative error = rms(x_model - x) / rms(x - x_0)       ("nothing moves" scores 1)

beside the projection floor (best any model in this basis can do) and the baselines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import ReducedModel
from cellsys.errors import DataError, ParameterError
from cellsys.kinds import shown
from cellsys.printable import printable
from cellsys.shown import Shown

DIVERGED = 1e6  # a relative error beyond this is reported as "diverges"


@checked
@dataclass(frozen=True, kw_only=True)
class Card(Shown):
    """What a model is worth.

    Parameters
    ----------
    order, method, scale : int, str, str
    samples, columns : int
        Size of the training data.
    spectral_abscissa : float
        1/s, of the continuous poles.
    training, held_out : mapping
        ``{block: {"model", "floor", "nothing moves", "mean velocity", "mean motion", "mse",
        "resolution"}}``; relative errors, the model's MSE [thesis eq. 86: summed over the block's
        coordinates, mean over samples] in `unit` squared, and the least difference that these
        runs can tell. Empty where not measured.
    verdict : str
        One sentence.
    growth : (rate, bound)
        1/s, of the pole that most certainly grows: bound is the larger of rounding and data.
    unit : str
        Of the positions; empty where it is not known.
    facts : mapping
        What else is known of the model: data hashes, representation, certificates.
    floors : mapping
        Relative differences no model can go below: perturbation of the start, realisation of the
        network; where they were measured.
    warnings : tuple of str
        What the data cannot show.
    """

    order: int
    method: str
    scale: str
    samples: int
    columns: int
    runs: tuple[str, ...]
    spectral_abscissa: float
    training: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    held_out: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    input_share_explained: float | None = None
    verdict: str = ""
    facts: Mapping[str, object] = field(default_factory=dict)
    floors: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    growth: tuple[float, float] | None = None
    unit: str = "um"

    def __post_init__(self) -> None:
        for where in ("training", "held_out"):
            for block, row in getattr(self, where).items():
                if "model" not in row:
                    raise ParameterError(
                        f"{where}[{shown(block)}] must hold the error under 'model', got "
                        f"{', '.join(map(shown, row)) or 'nothing'}"
                    )

    def table(self) -> dict[str, object]:
        """Plain values for JSON."""
        growth = None if self.growth is None else [float(np.clip(v, *_SPAN)) for v in self.growth]
        lists = {"runs": list(self.runs), "warnings": list(self.warnings), "growth": growth}
        return asdict(self) | lists

    def __str__(self) -> str:
        lines = [
            f"order {self.order}, {self.method}, scale={self.scale!r}, "
            f"{self.samples} samples x {self.columns} columns from {len(self.runs)} runs",
            f"spectral abscissa {self.spectral_abscissa:.3g} 1/s",
        ]
        if self.growth is not None:
            rate, bound = self.growth
            lines[-1] += f"; most certain growth {rate:.3g} +- {bound:.1g} 1/s"
        if self.input_share_explained is not None:
            lines.append(
                f"commands explain {100 * self.input_share_explained:.0f} % of the input u"
            )
        for title, rows in (("training", self.training), ("held out", self.held_out)):
            for block, row in rows.items():
                square = f" {self.unit}^2" if self.unit else ""
                parts = ", ".join(
                    f"{k} {_number(v)}{square if k == 'mse' else ''}" for k, v in row.items()
                )
                lines.append(f"{title:9s} {block}: {parts}")
        for title, known in (("known", self.facts), ("floor", self.floors)):
            lines += [f"{title:9s} {key}: {_shown(value)}" for key, value in known.items()]
        lines += [f"warning: {text}" for text in self.warnings]
        lines.append(f"verdict: {self.verdict}")
        return printable("\n".join(lines))


def card_of(model: ReducedModel) -> Card:
    """The card of a model that has one.

    Raises
    ------
    DataError
        A model that was never measured on data.
    """
    if not isinstance(model.card, Card):
        raise DataError("this model has no card; cs.reduce makes a model with one")
    return model.card


_SPAN = (-float(np.finfo(float).max), float(np.finfo(float).max))


def _shown(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_shown(v)}" for k, v in value.items())
    if isinstance(value, (list, tuple)):
        return " ".join(_shown(v) for v in value)
    return f"{value:.3g}" if isinstance(value, float) else str(value)


BASELINES = (
    "nothing moves",
    "mean velocity",
    "mean motion",
    "nearest run",
    "linear in polarity",
    "body-frame mean",
)


def _number(value: float) -> str:
    return "diverges" if not value < DIVERGED else f"{value:.3g}"


EXACT = 1e-6  # a share of the motion below which an error is that of rounding


def resolution(rows: Mapping[str, Sequence[float]]) -> float:
    """Least difference between a model's error and the best baseline's that these runs can tell.

    `rows` hold one error a run. From three runs on: twice the standard error of the difference;
    with fewer nothing is known of it, and it counts as 0.
    """
    known = [k for k in BASELINES if k in rows]
    if len(rows["model"]) < 3 or not known:
        return 0.0
    values = {k: np.minimum(rows[k], DIVERGED) for k in ("model", *known)}
    best = min(known, key=lambda k: float(np.mean(np.square(values[k]))))
    apart = values["model"] - values[best]
    return 2.0 * float(np.std(apart, ddof=1)) / float(np.sqrt(len(apart)))


def compared(error: float, other: float, apart: float) -> str:
    """``"better"``, ``"worse"`` or ``"not told apart"``: said only beyond `apart`.

    Below `EXACT` both are rounding, whatever their ratio.
    """
    apart = max(apart, EXACT)
    if error < other - apart:
        return "better"
    return "worse" if error > other + apart else "not told apart"


def grows(growth: tuple[float, float]) -> str:
    """What may be said of a (rate, bound) in 1/s: a growth only beyond its bound."""
    rate, bound = growth
    if rate > bound:
        return f"; it has a growing mode ({rate:.2g} +- {bound:.1g} 1/s)"
    if rate > 0:
        return (
            f"; whether its slowest mode grows ({rate:.2g} +- {bound:.1g} 1/s) is not decided by "
            "the data"
            if bound > 1e-9
            else ""
        )
    return ""


def verdict(
    order: int,
    growth: tuple[float, float],
    training: Mapping[str, Mapping[str, float]],
    held_out: Mapping[str, Mapping[str, float]],
) -> str:
    """One sentence on what the model can be trusted for.

    Baselines count on held-out runs alone: what was fitted to a run says nothing by describing
    it. `growth` is the rate and the bound, 1/s, of the fastest growing mode.
    """
    shown = held_out or training
    if not shown:
        return f"order {order}: not measured against data{grows(growth)}."
    block, row = next(iter(shown.items()))
    model = row["model"]
    if not model < DIVERGED:
        where = "held out" if held_out else "in training"
        text = f"its roll-out diverges {where}; do not predict with it"
    elif not held_out:
        text = (
            f"no held-out run: training error only, {model:.2g} of the motion of {block} (its "
            f"basis allows {row['floor']:.2g})"
        )
        if model >= 1.0:
            text += ", no better than nothing moves; do not predict with it"
    else:
        text = _against_baselines(block, row)
    return f"order {order}: {text}{grows(growth)}."


def _against_baselines(block: str, row: Mapping[str, float]) -> str:
    """A held-out error beside the best baseline; better or worse only beyond the resolution."""
    model, name = row["model"], min((k for k in BASELINES if k in row), key=lambda k: row[k])
    best, apart = row[name], row.get("resolution", 0.0)
    head = f"held out its error on {block} is {model:.2f} of the motion"
    if max(model, best) <= EXACT:
        return f"{head}, and so is that of {name}: these runs cannot tell a model from it"
    word = compared(model, best, apart)
    if word == "better":
        return f"{head}, better than {name} ({best:.2f}); its basis allows {row['floor']:.2f}"
    if word == "worse":
        return f"{head}, worse than {name} ({best:.2f}); do not predict with it"
    return (
        f"{head}, not told apart from {name} ({best:.2f}) by these runs (+- {apart:.1g}); do not "
        "predict with it"
    )
