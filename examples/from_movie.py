"""From a two-channel movie to the gap, the axes and the directionality of two cells.

The movie is rendered here from known contours, with blur and noise, so that what is measured can be
held against the truth. Needs the extra "images" (scikit-image, tifffile).
"""

import argparse

import numpy as np

import cellsys as cs


def cells(frames: int) -> cs.CellOutlines:
    """Two ellipses that turn and walk towards each other, um and s."""
    s = 2 * np.pi * np.arange(120) / 120
    names, frame, shapes = [], [], []
    for k in range(frames):
        for name, side in (("left", -1.0), ("right", 1.0)):
            angle = np.radians(20.0 * side + 2.0 * k)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            body = (turn @ [9.0 * np.cos(s), 5.0 * np.sin(s)]).T
            names.append(name)
            frame.append(k)
            shapes.append(body + [side * (14.0 - 0.3 * k), 0.0])
    at = np.array(frame)
    return cs.CellOutlines(cell=tuple(names), frame=at, t=60.0 * at, outline=tuple(shapes))


def main(quick: bool = False) -> cs.ReadOutTable:
    movie = cs.render_movie(cells(4 if quick else 12), pixel_size=0.25, signal_to_noise=5.0)
    print(movie)
    try:
        found = cs.segment_cells(movie.images, pixel_size=0.25, frame_interval=60.0)
    except cs.ParameterError as error:  # without the extra
        print(error)
        return cs.observe(movie.truth)
    table, truth = cs.observe(found), cs.observe(movie.truth)
    print(table)
    gap, true = table.pair("1.1", "2.1", "contour_distance"), truth.pair("left", "right", "contour")
    for k, (measured, drawn) in enumerate(zip(gap, 0.25 * true, strict=True)):
        axis = table.of("1.1", "elongation_axis_deg")[k]
        print(f"frame {k}: gap {measured:.2f} um (drawn {drawn:.2f}), left axis {axis:.1f} deg")
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
