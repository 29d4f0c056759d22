"""A field linearised: plant between load ports, latent model, what its passivity rests on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Generic, TypeVar

import numpy as np
import scipy.sparse as sp

from cellsys.errors import ParameterError
from cellsys.field.ports import (
    MOST_DENSE,
    FieldPassivity,
    least_eigenvalue,
    linear_matrices,
    port_patterns,
    step_index,
)
from cellsys.kinds import FILLED
from cellsys.model.latent import LatentModel
from cellsys.state_space import state_space
from cellsys.store.memory import size_text
from cellsys.system import Block, Layout

if TYPE_CHECKING:
    import control


_Form = TypeVar("_Form", np.ndarray, sp.csc_array)  # how modes and tangents are kept
Ports = Annotated[
    Mapping[str, np.ndarray] | np.ndarray,
    "load patterns (n, 3) by name, an array of them (p, n, 3), or numbers of nodes",
]


class LinearisedField(ABC, Generic[_Form]):
    """Plant, model and passivity of a field; `GradientField` adds energy and steps."""

    order: int
    modes: _Form

    @property
    @abstractmethod
    def nodes(self) -> np.ndarray:
        """Rest positions (n, 3), um."""

    @property
    @abstractmethod
    def drag(self) -> float:
        """Of every node, pN s/um."""

    @property
    @abstractmethod
    def stiffness(self) -> _Form:
        """Hess U at rest (order, order), pN/um."""

    @abstractmethod
    def energy(self, q: np.ndarray) -> float:
        """U(q), pN um."""

    @abstractmethod
    def force(self, q: np.ndarray) -> np.ndarray:
        """-dU/dq (order,), pN."""

    @abstractmethod
    def tangent(self, q: np.ndarray) -> _Form:
        """Hess U at q (order, order), pN/um."""

    @abstractmethod
    def project(self, f: np.ndarray) -> np.ndarray:
        """U^T f: nodal loads (..., n, 3), pN, to loads on the coordinates (..., order)."""

    def _dense_tangent(self, at: np.ndarray | None, what: str) -> np.ndarray:
        if self.order > MOST_DENSE:
            raise ParameterError(
                f"{what} of {self.order} coordinates would be a dense matrix of "
                f"{size_text(8.0 * self.order**2)} (bound: {MOST_DENSE} coordinates); "
                "use GalerkinField"
            )
        K = self.stiffness if at is None else self.tangent(at)
        return np.array(K) if isinstance(K, np.ndarray) else K.toarray()

    def plant(
        self, ports: Ports, *, output: str = "velocity", at: np.ndarray | None = None
    ) -> control.StateSpace:
        """The field between load ports as `control.StateSpace`, linearised at rest or at q = `at`.

            C_e q' = -K q + E^T f ,   y = E q' (collocated velocities) or E q

        Parameters
        ----------
        ports : mapping of str to (n, 3), array (p, n, 3), or int array of nodes
            Load patterns per unit of port force: f = 1 pN on port i puts pattern i on the nodes,
            and y_i is the velocity gathered by the same pattern. Nodes give ports along x, y, z.
        output : {"velocity", "displacement"}
            um/s or um.

        Returns
        -------
        control.StateSpace
            Continuous (dt = 0); passive from f to y = velocity where K >= 0.
        """
        patterns, names = port_patterns(ports, len(self.nodes))
        E = self.project(patterns)
        K = self._dense_tangent(at, "a plant")
        A, B, C, D = linear_matrices(K, E, self.drag, output)
        letter = "v" if output == "velocity" else "u"
        return state_space(
            A,
            B,
            C,
            D,
            0,
            states=[f"q[{i}]" for i in range(self.order)],
            inputs=[f"f_{name}" for name in names],
            outputs=[f"{letter}_{name}" for name in names],
            name=f"field_q{self.order}",
        )

    def model(self, ports: Ports | None = None, *, at: np.ndarray | None = None) -> LatentModel:
        """The linearised field as a continuous `LatentModel`: poles, responses, files.

            q' = A q + B f + b,   A = -K/C_e,  B = E^T/C_e,  b = (F + K at)/C_e

        Without ports the inputs are the loads on the coordinates, E = I. V = modes, so
        ``model.reconstruct(q)`` are nodal displacements; block ``field`` is all of them.
        """
        K = self._dense_tangent(at, "a model")
        if ports is None:
            E, names = np.eye(self.order), [f"load[{i}]" for i in range(self.order)]
        else:
            patterns, names = port_patterns(ports, len(self.nodes))
            E, names = self.project(patterns), [f"f_{name}" for name in names]
        offset = FILLED
        if at is not None:
            offset = (self.force(at) + K @ np.asarray(at, dtype=float)) / self.drag
        V = self.modes if isinstance(self.modes, np.ndarray) else self.modes.toarray()
        return LatentModel(
            A=-K / self.drag,
            B=E.T / self.drag,
            offset=offset,
            V=V,
            n_states=len(V),
            blocks={"component": np.arange(0), "field": np.arange(len(V))},
            states=Layout([Block("matrix.displacement", self.nodes.shape, "um", role="field")]),
            input_names=tuple(names),
        )

    def passivity(self, dt: float = 10.0, at: np.ndarray | None = None) -> FieldPassivity:
        """Whether one implicit step of dt at q = `at` (rest) gains no more energy than its work.

        Sufficient: Hess U >= -2 C_e/dt I there. Buckled fibres under compression make Hess U
        indefinite, so ask at the states that are met. `step` refuses a gain above the work in any
        case; this tells whether the scheme needs that.
        """
        if not (np.isfinite(dt) and dt > 0):
            raise ParameterError(f"dt must be finite and > 0 s, got {dt!r}")
        q = np.zeros(self.order) if at is None else np.asarray(at, dtype=float)
        K = self.tangent(q)
        low, high = least_eigenvalue(K)
        size = abs(K).max()
        rng = np.random.default_rng(np.random.SeedSequence(entropy=0, spawn_key=(203,)))
        d = rng.standard_normal(self.order)
        d /= np.linalg.norm(d)
        # Away from rest: there the force vanishes and the ratio would be 0/0.
        here, h = q + d, 1e-4
        F = self.force(here)
        rise = (self.energy(here + h * d) - self.energy(here - h * d)) / (2.0 * h)
        overlap = self.modes.T @ self.modes
        eye = sp.eye_array(self.order) if sp.issparse(overlap) else np.eye(self.order)
        return FieldPassivity(
            dt=float(dt),
            least_curvature=low,
            bound=-2.0 * self.drag / dt,
            index=step_index(np.array([low, high]), self.drag, dt),
            residual=abs(float(F @ d) + rise) / max(float(np.linalg.norm(F)), 1e-300),
            asymmetry=float(abs(K - K.T).max()) / size,
            collocation=float(abs(overlap - eye).max()),
        )
