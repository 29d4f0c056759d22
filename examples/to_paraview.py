"""A run as files that ParaView, xarray and a spreadsheet open.

ParaView's files and the table need nothing but cellsys, the data set the extra "data".
"""

import argparse
import tempfile
from pathlib import Path

from recorded_run import SCENE

import cellsys as cs


def main(quick: bool = False) -> None:
    scene = {**SCENE, "duration": "6 s" if quick else "20 s"}
    run = cs.run_scene(cs.Scene.parse(scene))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        series = cs.write_vtk(run, folder / "vtk", fields=["displacement", "cell1.focal_adhesion"])
        size = sum(p.stat().st_size for p in series.parent.iterdir())
        print(f"{series.name} and its files: {size / 1e6:.2g} MB")
        table = cs.observe(run)
        print(table.to_csv(folder / "cell.csv").read_text().splitlines()[0])
        print(table)
        try:
            print(run.to_xarray()["cell1_position"].dims)
        except cs.ParameterError as error:
            print(error)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
