"""The 1-D crawling cell of thesis chapter 3: one cell, a soft chain, two cells that meet.

python examples/crawler.py [--quick] [--out DIR]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cellsys.geometry.chain import Chain
from cellsys.integrate import DOP853
from cellsys.mechanics.crawler import Crawler, build_crawlers
from cellsys.mechanics.crawler_run import crawl


def main(quick: bool = False, out: str | None = None) -> None:
    t = np.linspace(0.0, 8.0 if quick else 20.0, 201)
    method = DOP853(rtol=1e-8, atol=1e-10)
    right, left = Crawler(), Crawler(heading=-1, trail_node=37, lead_node=33)
    stories = {
        "one cell": build_crawlers([right]),
        "on a soft chain": build_crawlers([right], Chain(stiffness=3.0)),
        "two cells": build_crawlers([right, left]),
    }
    for name, system in stories.items():
        run = crawl(system, method, t)
        print(f"{name}: {run}")
        if out is not None:
            folder = Path(out)
            folder.mkdir(parents=True, exist_ok=True)
            run.plot().figure.savefig(folder / f"{name.replace(' ', '_')}.png", dpi=120)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.out)
