"""Scenes to train and test reduced models on: constant headings, turning commands, loaded matrix.

Runs with a constant heading hold one trajectory up to a rotation, so they cannot tell a good model
from a lucky one. Turning headings with a varying amplitude can; imposed loads on the matrix show
how a cell answers to a matrix that moves by itself.
"""

from __future__ import annotations

from cellsys.arguments import checked
from cellsys.kinds import Seed, Whole
from cellsys.scene.scene import Scene


@checked
def training_scenes(scene: Scene) -> tuple[list[Scene], list[Scene]]:
    """Open-loop scenes for training and for held-out tests, as `[training]` asks.

    Constant commands: `runs` headings evenly spread, `held_out` half-way between trained ones.
    Turning commands: `turning_scenes` with the scene's seed, of which the last `loaded` ones carry
    loads on the matrix; held-out runs take other seeds. The polarity law is replaced by the
    command, the sensor stays, so that the direction it reports is recorded.

    Raises
    ------
    SceneError
        A scene on a chain: crawlers take no commands.
    """
    return scene.matrix_kind.train(scene)


@checked
def turning_scenes(
    scene: Scene,
    n: Whole,
    *,
    seed: Seed,
    loaded: bool = False,
    scatter: float = 0.0,
    label: str = "training",
) -> list[Scene]:
    """`n` open-loop scenes whose heading turns and whose amplitude varies, drawn from `seed`.

    Every 250 to 500 s the heading moves by up to 80 deg to either side and the amplitude to
    another value between 0.4 and 1.6, within 60 s. With `loaded`, four patches of 5 um radius pull
    on the matrix, up to 4 to 12 nN each, to and fro over 200 to 600 s. Every cell of the scene
    gets its own commands, and a place up to `scatter` um away along each axis.

    Raises
    ------
    SceneError
        A scene on a chain: crawlers take no commands.
    """
    return scene.matrix_kind.turn(scene, n, seed=seed, loaded=loaded, scatter=scatter, label=label)
