"""LatentModel: constructor, coordinates, prediction, conversion, plant, files."""

import dataclasses
import io
import pickle

import control
import numpy as np
import pytest
import scipy.linalg as sla

from cellsys.errors import (
    CellsysError,
    DataError,
    DimensionError,
    FileFormatError,
    IntegrationError,
    ParameterError,
    RepresentationError,
)
from cellsys.model import LatentModel, StiffnessSensor
from cellsys.model.hold import hold, to_continuous
from cellsys.reduction import PCR, reduce
from cellsys.store import save_archive
from tests.reduction.systems import one_step_data, stable_matrix


@pytest.fixture(scope="module")
def model():
    data = one_step_data(seed=1, commands=True)
    learned = reduce(data, order=6, method=PCR())
    rng = np.random.default_rng(0)
    sensor = StiffnessSensor(
        K_d=rng.standard_normal((3, 7)),
        ridge=0.1,
        training_error=3.0,
        held_out_error=float("nan"),
        constant_error=9.0,
    )
    return dataclasses.replace(learned, sensor=sensor)


# Coordinates


def test_encode_and_reconstruct(model):
    rng = np.random.default_rng(1)
    z = rng.standard_normal((5, 6))
    x, eta = model.reconstruct(z), model.reconstruct_eta(z)
    # V is orthonormal: there and back to rounding
    assert np.abs(model.encode(x, eta) - z).max() < 1e-12 * 10
    assert np.abs(model.encode(x[0], eta[0]) - z[0]).max() < 1e-12 * 10
    # x alone determines z here (8 rows, 6 directions); lstsq with condition below 1e3
    assert np.abs(model.encode(x) - z).max() < 1e-9
    assert np.abs(model.encode(x[2]) - z[2]).max() < 1e-9
    for wrong in (x[:, :-1], np.zeros(0)):
        with pytest.raises(DimensionError, match="8 entries"):
            model.encode(wrong)
    with pytest.raises(DimensionError, match="6 entries"):
        model.encode(x, eta[:, 1:])


def test_no_basis_is_a_named_error():
    bare = LatentModel(A=-np.eye(2))
    for name in ("V_x", "V_eta"):
        with pytest.raises(RepresentationError, match=name):
            getattr(bare, name)
        assert not hasattr(bare, name)  # it is an AttributeError too
    with pytest.raises(RepresentationError, match="reconstruct"):
        bare.reconstruct(np.zeros(2))
    with pytest.raises(RepresentationError, match="encode"):
        bare.encode(np.zeros(2))


def test_rows_of_V(model):
    assert model.V_x.shape == (8, 6)
    assert model.V_eta.shape == (6, 6)
    assert np.array_equal(np.vstack([model.V_x, model.V_eta]), model.V)
    rows = np.sort(np.concatenate(list(model.blocks.values())))
    assert rows.tolist() == list(range(14))


@pytest.mark.parametrize(
    ("fields", "error", "words"),
    [
        ({"A": np.zeros((2, 3))}, DimensionError, "A must be square"),
        ({"A": np.zeros((0, 0))}, DimensionError, "A"),
        ({"A": [[np.nan]]}, DataError, "A holds NaN"),
        ({"A": np.eye(2) * 1j}, DataError, "complex"),
        ({"B": np.zeros((3, 1))}, DimensionError, "B must have shape"),
        ({"B": np.zeros(3)}, DimensionError, "B"),
        ({"offset": np.zeros(3)}, DimensionError, "offset"),
        ({"offset": [0.0, np.inf]}, DataError, "offset holds NaN"),
        ({"V": np.zeros((5, 3))}, DimensionError, "V must have shape"),
        ({"V": np.eye(5, 2), "mean": np.zeros(4)}, DimensionError, "mean"),
        ({"V": np.eye(5, 2), "scale": np.ones(4)}, DimensionError, "scale"),
        ({"V": np.eye(5, 2), "scale": -np.ones(5)}, DataError, "scale"),
        ({"V": np.eye(5, 2), "n_states": 6}, DimensionError, "n_states"),
        ({"z_start": np.zeros(3)}, DimensionError, "z_start"),
        ({"dt": 0.0}, ParameterError, "dt must be > 0"),
        ({"dt": float("nan")}, ParameterError, "dt must be a finite"),
        ({"B": np.zeros((2, 2)), "input_names": ("a",)}, DimensionError, "1 input names"),
        ({"V": np.eye(5, 2), "blocks": {"field": [5]}}, DimensionError, "field"),
        ({"blocks": {"field": [0]}}, DimensionError, "field"),
    ],
)
def test_constructor_refuses(fields, error, words):
    with pytest.raises(error, match=words):
        LatentModel(**{"A": -np.eye(2), **fields})


def test_arrays_are_copied_and_read_only():
    A = -np.eye(2)
    model = LatentModel(A=A)
    A[0, 0] = 5.0
    assert model.A[0, 0] == -1.0
    with pytest.raises(ValueError, match="read-only"):
        model.A[0, 0] = 1.0


# Dynamics


def test_predict_of_a_continuous_model_is_the_exponential():
    rng = np.random.default_rng(2)
    A, B, b = stable_matrix(4, rng), rng.standard_normal((4, 2)), rng.standard_normal(4)
    model = LatentModel(A=A, B=B, offset=b)
    t = np.array([0.0, 0.1, 0.35, 2.0, 2.1])
    c = rng.standard_normal((4, 2))
    z = rng.standard_normal(4)
    got = model.predict(z, c, t)
    for k, h in enumerate(np.diff(t)):
        rest = -np.linalg.solve(A, B @ c[k] + b)
        z = rest + sla.expm(h * A) @ (z - rest)
        # two ways to the same exponential
        assert np.abs(got[k + 1] - z).max() < 1e-12 * 10


def test_predict_of_a_step_model_on_and_off_its_grid(model):
    dt = model.dt
    z0 = np.ones(6)
    fine = model.predict(z0, None, dt * np.arange(9))
    coarse = model.predict(z0, None, dt * np.array([0, 2, 4, 8]))
    assert np.array_equal(coarse, fine[[0, 2, 4, 8]])
    assert np.array_equal(model.predict(z0, None, 7.3 + dt * np.arange(9)), fine)
    for t in (dt * np.array([0.0, 0.5]), dt * np.array([0.0, 1.0, 1.9]), np.array([0.0, 1e-9])):
        with pytest.raises(ParameterError, match=r"grid of 0\.1 s"):
            model.predict(z0, None, t)


def test_predict_refuses(model):
    t, z0 = model.dt * np.arange(4), np.zeros(6)
    for z, u, times, error, words in (
        (np.full(6, np.nan), None, t, DataError, "NaN"),
        (z0[:5], None, t, DimensionError, "z0"),
        (z0, None, [0.0, np.nan], DataError, "NaN"),
        (z0, None, [0.0, 0.0], DataError, "increase"),
        (z0, np.full((3, 2), np.inf), t, DataError, "u holds NaN"),
        (z0, np.zeros((4, 2)), t, DimensionError, "u must be"),
    ):
        with pytest.raises(error, match=words):
            model.predict(z, u, np.asarray(times))
    one = model.predict(z0, np.array([1.0, -1.0]), t)
    assert np.array_equal(one, model.predict(z0, np.tile([1.0, -1.0], (3, 1)), t))
    assert np.array_equal(model.predict(z0, None, [2.0]), z0[None])


@pytest.mark.parametrize("growth", [3.0, 1e3, 1e30, 1e300])
@pytest.mark.parametrize("kind", [None, 1.0])
def test_divergence_is_an_error_with_numbers(growth, kind):
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    model = LatentModel(A=growth * (np.eye(2) + turn), dt=kind)
    with pytest.raises(IntegrationError, match="diverges") as caught:
        model.predict(np.array([1.0, 2.0]), None, np.arange(0.0, 2000.0))
    error = caught.value
    assert 0 < error.time <= 1999.0
    assert error.step == 1.0
    assert error.state_norm > 1e150


def test_a_long_hold_of_a_growing_model_is_refused_too():
    """One interval of many steps: the growth inside it is seen as well."""
    model = LatentModel(A=[[1e3, -1e3], [1e3, 1e3]], dt=1.0)
    with pytest.raises(IntegrationError, match="diverges"):
        model.predict(np.ones(2), None, np.array([0.0, 5000.0]))


def test_poles_of_a_step_model_are_logarithms():
    rng = np.random.default_rng(4)
    A, dt = stable_matrix(5, rng), 0.2
    step = LatentModel(A=(sla.expm(dt * A) - np.eye(5)) / dt, dt=dt)
    exact = np.sort_complex(np.linalg.eigvals(A))
    # rounding of I + dt A over dt
    assert np.abs(np.sort_complex(step.poles()) - exact).max() < 1e-11
    assert np.abs(np.sort_complex(np.linalg.eigvals(step.A)) - exact).max() > 1e-2
    assert abs(step.growth() - exact.real.max()) < 1e-11


@pytest.mark.parametrize("seed", range(4))
def test_to_continuous_inverts_the_hold(seed):
    rng = np.random.default_rng(seed)
    m, dt = 6, 0.3
    A, B, b = stable_matrix(m, rng), rng.standard_normal((m, 3)), rng.standard_normal(m)
    if seed == 1:
        A[0] = 0.0  # an integrator
    if seed == 2:
        A = A + 1.5 * np.eye(m)  # unstable
    A_d, B_d, b_d = hold(A, B, b, dt)
    back = to_continuous((A_d - np.eye(m)) / dt, B_d / dt, b_d / dt, dt)
    for got, true in zip(back, (A, B, b), strict=True):
        # logm is accurate to about its condition times rounding, over dt
        assert np.abs(got - true).max() < 1e-10


def test_no_continuous_form_on_the_negative_real_axis():
    for eigenvalue in (-0.5, -1e-3, 0.0):
        step = np.diag([0.9, eigenvalue])
        model = LatentModel(A=(step - np.eye(2)) / 0.1, dt=0.1)
        with pytest.raises(ParameterError, match="no continuous model"):
            model.continuous_matrices()
        with pytest.raises(ParameterError, match="discrete=True"):
            model.plant()
        assert model.plant(discrete=True).dt == 0.1
    assert LatentModel(A=[[-10.0]], dt=0.1).poles()[0].real == -np.inf  # a dead beat: log 0
    pair = LatentModel(A=(np.array([[-0.5, 0.4], [-0.4, -0.5]]) - np.eye(2)) / 0.1, dt=0.1)
    assert pair.plant().dt == 0


# Control


def test_plant_is_a_named_state_space(model):
    plant = model.plant()
    assert isinstance(plant, control.StateSpace)
    assert plant.dt == 0
    assert plant.state_labels == [f"z[{i}]" for i in range(6)]
    assert plant.input_labels == ["a", "b", "one"]
    assert plant.output_labels == plant.state_labels
    near = np.abs(plant.poles()[:, None] - model.poles()[None]).min(axis=1)
    assert near.max() < 1e-9 * np.abs(model.poles()).max()
    stepper = model.plant(discrete=True)
    assert stepper.dt == model.dt
    assert np.array_equal(stepper.A, np.eye(6) + model.dt * model.A)
    read = model.plant(output=model.V_x[:2], output_names=["left", "right"])
    assert read.output_labels == ["left", "right"]
    assert model.plant(output=model.V_x[:2]).output_labels == ["y[0]", "y[1]"]
    with pytest.raises(DimensionError, match="6 columns"):
        model.plant(output=np.eye(5))
    with pytest.raises(ParameterError, match="no step"):
        LatentModel(A=-np.eye(2)).plant(discrete=True)


def test_plant_of_a_model_without_inputs():
    plant = LatentModel(A=-np.eye(2)).plant()
    assert plant.input_labels == ["one"]
    assert plant.nstates == 2
    bare = LatentModel(A=-np.eye(2)).plant(offset="drop")
    assert bare.ninputs == 0


# Files


def same(a, b):
    for name in ("A", "B", "offset", "V", "mean", "scale", "singular_values", "z_start"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        assert x is None or (x.dtype == y.dtype and np.array_equal(x, y)), name
    assert a.dt == b.dt
    assert a.n_states == b.n_states
    assert a.input_names == b.input_names
    assert a.states == b.states
    assert a.auxiliaries == b.auxiliaries
    assert a.card == b.card
    assert {k: v.tolist() for k, v in a.blocks.items()} == {
        k: v.tolist() for k, v in b.blocks.items()
    }


def test_save_and_load_give_the_same_model_bit_for_bit(model, tmp_path):
    path = model.save(tmp_path / "m.npz")
    back = LatentModel.load(path)
    same(model, back)
    assert np.array_equal(back.sensor.K_d, model.sensor.K_d)
    assert back.sensor.ridge == 0.1
    assert np.isnan(back.sensor.held_out_error)
    assert str(back.card) == str(model.card)
    assert dict(back.notes) == dict(model.notes)
    assert back.save(tmp_path / "again").name == "again.npz"
    bare = LatentModel(A=-np.eye(2), B=np.eye(2))
    same(bare, LatentModel.load(bare.save(tmp_path / "bare.npz")))


def test_a_truncated_model_file_is_a_format_error(model, tmp_path):
    whole = model.save(tmp_path / "m.npz").read_bytes()
    path = tmp_path / "cut.npz"
    for length in [*range(0, 64), *range(64, len(whole), 37), len(whole) - 1]:
        path.write_bytes(whole[:length])
        with pytest.raises(FileFormatError, match=r"cut\.npz"):
            LatentModel.load(path)


def test_a_damaged_model_file_is_a_format_error_or_the_model(model, tmp_path):
    whole = bytearray(model.save(tmp_path / "m.npz").read_bytes())
    path = tmp_path / "bad.npz"
    rng = np.random.default_rng(0)
    for position in rng.integers(0, len(whole), 300):
        broken = bytearray(whole)
        broken[position] ^= 0xFF
        path.write_bytes(broken)
        try:
            back = LatentModel.load(path)
        except FileFormatError:
            continue
        assert np.array_equal(back.A, model.A)  # a byte that no reader looks at


def test_foreign_and_pickled_files_are_refused(model, tmp_path):
    def written(name, content):
        path = tmp_path / name
        path.write_bytes(content)
        return path

    def archive(**arrays):
        out = io.BytesIO()
        np.savez(out, **arrays)
        return out.getvalue()

    files = [
        written("text.npz", b"A = 1\n"),
        written("empty.npz", b""),
        written("pickle.npz", pickle.dumps({"A": 1})),
        written("foreign.npz", archive(A=np.eye(2))),
        written("objects.npz", archive(cellsys=np.array([{"kind": "latent model"}]))),
        written("header.npz", archive(cellsys=np.array("{not json"), A=np.eye(2))),
        save_archive(tmp_path / "run.npz", "run", 1, {"x": np.eye(2)}, {}),
        save_archive(tmp_path / "newer.npz", "latent model", 2, {"A": np.eye(2)}, {}),
        save_archive(tmp_path / "bare.npz", "latent model", 1, {"A": np.eye(2)}, {}),
        save_archive(tmp_path / "list.npz", "latent model", 1, {"A": np.eye(2)}, {"dt": []}),
    ]
    good = {
        "dt": None, "n_states": None, "input_names": [], "states": None,
        "auxiliaries": None, "card": None, "notes": {},
    }  # fmt: skip
    for name, arrays, change in (
        ("no_A", {"B": np.eye(2)}, {}),
        ("shape", {"A": np.zeros((2, 3))}, {}),
        ("nan", {"A": np.full((2, 2), np.nan)}, {}),
        ("dt", {"A": np.eye(2)}, {"dt": "fast"}),
        ("names", {"A": np.eye(2)}, {"input_names": ["a"]}),
        ("card", {"A": np.eye(2)}, {"card": {"order": 2}}),
        ("layout", {"A": np.eye(2)}, {"states": [["a"]]}),
        ("sensor", {"A": np.eye(2), "sensor K_d": np.zeros((2, 2))}, {}),
        ("sensor2", {"A": np.eye(2), "sensor zzz": np.zeros((2, 2))}, {}),
        ("text", {"A": np.array("abc")}, {}),
    ):
        files.append(
            save_archive(tmp_path / f"{name}.npz", "latent model", 1, arrays, good | change)
        )
    for path in files:
        with pytest.raises(FileFormatError, match=path.stem):
            LatentModel.load(path)
    with pytest.raises(FileNotFoundError, match="absent"):
        LatentModel.load(tmp_path / "absent.npz")


def test_saving_over_a_folder_leaves_it_alone(model, tmp_path):
    (tmp_path / "taken.npz").mkdir()
    with pytest.raises((OSError, CellsysError)):
        model.save(tmp_path / "taken.npz")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["taken.npz"]


def test_words_of_a_model(model):
    text = str(model)
    assert "order 6" in text
    assert "verdict: " in text
    assert "step of 0.1 s" in text
