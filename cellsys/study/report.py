"""Figures and the self-contained HTML report of a study."""

from __future__ import annotations

import html
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellsys.errors import DataError
from cellsys.figures import (
    bode,
    cell_from_above,
    cell_from_side,
    equivariant_model,
    error_against_time,
    headings,
    order_sweep,
    pole_map,
    save_png,
    sheet,
)
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.model.card import card_of
from cellsys.observe.tractions import traction_ports, tractions
from cellsys.spectra.certainty import side
from cellsys.store import write_text
from cellsys.study.fields import draw_displacement
from cellsys.study.html import STYLE, image, table
from cellsys.study.measure import read_out_name, texts
from cellsys.study.measure import short_number as short
from cellsys.study.result import StudyResult
from cellsys.study.summary import ClockedLoop, EquivariantSummary


def write_figures(result: StudyResult, system: SpreadingSystem, folder: Path) -> dict[str, Path]:
    """Draw every figure of the report; returns name -> file."""
    drawn: dict[str, Path] = {}
    run, mesh, disc = result.run, system.cells[0].body.membrane, system.matrix
    if disc is None or result.scene.matrix is None:
        raise DataError("this report is of a cell on a matrix, and the scene has none")
    x, u = run.block("cell1.position"), run.block("matrix.displacement")

    figure, axes = sheet((10, 8), 2, 2, heights=(2.2, 1))
    for column, k in enumerate((0, -1)):
        cell_from_above(x[k], mesh.triangles, disc.position + u[k], disc.fibres, axes[0, column])
        axes[0, column].set_title(f"t = {run.t[k]:g} s")
        cell_from_side(x[k], mesh.triangles, axes[1, column])
    drawn["cell_and_matrix"] = save_png(figure, folder / "cell_and_matrix.png")

    drawn["displacement_field"] = draw_displacement(
        run, result.scene.matrix, folder / "displacement_field.png"
    )

    if traction_ports(run, "cell1"):  # a cell that is bound
        figure, axes = sheet((6.4, 5.2))
        tractions(run).plot(axes)
        drawn["traction_field"] = save_png(figure, folder / "traction_field.png")

    small = result.model
    large = max((m for n, m in result.models if n == "PCR"), default=small.order)
    figure, axes = sheet((10, 4.4), 1, 2)
    pole_map(np.asarray(result.poles), axes[0], spread=result.poles.error_bound)
    pole_map(np.asarray(result.models["PCR", large].pole_set()), axes[1])
    for ax, order in zip(axes, (small.order, large), strict=True):
        ax.set_title(f"PCR, m = {order}")
    drawn["pole_map"] = save_png(figure, folder / "pole_map.png")

    figure, axes = sheet((10, 4.4), 1, 2)
    order_sweep(result.sweep, axes[0])
    error_against_time(result.sweep, axes[1])
    drawn["error_against_order"] = save_png(figure, folder / "error_against_order.png")

    if result.margins is not None:
        figure, axes = sheet((7.5, 6), 2, sharex=True)
        bode(result.margins, axes)
        figure.suptitle("Return ratio of the polarity loop, cut at kappa")
        drawn["bode"] = save_png(figure, folder / "bode.png")
        figure, ax = sheet((8, 4.2))
        shown = {"full order": run}
        if result.reduced is not None:
            shown[f"reduced, m = {small.order}"] = result.reduced
        if result.equivariant.run is not None:
            shown["equivariant"] = result.equivariant.run
        headings(shown, ax)
        drawn["polarity"] = save_png(figure, folder / "polarity.png")
    if result.equivariant.model is not None:
        figure, ax = sheet((7.5, 4.6))
        equivariant_model(result.equivariant.model, ax)
        drawn["charges"] = save_png(figure, folder / "charges.png")
    return drawn


def _error(value: float) -> str:
    return short(value) if value < 1e6 else "diverges"


def _lasts(rate: float, bound: float) -> str:
    """Time constant of a pole, s; in words where its sign is that of a growth, or not known."""
    where = int(side(np.asarray(rate), np.asarray(bound)))
    return {-1: short(-1.0 / rate) if rate else "", 1: "grows"}.get(where, "not decided")


def write_report(result: StudyResult, figures: dict[str, Path], path: Path) -> None:
    """One HTML file with every figure inside, the card and the verdict."""
    told, card = result.told, card_of(result.model)
    verdict = html.escape(card.verdict)
    bounds = result.poles.note or "+-: rounding; the data are too few to leave some out"
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{html.escape(result.scene.name)}</title><style>{STYLE}</style></head><body>",
        f"<h1>{html.escape(result.scene.name)}</h1>",
        f"<p class='trust'><b>{html.escape(told.trust)}</b></p>",
        "<h2>The cell on its matrix</h2>",
        image(figures["cell_and_matrix"], "cell and matrix, before and after"),
        table(
            ("read-out", "value"),
            [(read_out_name(k), v) for k, v in texts(result.magnitudes).items()],
        ),
        image(figures["displacement_field"], "displacement field of the matrix"),
        image(figures["traction_field"], "tractions of the cell over the last interval")
        if "traction_field" in figures
        else "",
        "<p class='note'>Share of the rates that the stepping leaves over: "
        + ", ".join(
            f"{html.escape(k)} {100 * v:.2g} %" for k, v in told.step_residual_share.items()
        )
        + ".</p>",
        f"<h2>Poles of the reduced model</h2><p>{verdict}</p>",
        f"<p>{html.escape(told.why_lower_order)}</p>" if told.why_lower_order else "",
        image(figures["pole_map"], "pole maps"),
        f"<p class='note'>Circles: how certain each pole is ({html.escape(bounds)}). "
        f"Stability: {html.escape(told.stability.verdict)}"
        f" ({html.escape(told.stability.reason)}).</p>",
        table(
            ("pole (1/s)", "certainty (1/s)", "time constant (s)"),
            [
                (
                    f"{p.real:.3g} {p.imag:+.3g}j",
                    short(p.bound, 2),
                    _lasts(p.real, p.bound),
                )
                for p in told.poles
            ],
        ),
        "<h2>The polarity loop</h2>",
        *_loop_part(result, figures, verdict),
        "<h2>The cell by its symmetry</h2>",
        *_equivariant_part(result, figures),
        "<h2>What accuracy costs in time</h2>",
        image(figures["error_against_order"], "error against order and against time"),
        table(
            ("model", "m", "error on cells", "error on matrix", "floor", "roll-out (ms)"),
            [
                (
                    r.method,
                    str(r.order),
                    _error(r.error["cells"]),
                    _error(r.error["matrix"]) if "matrix" in r.error else "-",
                    short(r.floor["cells"]),
                    short(r.roll_out_ms),
                )
                for r in result.sweep.rows
            ],
        ),
        f"<p class='note'>Errors on held-out runs, whole roll-out, relative to the motion; nothing "
        f"moves = 1. The full-order model took {result.sweep.full_order_s:.3g} s for the same "
        f"{result.sweep.horizon_s:g} s.</p>",
        f"<h2>The card of the plant</h2><pre>{html.escape(str(card))}</pre>",
        "</body></html>",
    ]
    write_text(path, "\n".join(parts))


def _loop_part(result: StudyResult, figures: dict[str, Path], verdict: str) -> list[str]:
    loop, m = result.told.loop, result.margins
    error, sensor = loop.heading_error_deg, loop.sensor_error_deg or loop.sensor_error_of_g
    if m is None or error is None or sensor is None:
        return [f"<p>No loop: {html.escape(str(loop.why_not))}.</p>"]
    at = [
        short(w)
        for w in (m.gain_margin_frequency, m.phase_margin_frequency, m.delay_margin_frequency)
    ]
    unit = "deg" if loop.sensor_error_deg is not None else "of the contrast g"
    stable = "stable" if m.closed_loop_stable else "not stable: read the margins as distances"
    return [
        image(figures["bode"], "Bode plot of the return ratio"),
        table(
            ("margin", "value", "at (rad/s)"),
            [
                ("gain margin: factor on kappa", short(m.gain_margin), at[0]),
                ("phase margin (deg)", short(m.phase_margin), at[1]),
                ("delay margin of the loop (s)", short(m.delay_margin), at[2]),
            ],
        ),
        f"<p class='note'>Closed loop {stable}. {html.escape(str(loop.linearisation))}. "
        f"{verdict}</p>",
        image(figures["polarity"], "polarity against time"),
        f"<p class='note'>Heading error of the reduced loop: {error.rms:.3g} deg rms, "
        f"{error.end:.3g} deg at the end. Sensor: {short(sensor.held_out)} {unit} held out, "
        f"{short(sensor.constant_direction)} {unit} for the best constant.</p>",
    ]


def _equivariant_part(result: StudyResult, figures: dict[str, Path]) -> list[str]:
    study = result.equivariant
    told = study.told
    if study.model is None or not isinstance(told, EquivariantSummary):
        return [f"<p>No equivariant model: {html.escape(str(study.why_not))}.</p>"]
    heading = ""
    if isinstance(told.loop, ClockedLoop):
        heading = (
            f"Its polarity loop stays {told.loop.heading_error_deg.rms:.3g} deg rms from the "
            "full-order loop's heading. "
        )
        m = told.loop.margins
        if m is not None:
            heading += (
                f"Margins of that loop at its end: gain {_told(m, 'gain_margin_on_kappa')} on "
                f"kappa, phase {_told(m, 'phase_margin_deg')} deg, delay "
                f"{_told(m, 'delay_margin_s')} s."
            )
        elif told.loop.why_no_margins:
            heading += f"No margins: {html.escape(told.loop.why_no_margins)}."
    card = card_of(study.model)
    return [
        f"<p>{html.escape(card.verdict)}</p>",
        image(figures["charges"], "poles by charge"),
        "<p class='note'>Poles frozen at the end of the training runs. Charge 0 is spreading and "
        "contraction, 1 translation and polarity, 2 elongation. Every pole of a charge above 0 "
        f"occurs twice in the real plant. {heading}</p>",
        f"<pre>{html.escape(str(card))}</pre>",
    ]


def _told(margins: Mapping[str, object], name: str) -> str:
    value = margins[name]
    return short(value if isinstance(value, (int, float)) else None)
