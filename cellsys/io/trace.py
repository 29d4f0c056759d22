"""From label images to contours: the outer edge of every label, and who is who by overlap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import linear_sum_assignment


class Traced(NamedTuple):
    """One label of one frame: contour (n, 2) of (x, y), px; whether the edge of the image cuts it;
    pixels of parts that were left out; holes."""

    corners: np.ndarray
    at_edge: bool
    left_out: int
    holes: int


def trace(image: np.ndarray, label: int, box: tuple[slice, slice]) -> Traced:
    """Contour of the largest connected part of a label inside a box of the image.

    Its corners are the middles of the sides of pixels on the outer edge: as many convex corners
    are cut as concave ones filled, but for four, so that the area is that of the pixels less half
    a pixel. The centre of pixel (row i, column j) lies at x = j, y = i.
    """
    mask = image[box] == label
    parts, count = ndimage.label(mask)
    left_out = 0
    if count > 1:
        sizes = np.bincount(parts.ravel())[1:]
        left_out = int(sizes.sum() - sizes.max())
        mask = parts == 1 + int(sizes.argmax())
    filled = ndimage.binary_fill_holes(mask)
    holes = int(ndimage.label(filled & ~mask)[1])
    corners = _edge(filled) + np.array([box[1].start, box[0].start])
    rows, columns = np.nonzero(filled)
    rows, columns = rows + box[0].start, columns + box[1].start
    last = (image.shape[0] - 1, image.shape[1] - 1)
    at_edge = bool(
        rows.min() == 0 or columns.min() == 0 or rows.max() == last[0] or columns.max() == last[1]
    )
    return Traced(corners, at_edge, left_out, holes)


def _edge(mask: np.ndarray) -> np.ndarray:
    """Middles (x, y) of the sides of one 4-connected part without holes, in order."""
    m = np.pad(mask, 1).astype(np.int8)
    # Sides between corners of pixels, the part on their right; pixel (i, j) has corner (i, j)
    # above and to the left.
    following: dict[tuple[int, int], list[tuple[int, int]]] = {}
    down = np.diff(m, axis=1)
    for i, j in np.argwhere(down).tolist():
        upper, lower = (i, j + 1), (i + 1, j + 1)
        ends = (lower, upper) if down[i, j] > 0 else (upper, lower)
        following.setdefault(ends[0], []).append(ends[1])
    across = np.diff(m, axis=0)
    for i, j in np.argwhere(across).tolist():
        left, right = (i + 1, j), (i + 1, j + 1)
        ends = (left, right) if across[i, j] > 0 else (right, left)
        following.setdefault(ends[0], []).append(ends[1])
    start = min(following)
    here, came = start, (0, 0)
    middles = []
    while True:
        choices = following[here]
        there = choices[0]
        if len(choices) > 1:
            # Two pixels that meet at a corner alone: turn right, and stay on the same one.
            turn = (came[1], -came[0])
            there = next(c for c in choices if (c[0] - here[0], c[1] - here[1]) == turn)
        choices.remove(there)
        came = (there[0] - here[0], there[1] - here[1])
        # Of the mask without its rim, whose first pixel has its centre at 0.
        middles.append((0.5 * (here[1] + there[1]) - 1.5, 0.5 * (here[0] + there[0]) - 1.5))
        here = there
        if here == start:
            return np.array(middles)


class Followed:
    """Numbers of the cells of a movie, by the overlap of every frame with the one before.

    Of two following frames the labels are matched so that the sum of their overlaps over the
    union is greatest; a label without overlap is a new cell.
    """

    def __init__(self) -> None:
        self._count = 0
        self._before: np.ndarray | None = None
        self._told: dict[int, int] = {}

    def frame(self, image: np.ndarray) -> dict[int, int]:
        """Number of the cell of every label of the next frame."""
        sizes = np.bincount(image.ravel())
        labels = (1 + np.flatnonzero(sizes[1:])).tolist()
        now: dict[int, int] = {}
        if self._before is not None and self._told and labels:
            share = self._shares(image, sizes, labels)
            olds = list(self._told)
            for i, j in zip(*linear_sum_assignment(-share), strict=True):
                if share[i, j] > 0:
                    now[labels[j]] = self._told[olds[i]]
        for label in labels:
            if label not in now:
                self._count += 1
                now[label] = self._count
        self._before, self._told = image, now
        return now

    def _shares(self, image: np.ndarray, sizes: np.ndarray, labels: list[int]) -> np.ndarray:
        """Overlap over union of every label before (rows) and now (columns)."""
        before = self._before if self._before is not None else image
        olds = {label: k for k, label in enumerate(self._told)}
        news = {label: k for k, label in enumerate(labels)}
        share = np.zeros((len(olds), len(news)))
        both = (before > 0) & (image > 0)
        old_sizes = np.bincount(before.ravel())
        pairs, counts = np.unique(
            np.column_stack([before[both], image[both]]), axis=0, return_counts=True
        )
        for (old, new), overlap in zip(pairs.tolist(), counts.tolist(), strict=True):
            union = old_sizes[old] + sizes[new] - overlap
            share[olds[old], news[new]] = overlap / union
        return share
