"""`study`: runs, snapshots, models, loop, figures and report of one scene."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellsys.arguments import checked
from cellsys.contracts import LinearModel, ReducedModel
from cellsys.effects.steering import Polarity
from cellsys.errors import CellsysError, ParameterError, RankError
from cellsys.integrate import CVODES
from cellsys.loop import ClosedLoop, Linearisation, PolarityLaw, closed_loop
from cellsys.mechanics.spreading import SpreadingSystem
from cellsys.model import LatentModel
from cellsys.model.card import card_of
from cellsys.observe import heading_error_deg, pulling, summary_of_run
from cellsys.reduction import PCR, LeastSquares
from cellsys.reduction.basis import check_order
from cellsys.response import Margins, margins
from cellsys.samples import Snapshots, snapshots
from cellsys.scene import Scene, build, load_scene, run_ensemble, training_scenes
from cellsys.scene.build import spreading
from cellsys.scene.ensemble import run_name
from cellsys.spectra import stability
from cellsys.store import discard_partial, fingerprint, write_json
from cellsys.store.cache import MODELS, cache_folder, prune, touch
from cellsys.study.coordinates import learn_coordinates
from cellsys.study.equivariant import study_equivariant, sweep_row
from cellsys.study.files import plain, save_run
from cellsys.study.floors import measured_floors
from cellsys.study.measure import margin_table, sweep_orders
from cellsys.study.plan import StudyPlan, crawls, in_gel, learns_from, study_plan, study_scenes
from cellsys.study.result import StudyResult
from cellsys.study.summary import (
    HeadingError,
    LoopSummary,
    PoleRow,
    SensorError,
    StudySummary,
    Verdict,
    table_of,
)
from cellsys.threads import one_thread
from cellsys.trajectory import Trajectory
from cellsys.worth.assessment import encode_start

if TYPE_CHECKING:
    from cellsys.study.cells import CellsStudy
    from cellsys.study.crawler import CrawlerStudy
    from cellsys.study.gel import GelStudy

ORDERS = (5, 10, 20, 50, 100)
Progress = Callable[[str, float], None]


@checked
@one_thread()
def study(
    scene: Scene | str | Path,
    out: str | Path,
    *,
    order: int = 10,
    workers: int = 2,
    resume: bool = True,
    model: LinearModel | str | Path | None = None,
    learn: bool | None = None,
    cache: str | Path | None = None,
    announce: Callable[[StudyPlan], None] | None = None,
    progress: Progress | None = None,
) -> StudyResult | CrawlerStudy | CellsStudy | GelStudy:
    """From a scene to poles, margins, a closed-loop run and a report.

    Writes into `out`: ``run.npz``, ``model.npz`` (PCR), ``model_equivariant.npz`` (when there is
    one), ``summary.json``, ``figures/*.png`` and ``report.html``. Runs are kept in the cache, whose
    longest unused entries go when it grows beyond 4 GB (`cellsys.store.cache`).

    Parameters
    ----------
    scene : Scene or path
        With exactly one steered cell on a disc. A scene on a chain (`study_crawler`), one in a
        gel (`study_gel`) and one
        with several cells, without a cell, a matrix or a lamellipodium (`study_cells`) are run
        and read out; no model is learned from them.
    out : path
        Output folder; made when missing.
    order : int
        Order of the plant of the loop.
    workers : int
        Processes for the full-order runs; the numbers do not depend on it.
    resume : bool
        Continue interrupted runs (the result is bitwise the same: on another kind of processor
        or BLAS they are started again); False starts them again.
    model : EquivariantModel or path, optional
        Of one cell, run beside a scene of several.
    learn : bool, optional
        Learn models from `training_scenes`; default: where the scene file has a [training] table
        (`Scene.learn`). Without, a steered cell is run and read out like any other scene.
    cache : path, optional
        Folder of the runs, which are not made again; default the user's (`cache_folder`).
    announce : callable, optional
        Called once with what will be run, before it is; not for a scene on a chain.
    progress : callable, optional
        Called with a stage's name and its share done.
    """
    from cellsys.study.cells import study_cells
    from cellsys.study.crawler import study_crawler
    from cellsys.study.gel import study_gel

    began = time.perf_counter()
    if not isinstance(scene, Scene):
        scene = load_scene(scene)
    if isinstance(model, (str, Path)):
        model = LatentModel.load(model)
    learns = learns_from(scene, learn)
    crawling = crawls(scene)
    if model is not None and (learns or crawling):
        raise ParameterError(
            "a model is run beside a disc scene of several cells; this one learns its own or has "
            "no disc: leave model out"
        )
    if crawling:
        return study_crawler(scene, out, progress)
    embedded = in_gel(scene)
    if embedded and model is not None:
        raise ParameterError(
            "a model of a cell on a disc is not run in a gel, where loads do not superpose; leave "
            "model out"
        )
    folder = Path(out)
    _check(scene, order if learns else None, folder)
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ParameterError(f"workers must be a whole number >= 1, got {workers!r}")
    kept = cache_folder() if cache is None else Path(cache)
    scenes, train, held = study_scenes(scene, learns)
    own = [kept / run_name(s) for s in scenes]
    for place in own if not resume else ():
        if (partial := place.with_name(f"{place.name}.partial")).exists():
            discard_partial(partial)
    if announce is not None:
        announce(study_plan(scene, learn=learns, workers=workers))
    if embedded:
        told_of = study_gel(scene, folder, workers=workers, cache=kept, progress=progress)
        touch(own)
        prune(kept, keep=own)
        return told_of
    if not learns:
        found = study_cells(
            scene, folder, workers=workers, cache=kept, model=model, progress=progress
        )
        touch(own)
        prune(kept, keep=own)
        return found
    say = progress or (lambda stage, share: None)

    plan = fingerprint(scene.fingerprint(), scene.canonical()["training"])
    shelf = kept / MODELS / plan[:20]
    runs = run_ensemble(
        scenes,
        kept,
        workers=workers,
        progress=lambda done, total: say("full-order runs", done / total),
    )
    main, runs = runs[0], runs[1:]
    data = snapshots(runs[: len(train)])
    tested, near = runs[len(train) : len(train) + len(held)], runs[len(train) + len(held) :]
    test = snapshots(tested)
    orders = [m for m in ORDERS if m < data.n_samples]
    if order not in orders:
        orders = sorted({*orders, order})
    say("basis", 0.0)
    learned = learn_coordinates(data, test, max(orders), shelf / "coordinates.npz")
    say("basis", 1.0)
    full_s = float(np.mean([r.statistics["wall_time"] for r in tested]))
    sweep, models = sweep_orders(
        data,
        test,
        learned,
        (PCR(), LeastSquares()),
        orders,
        full_s,
        lambda share: say("reduced models", share),
    )
    plant, why_lower = _plant(models, order)
    poles = plant.pole_set()
    say("loop", 0.0)
    loop, reduced, linear, loop_margins, why = _loop(scene, plant, main)
    say("loop", 1.0)

    say("equivariant", 0.0)
    charges = study_equivariant(scene, data, test, main, shelf / "equivariant.npz")
    if charges.model is not None:
        steps = round(sweep.horizon_s / charges.model.dt)
        row = sweep_row(charges.model, steps)
        sweep = dataclasses.replace(sweep, rows=(*sweep.rows, row))
    floors = measured_floors(tested[0], near, charges.model)
    charges = charges.with_floors(floors)
    plant = dataclasses.replace(plant, card=dataclasses.replace(card_of(plant), floors=floors))
    say("equivariant", 1.0)

    system = spreading(build(scene))
    rest = None if system.matrix is None else system.matrix.position
    errors = {
        "position_error_um": main.error_of("cell1.position"),
        "matrix_error_um": main.error_of("matrix.displacement"),
    }
    magnitudes = summary_of_run(main, rest) | pulling(main, "cell1") | errors
    whole = plant.realization()
    plant_report = stability(whole, certainty=plant.certainty(discrete=whole.dt > 0))
    trust = f"PCR: {card_of(plant).verdict}"
    if charges.model is not None:
        trust = f"the equivariant model: {card_of(charges.model).verdict} {trust}"
    trust = f"What these models can be trusted for: {trust}"
    told = StudySummary(
        scene=scene.name,
        fingerprint=scene.fingerprint(),
        magnitudes=magnitudes,
        step_residual_share=main.residual_share(),
        card=card_of(plant).table(),
        poles=tuple(
            PoleRow(float(p.real), float(p.imag), float(b))
            for p, b in zip(np.asarray(poles), poles.error_bound, strict=True)
        ),
        stability=Verdict(plant_report.verdict, plant_report.reason),
        margins=None if loop_margins is None else margin_table(loop_margins),
        loop=_loop_summary(plant, main, reduced, linear, why),
        orders=sweep.rows,
        full_order_s=full_s,
        why_lower_order=why_lower,
        equivariant=charges.told,
        trust=trust,
    )
    touch([*own, shelf])
    prune(kept, keep=[*own, shelf])
    result = StudyResult(
        scene=scene,
        run=main,
        models=models,
        model=plant,
        sweep=sweep,
        poles=poles,
        loop=loop,
        reduced=reduced,
        linear=linear,
        margins=loop_margins,
        magnitudes=magnitudes,
        told=told,
        out=folder,
        equivariant=charges,
    )
    _write(result, system, data, say)
    say("report", 1.0)
    told = dataclasses.replace(told, wall_time_s=time.perf_counter() - began)
    write_json(folder / "summary.json", plain(table_of(told)))
    return dataclasses.replace(result, told=told)


def _check(scene: Scene, order: int | None, folder: Path) -> None:
    """Refuse what cannot work before anything is run or written; no models without an order."""
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            raise ParameterError(f"out = {str(folder)!r}: {str(place)!r} is a file; give a folder")
    if order is None:
        return
    check_order(order)
    samples = sum(max(len(s.times) - 2, 0) for s in training_scenes(scene)[0])
    if order >= samples:
        raise RankError(
            f"order {order} is beyond the data: the training runs of this scene give {samples} "
            f"samples, which span at most {max(samples - 1, 0)} directions; lower the order or "
            "lengthen training"
        )


def _plant(
    models: Mapping[tuple[str, int], ReducedModel], order: int
) -> tuple[LatentModel, str | None]:
    """PCR at `order`, or at the next lower order that has a continuous form, and why."""
    reason = None
    pcr = {
        m: model
        for (name, m), model in models.items()
        if name == "PCR" and isinstance(model, LatentModel)
    }
    for m in sorted((m for m in pcr if m <= order), reverse=True):
        try:
            pcr[m].continuous_matrices()
        except ParameterError as error:
            reason = reason or f"order {m} has {error}"
            continue
        return pcr[m], reason and f"{reason}; shown is order {m}"
    return pcr[order], reason


def _loop(
    scene: Scene, model: LatentModel, main: Trajectory
) -> tuple[ClosedLoop | None, Trajectory | None, Linearisation | None, Margins | None, str | None]:
    """The loop's parts, or Nones and the reason why there is no loop."""
    polarity = scene.find(Polarity)
    if polarity is None:
        return None, None, None, None, "the scene has no polarity effect"
    try:
        loop = closed_loop(
            model,
            controller=PolarityLaw(kappa=polarity.kappa),
            z0=encode_start(model, snapshots([main]).runs[0]),
            p0=np.asarray(main.polarities[0, 0]),
        )
        reduced = loop.simulate(np.asarray(main.t), CVODES(rtol=1e-8, atol=1e-8))
        # Slower than the training runs are long: not to be told from integrators.
        linear = loop.linearize(reduced, slower_than=1.0 / scene.training.duration)
        return loop, reduced, linear, margins(loop.open_loop(linear)), None
    except CellsysError as error:
        return None, None, None, None, str(error)


def _loop_summary(
    model: LatentModel,
    main: Trajectory,
    reduced: Trajectory | None,
    linear: Linearisation | None,
    why: str | None,
) -> LoopSummary:
    sensor, sensed, heading, text = model.sensor, None, None, None
    if sensor is not None:
        sensed = SensorError(sensor.training_error, sensor.held_out_error, sensor.constant_error)
    if reduced is not None and linear is not None:
        gap = heading_error_deg(reduced.polarities[:, 0], np.asarray(main.polarities)[:, 0])
        heading = HeadingError(float(np.sqrt(np.mean(gap**2))), float(gap[-1]))
        text = str(linear)
    graded = sensor is not None and sensor.noise > 0.0
    return LoopSummary(
        why_not=why,
        sensor_error_deg=None if graded else sensed,
        sensor_error_of_g=sensed if graded else None,
        heading_error_deg=heading,
        linearisation=text,
    )


def _write(result: StudyResult, system: SpreadingSystem, data: Snapshots, say: Progress) -> None:
    from cellsys.study.report import write_figures, write_report

    run, out = result.run, result.out
    result.model.save(out / "model.npz")
    if result.equivariant.model is not None:
        result.equivariant.model.save(out / "model_equivariant.npz")
    save_run(run, out / "run.npz")
    say("report", 0.2)
    figures = write_figures(result, system, out / "figures")
    say("report", 0.8)
    write_report(result, figures, out / "report.html")
