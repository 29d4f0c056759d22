"""Naive versions of what touches files and processes; see `tests.naive`."""

import zipfile

import numpy as np


def bytes_promised_without_a_word(nodes):
    """A request for three coordinates of so many nodes: numpy gives it, unbacked by memory."""
    return np.empty((nodes, 3)).nbytes


def array_by_offset(data, name):
    """An array of an archive read from where its bytes should be, checking nothing."""
    place = data.find(f"{name}.npy".encode())
    start = data.find(b"\n", place) + 1
    return np.frombuffer(data[start : start + 200][: len(data[start : start + 200]) // 8 * 8])


def unpacked_size(path):
    """Bytes that reading every entry of an archive takes, found by reading them."""
    with zipfile.ZipFile(path) as archive:
        return sum(len(archive.read(name)) for name in archive.namelist())


def load_everything(path):
    """An npz read with pickles allowed."""
    with np.load(path, allow_pickle=True) as archive:
        return {name: archive[name] for name in archive.files}


def locked_by_a_file(path):
    """A lock that is the presence of a file: it outlives its owner."""
    return path.exists()


def write_in_place(path, data, stop):
    """A file overwritten where it stands, its writer stopped after `stop` bytes."""
    with open(path, "wb") as file:
        file.write(data[:stop])


def mapped_rows(folder, shapes):
    """Arrays of a run as sparse mapped files, filled without asking for room: SIGBUS."""
    for name, shape in shapes.items():
        array = np.lib.format.open_memmap(f"{folder}/{name}.npy", "w+", float, shape)
        array[:] = 1.0


def float_of_locale(text):
    """A number read with the decimal mark that a comma may be."""
    return float(text.replace(",", "."))


def raw_rows(path, columns):
    """Rows of an array file by its length alone: what was cut off is not missed."""
    numbers = np.frombuffer(path.read_bytes()[128:][: (path.stat().st_size - 128) // 8 * 8])
    return numbers[: len(numbers) // columns * columns].reshape(-1, columns)


def first_column_is_time(path):
    """(dt, samples) of a table whose first line is a header and whose first column is time in s."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    return rows[1, 0] - rows[0, 0], rows[:, 1:]
