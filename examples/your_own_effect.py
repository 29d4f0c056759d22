"""An effect of your own: optical tweezers that draw a cell's centre to a point."""

from dataclasses import dataclass

import scipy.sparse as sp

import cellsys as cs
from cellsys.effects import Effect, Element, Port, Stiffness, parameter


@dataclass(frozen=True)
class Tweezers(Effect):
    """E = k/2 |mean of the nodes - (x, start, start)|^2."""

    name = "tweezers"
    stiffness: float = parameter("50 pN/um", "pN/um", least=0, source="a trap", about="k")
    x: float = parameter("3 um", "um", source="a trap", about="where it is held along x")

    def elements(self, site):
        return (Trap(self, site.cell),)


class Trap(Element):
    def __init__(self, effect, cell):
        self.k, self.array, self.name = effect.stiffness, cell.name, f"{cell.name}.tweezers"
        self.target = cell.membrane.position.mean(axis=0) * [0, 1, 1] + [effect.x, 0, 0]
        self.ports = (Port(cell.name, self.name),)

    def efforts(self, s, out):
        out[0][:] = self.k / len(out[0]) * (self.target - s.nodes[self.array].mean(axis=0))

    def stiffness(self, s):
        n = len(s.nodes[self.array])
        return (Stiffness(self.array, (0, 1, 2), lambda: self.k / n * sp.eye_array(n).tocsc(), 0),)


table = {"extends": "isolated_membrane", "effects": {"tweezers": {"stiffness": "0.1 N/m"}}}
run = cs.run_scene(cs.Scene.parse(table, effects=[Tweezers]))
center = run.block("cell1.position").mean(axis=1)
print(f"the trap drew the cell from x = {center[0, 0]:.2f} um to {center[-1, 0]:.2f} um")
