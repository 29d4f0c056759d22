"""Energies of the effects written a second time, in plain numpy that takes complex positions.

E(x + i h d) gives dE/dx . d = Im E/h without cancellation (complex step), so that forces can be
compared with the gradient to rounding. Branches look at real parts.
"""

import numpy as np

from cellsys.effects.fibre_bending import straight_pairs
from cellsys.geometry.surface_kernels import closest_on_triangle


def norm(d, soft):
    """Length of row vectors, softened like the shipped one."""
    return np.sqrt((d * d).sum(axis=-1) + soft)


def springs(a, b, rest, k, cubic):
    d = norm(b - a, 1e-6) - rest
    return (k * d * d * (0.5 + 0.25 * cubic / rest**2 * d * d)).sum()


def areas(x, triangles, rest, modulus, tension):
    a, b, c = (x[triangles[:, i]] for i in range(3))
    J = 0.5 * norm(np.cross(b - a, c - a), 1e-6) / rest
    h = np.where(J.real >= 1.0, 0.5 * (J - 1.0) ** 2, 0.5 * (1.0 / J - 1.0) ** 2)
    return (rest * (modulus * h + tension * J)).sum()


def volume(x, triangles):
    a, b, c = (x[triangles[:, i]] for i in range(3))
    return (a * np.cross(b, c)).sum() / 6.0


def pressure(x, mesh, modulus):
    return 0.5 * modulus * (volume(x, mesh.triangles) - mesh.volume) ** 2 / mesh.volume


def fibre(e, law):
    """Integral of g(e), elementwise, for any complex e."""
    rho, w, onset, growth = law
    root = np.sqrt(e * e + w * w)
    over = np.where(e.real > onset, e - onset, 0.0)
    inner = np.where(over.real < growth * onset, over, growth * onset)
    past = over - inner
    bent = 0.5 * (e * root + w * w * np.log(e / w + root / w))
    value = 0.5 * rho * e * e + 0.5 * (1.0 - rho) * (0.5 * e * e + bent - w * e)
    value = value + inner**3 / (6.0 * onset)
    return value + 0.5 * inner**2 / onset * past + 0.5 * growth * past**2


def membrane_elasticity(item, nodes, internal):
    e, m, x = item.effect, item.mesh, nodes[item.array]
    a, b = m.edges.T
    return springs(x[a], x[b], m.edge_length, e.line, e.stiffening) + areas(
        x, m.triangles, m.triangle_area, e.area, 0.0
    )


def cortical_tension(item, nodes, internal):
    m = item.mesh
    return areas(nodes[item.array], m.triangles, m.triangle_area, 0.0, item.effect.tension)


def cell_volume(item, nodes, internal):
    change = volume(nodes[item.array], item.mesh.triangles) - item.mesh.volume
    return pressure(nodes[item.array], item.mesh, item.effect.modulus) - item.pressure * change


def substrate_contact(item, nodes, internal):
    depth = item.effect.gap - nodes[item.array][:, 2]
    return 0.5 * item.effect.stiffness * (np.where(depth.real > 0, depth, 0.0) ** 2).sum()


def strains(disc, u, soft=1e-12):
    now = disc.position + u
    return norm(now[disc.fibres[:, 1]] - now[disc.fibres[:, 0]], soft) / disc.length - 1.0


def matrix_elasticity(item, nodes, internal):
    d = item.disc
    return (d.stiffness * d.length**2 * fibre(strains(d, nodes["matrix"]), item.law)).sum()


def foundation(item, nodes, internal):
    return 0.5 * item.spring * (nodes["matrix"][:, 2] ** 2).sum()


def switching(item, nodes, internal):
    partner = internal[item.partner]
    bound = np.flatnonzero(partner >= 0)
    j = partner[bound].astype(int)
    now = norm(item.disc.position[j] + nodes["matrix"][j] - nodes[item.array][bound], 1e-12)
    stretch = now - internal[item.length][bound]
    stretch = np.where(stretch.real > 0, stretch, 0.0)
    return 0.5 * item.effect.bond_stiffness * (internal[item.number][bound] * stretch**2).sum()


def fibre_bending(item, nodes, internal):
    d, x = item.disc, item.disc.position + nodes["matrix"]
    i, j, k = straight_pairs(d, np.radians(30)).T

    def angle(y):
        p, q = y[j] - y[i], y[k] - y[j]
        p, q = p / norm(p, 1e-12)[:, None], q / norm(q, 1e-12)[:, None]
        sine = norm(np.cross(p, q), 1e-6)
        cosine = (p * q).sum(axis=1)
        # The angle of a vector (cos, sin) in the upper half plane; analytic, unlike arctan2.
        return 2.0 * np.arctan(sine / (np.sqrt(sine**2 + cosine**2) + cosine))

    length = 0.5 * (norm(d.position[j] - d.position[i], 0) + norm(d.position[k] - d.position[j], 0))
    return (0.5 * 19.6 / length * (angle(x) - angle(d.position)) ** 2).sum()


def matrix_creep(item, nodes, internal):
    d, q, a = item.disc, item.effect.ratio, internal[item.state]
    e = strains(d, nodes["matrix"])
    if item.effect.branch == "maxwell":
        return 0.5 * (q * d.stiffness * (e * d.length - a) ** 2).sum()
    fibres = fibre(e - a / d.length, item.law) - fibre(e, item.law)
    return (d.stiffness * (d.length**2 * fibres + 0.5 * a**2 / q)).sum()


def matrix_degradation(item, nodes, internal):
    d = item.disc
    lost = (internal[item.state] - 1.0) * d.stiffness * d.length**2
    return (lost * fibre(strains(d, nodes["matrix"]), item.law)).sum()


def cortex(item, nodes, internal):
    m, s = item.mesh, nodes[item.layer]
    tension = areas(nodes[item.array] + s, m.triangles, m.triangle_area, 0.0, item.effect.tension)
    return tension + 0.5 * item.effect.link * (s * s).sum()


def nucleus(item, nodes, internal):
    e, m, x = item.effect, item.mesh, nodes[item.inner]
    a, b = m.edges.T
    both = np.concatenate([nodes[item.array], x])
    c, f = item.links.T
    return (
        springs(x[a], x[b], m.edge_length, e.line, e.stiffening)
        + areas(x, m.triangles, m.triangle_area, e.area, 0.0)
        + pressure(x, m, e.modulus)
        + springs(both[c], both[f], item.link_length, e.filament, e.stiffening)
    )


def stress_fibres(item, nodes, internal):
    bound = internal[f"{item.array}.bond_strength"]
    offset = nodes[item.array] - nodes[item.anchor].mean(axis=0)
    length = norm(offset, item.effect.soft**2)
    return item.effect.tension * (bound * (length - item.effect.soft)).sum()


def pressed(x, y, triangles, e):
    """Of nodes x near a surface; closest points are found on real positions: their shares do not
    change the first derivative.
    """
    total = 0.0
    for p in x:
        best = (np.inf, 0.0, None)
        # Only triangles within reach of an edge or two can be the closest one.
        far = np.linalg.norm(y[triangles].real - p.real, axis=2).min(axis=1)
        for t in triangles[far < far.min() + 1.5]:
            corners, share = y[t], np.empty(3)
            closest_on_triangle(p.real, *corners.real, share)
            r = (p - share @ corners).real
            n = np.cross(*(corners[1:] - corners[0]).real)
            over = r @ n / np.linalg.norm(n)
            d = np.linalg.norm(r)
            if d < best[0] - 1e-9 or (d < best[0] + 1e-9 and abs(over) > abs(best[1])):
                best = (min(d, best[0]), over, p - share @ corners)
        distance = np.sign(best[1]) * norm(best[2], 0.0)
        if distance.real < e.gap:
            total = total + 0.5 * e.stiffness * (e.gap - distance) ** 2
    return total


def cell_contact(item, nodes, internal):
    total = 0.0
    for first in item.cells:
        for other in item.cells:
            if first is not other:
                x, y = nodes[first.name], nodes[other.name]
                near = x[np.abs(x.real[:, 0]) < 2.0]
                total = total + pressed(near, y, other.membrane.triangles, item.effect)
    return total


def matrix_contact(item, nodes, internal):
    x, total = item.matrix.position + nodes["matrix"], 0.0
    for cell in item.cells:
        y = nodes[cell.name]
        apart = np.linalg.norm(x.real[:, None] - y.real[None], axis=2).min(axis=1)
        total = total + pressed(x[apart < 3.0], y, cell.membrane.triangles, item.effect)
    return total


ENERGIES = {
    "membrane_elasticity": membrane_elasticity,
    "cortical_tension": cortical_tension,
    "volume": cell_volume,
    "substrate_contact": substrate_contact,
    "matrix_elasticity": matrix_elasticity,
    "foundation": foundation,
    "stochastic_adhesion": switching,
    "fibre_bending": fibre_bending,
    "matrix_creep": matrix_creep,
    "matrix_degradation": matrix_degradation,
    "cortex": cortex,
    "nucleus": nucleus,
    "stress_fibres": stress_fibres,
    "cell_contact": cell_contact,
    "matrix_contact": matrix_contact,
}
