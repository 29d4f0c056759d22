"""The card of a model: what was learned from what, how wrong it is, and the verdict in words.

Errors are taken over whole roll-outs from the start with the commands as only input:

    relative error = rms(x_model - x) / rms(x - x_0)       ("nothing moves" scores 1)

beside the projection floor (best any model in this basis can do) and the baselines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

DIVERGED = 1e6  # a relative error beyond this is reported as "diverges"


@dataclass(frozen=True)
class Card:
    """What a model is worth.

    Parameters
    ----------
    order, method, scale : int, str, str
    samples, columns : int
        Size of the training data.
    spectral_abscissa : float
        1/s, of the continuous poles.
    training, held_out : mapping
        ``{block: {"model", "floor", "nothing moves", "mean velocity", "mean motion", "mse"}}``;
        relative errors, and the model's MSE [thesis eq. 86] in um^2. Empty where not measured.
    verdict : str
        One sentence.
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
    facts: Mapping[str, Any] = field(default_factory=dict)
    floors: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def table(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self) | {"runs": list(self.runs), "warnings": list(self.warnings)}

    def __str__(self) -> str:
        lines = [
            f"order {self.order}, {self.method}, scale={self.scale!r}, "
            f"{self.samples} samples x {self.columns} columns from {len(self.runs)} runs",
            f"spectral abscissa {self.spectral_abscissa:.3g} 1/s",
        ]
        if self.input_share_explained is not None:
            lines.append(
                f"commands explain {100 * self.input_share_explained:.0f} % of the input u"
            )
        for title, rows in (("training", self.training), ("held out", self.held_out)):
            for block, row in rows.items():
                parts = ", ".join(
                    f"{k} {_number(v)}{' um^2' if k == 'mse' else ''}" for k, v in row.items()
                )
                lines.append(f"{title:9s} {block}: {parts}")
        for title, known in (("known", self.facts), ("floor", self.floors)):
            lines += [f"{title:9s} {key}: {_shown(value)}" for key, value in known.items()]
        lines += [f"warning: {text}" for text in self.warnings]
        lines.append(f"verdict: {self.verdict}")
        return "\n".join(lines)


def _shown(value: Any) -> str:
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


def verdict(
    order: int,
    abscissa: float,
    training: Mapping[str, Mapping[str, float]],
    held_out: Mapping[str, Mapping[str, float]],
) -> str:
    """One sentence on what the model can be trusted for."""
    shown = held_out or training
    where = "held out" if held_out else "in training"
    if not shown:
        return f"order {order}: not measured against data."
    block, row = next(iter(shown.items()))
    model, best_name = (
        row["model"],
        min((k for k in BASELINES if k in row), key=lambda k: row[k]),
    )
    best = row[best_name]
    if not model < DIVERGED:
        text = f"order {order}: its roll-out diverges {where}; do not predict with it"
    elif model >= best:
        text = (
            f"order {order}: {where} its error on {block} is {model:.2f} of the motion, worse than "
            f"{best_name} ({best:.2f}); do not predict with it"
        )
    else:
        text = (
            f"order {order}: {where} its error on {block} is {model:.2f} of the motion, better "
            f"than {best_name} ({best:.2f}); its basis allows {row['floor']:.2f}"
        )
    grows = f"; it has a growing mode ({abscissa:.2g} 1/s)" if abscissa > 0 else ""
    return text + grows + "."
