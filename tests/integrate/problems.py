"""Initial-value problems with published or closed end values, as symbolic systems.

HIRES, OREGO, ROBER, VDPOL, E5: Hairer and Wanner, Solving ODEs II (IV.10), values to 12 and more
digits from their test set. Enright and Pryce: one of each class, made with Radau at 1e-12 and
confirmed by another method in the tests.
"""

from dataclasses import dataclass

import numpy as np

from cellsys.system import OdeSystem


@dataclass(frozen=True)
class Problem:
    name: str
    law: object
    x0: tuple
    end: float
    values: tuple | None = None
    floor: float = 1e-12  # of |x|, for relative errors

    @property
    def system(self):
        n = len(self.x0)
        return OdeSystem(
            states=[f"y{i + 1}" for i in range(n)],
            auxiliaries=[f"r{i + 1}" for i in range(n)],
            x0=self.x0,
            W_eta=np.eye(n),
            law=self.law,
        )

    def rhs(self, t, y):
        return np.array(self.law(t, y))


def hires(t, y):
    return [
        -1.71 * y[0] + 0.43 * y[1] + 8.32 * y[2] + 0.0007,
        1.71 * y[0] - 8.75 * y[1],
        -10.03 * y[2] + 0.43 * y[3] + 0.035 * y[4],
        8.32 * y[1] + 1.71 * y[2] - 1.12 * y[3],
        -1.745 * y[4] + 0.43 * y[5] + 0.43 * y[6],
        -280.0 * y[5] * y[7] + 0.69 * y[3] + 1.71 * y[4] - 0.43 * y[5] + 0.69 * y[6],
        280.0 * y[5] * y[7] - 1.81 * y[6],
        -280.0 * y[5] * y[7] + 1.81 * y[6],
    ]


def orego(t, y):
    return [
        77.27 * (y[1] + y[0] * (1.0 - 8.375e-6 * y[0] - y[1])),
        (y[2] - (1.0 + y[0]) * y[1]) / 77.27,
        0.161 * (y[0] - y[2]),
    ]


def rober(t, y):
    a, b = 1e4 * y[1] * y[2], 3e7 * y[1] * y[1]
    return [-0.04 * y[0] + a, 0.04 * y[0] - a - b, b]


def vdpol(t, y):
    return [y[1], ((1.0 - y[0] * y[0]) * y[1] - y[0]) * 1e6]


def e5(t, y):
    A, B, M, C = 7.89e-10, 1.1e7, 1e6, 1.13e3
    one, two = A * y[0], M * C * y[1] * y[2]
    three, four = B * y[0] * y[2], C * y[3]
    return [-one - three, one - two, one - three + four - two, three - four]


HIRES = Problem(
    "HIRES", hires, (1, 0, 0, 0, 0, 0, 0, 0.0057), 321.8122,
    (0.7371312573325668e-3, 0.1442485726316185e-3, 0.5888729740967575e-4, 0.1175651343283149e-2,
     0.2386356198831331e-2, 0.6238968252742796e-2, 0.2849998395185769e-2, 0.2850001604814231e-2),
)  # fmt: skip
OREGO = Problem(
    "OREGO", orego, (1, 2, 3), 360.0,
    (0.1000814870318523e1, 0.1228178521549917e4, 0.1320554942846706e3),
)  # fmt: skip
ROBER = Problem("ROBER", rober, (1, 0, 0), 40.0, (0.7158270688, 0.9185534764e-5, 0.2841637458))
VDPOL = Problem("VDPOL", vdpol, (2, 0), 2.0, (0.1706167732170483e1, -0.8928097010247975e0))
E5 = Problem("E5", e5, (1.76e-3, 0, 0, 0), 1000.0)

# Enright, Hull and Lindberg (stiff, A to E) and Hull, Enright, Fellen and Sedgwick (B, C, D).
STIFF = [
    Problem("A1", lambda t, y: [-0.5 * y[0], -y[1], -100 * y[2], -90 * y[3]], (1, 1, 1, 1), 20.0),
    Problem(
        "B2",
        lambda t, y: [
            -10 * y[0] + 3 * y[1], -3 * y[0] - 10 * y[1], -4 * y[2], -y[3], -0.5 * y[4], -0.1 * y[5]
        ],
        (1, 1, 1, 1, 1, 1), 20.0,
    ),
    Problem(
        "C1",
        lambda t, y: [
            -y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3],
            -10 * y[1] + 10 * (y[2] * y[2] + y[3] * y[3]),
            -40 * y[2] + 40 * y[3] * y[3],
            -100 * y[3] + 2,
        ],
        (1, 1, 1, 1), 20.0,
    ),
    Problem(
        "D1",
        lambda t, y: [
            0.2 * (y[1] - y[0]),
            10 * y[0] - (60 - 0.125 * y[2]) * y[1] + 0.125 * y[2],
            1.0,
        ],
        (0, 0, 0), 100.0,
    ),
    Problem(
        "E2", lambda t, y: [y[1], 5 * (1 - y[0] * y[0]) * y[1] - y[0]], (2, 0), 1.0
    ),
]  # fmt: skip
GENTLE = [
    Problem("A3", lambda t, y: [y[0] * np.cos(t)] if isinstance(t, float) else [y[0] * t.cos()],
            (1,), 20.0, (float(np.exp(np.sin(20.0))),)),
    Problem("B1", lambda t, y: [2 * (y[0] - y[0] * y[1]), -(y[1] - y[0] * y[1])], (1, 3), 20.0),
    Problem("D2", lambda t, y: [
        y[2], y[3],
        -y[0] / ((y[0] * y[0] + y[1] * y[1]) ** 1.5), -y[1] / ((y[0] * y[0] + y[1] * y[1]) ** 1.5),
    ], (0.7, 0, 0, float(np.sqrt(1.3 / 0.7))), 20.0),
]  # fmt: skip
