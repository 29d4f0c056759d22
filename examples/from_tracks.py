"""From tracks of a microscope to a fitted polarity law: read, measure, fit, close the loop.

The tracks are made here as TrackMate would export them: pairs of cells that turn to each other.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import cellsys as cs

KAPPA, NOISE, MINUTES = 1 / 300, 0.02, 2  # 1/s, rad/s^0.5, between frames


def movie(path: Path, seed: int, frames: int) -> Path:
    """A table of spots, px and frames, of two cells that head for each other with noise."""
    rng = np.random.default_rng(seed)
    place, theta = np.array([[-60.0, 0.0], [60.0, 0.0]]), rng.uniform(-np.pi, np.pi, 2)
    rows = ["track,frame,x,y"]
    for k in range(frames):
        rows += [f"{i},{k},{x / 0.5:.3f},{y / 0.5:.3f}" for i, (x, y) in enumerate(place)]
        for _ in range(12):
            way = (place[::-1] - place) @ [1, 1j]
            turn = KAPPA * np.sin(np.angle(way) - theta) * 5 * MINUTES
            theta = theta + turn + NOISE * np.sqrt(5 * MINUTES) * rng.standard_normal(2)
            place = place + 0.05 * np.column_stack([np.cos(theta), np.sin(theta)])
    path.write_text("\n".join(rows) + "\n")
    return path


def main(quick: bool = False) -> cs.PolarityFit:
    with tempfile.TemporaryDirectory() as folder:
        tracks = [
            cs.read_tracks(movie(Path(folder) / f"{k}.csv", k, 40), pixel_size=0.5,
                           frame_interval=60.0 * MINUTES)
            for k in range(8 if quick else 30)
        ]  # fmt: skip
    print(tracks[0])
    print(cs.observe(tracks[0]))
    fit = cs.fit_polarity(tracks)
    print(fit)
    print(f"made with kappa {KAPPA:.3g} 1/s and noise {NOISE:.3g} rad/s^0.5")
    print(cs.pair_attraction(tracks))
    print(fit.controller())
    return fit


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
