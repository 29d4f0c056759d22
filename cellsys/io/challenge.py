"""Tracks of the Cell Tracking Challenge: a text of tracks and a label image per frame."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from cellsys.errors import FileFormatError
from cellsys.io.images import label_image
from cellsys.io.spots import check_counts, spot_tracks
from cellsys.store.regular import open_regular
from cellsys.tracks import Tracks, chained

_TEXTS = ("res_track.txt", "man_track.txt")
_MASK = re.compile(r"(?:mask|man_track)(\d{3,})\.tiff?")


def is_challenge(path: Path) -> bool:
    """Whether a path is such a text, or a folder that holds one."""
    return path.name in _TEXTS or (path.is_dir() and _text(path) is not None)


def _text(folder: Path) -> Path | None:
    return next((folder / name for name in _TEXTS if (folder / name).exists()), None)


def read_challenge(path: Path) -> Tracks:
    """Tracks of ``res_track.txt`` (rows: label, first frame, last frame, parent) and its masks.

    Places are the centroids of the labels, px; a label that is missing in a frame is a gap, a
    parent other than 0 a division.

    Raises
    ------
    FileFormatError
        With the line; a label without pixels in its first or last frame; masks without a track.
    """
    text = path if path.is_file() else _text(path)
    if text is None:
        raise FileFormatError(f"{path.name!r} has neither {' nor '.join(_TEXTS)}")
    rows = _rows(text)
    masks = {int(m[1]): p for p in text.parent.iterdir() if (m := _MASK.fullmatch(p.name))}
    if not masks:
        raise FileFormatError(
            f"{text.name} says who divides but not where: the masks (mask000.tif, ...) are not "
            f"in {text.parent.name!r}"
        )
    frames, labels, places = [], [], []
    for frame in sorted(masks):
        image = label_image(masks[frame])
        if image.ndim != 2:
            raise FileFormatError(f"{masks[frame].name}: a plane of labels is read, not a volume")
        found, index = np.unique(image, return_inverse=True)
        index = index.reshape(image.shape)
        size = np.bincount(index.ravel())
        y, x = np.indices(image.shape)
        middle = [np.bincount(index.ravel(), weights=v.ravel()) / size for v in (x, y)]
        for k, label in enumerate(found.tolist()):
            if label > 0:
                frames.append(frame)
                labels.append(int(label))
                places.append((middle[0][k], middle[1][k], 0.0))
    track, frame_of = np.array(labels, dtype=np.int64), np.array(frames, dtype=np.int64)
    known = {label: (first, last, parent) for label, first, last, parent in rows}
    for label in np.unique(track).tolist():
        if label not in known:
            raise FileFormatError(f"{text.name} has no track for label {label} of the masks")
    links, more = chained(track, frame_of), []
    at = {(int(i), int(f)): k for k, (i, f) in enumerate(zip(track, frame_of, strict=True))}
    for line, (label, first, last, parent) in enumerate(rows, 1):
        for frame in (first, last):
            if (label, frame) not in at:
                raise FileFormatError(
                    f"{text.name}, line {line}: label {label} has no pixel in frame {frame}"
                )
        if parent:
            if parent not in known or known[parent][1] >= first:
                raise FileFormatError(
                    f"{text.name}, line {line}: label {label} begins in frame {first}, its parent "
                    f"{parent} is missing or ends later"
                )
            more.append((at[parent, known[parent][1]], at[label, first]))
    joined = np.concatenate([links, np.array(more, dtype=np.int64).reshape(-1, 2)])
    return spot_tracks(
        text.name, "Cell Tracking Challenge", frame=frame_of, t=frame_of,
        place=np.array(places, dtype=float).reshape(-1, 3), track=track, links=joined,
        units=("px", "frame"),
    )  # fmt: skip


def _rows(text: Path) -> list[tuple[int, int, int, int]]:
    with open_regular(text, 1e8) as file:
        lines = file.read().decode("ascii", errors="replace").splitlines()
    rows = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            label, first, last, parent = (int(word) for word in line.split())
        except ValueError as error:
            raise FileFormatError(
                f"{text.name}, line {number}: four whole numbers belong there (label, first "
                f"frame, last frame, parent), got {line[:60]!r}"
            ) from error
        rows.append((label, first, last, parent))
    check_counts(text.name, 0, len(rows))
    return rows
