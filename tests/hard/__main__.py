"""``python -m tests.hard --minutes N``: random hard instances of every family.

Prints how many were tried, held, were refused with a reason, and failed; exit code 1 when any
failed, each with its smallest parameters and its seed. Cases that are held against an oracle are
named; they run in `--jobs` processes beside the rest (``--jobs 1``: in turn with it).
``--fuzz scene|run|model`` tries nothing but changed files of one kind: read, built and learned
from, or refused; in time, in memory, and nothing written outside their folder.
"""

import argparse
import os
import sys

from tests.hard import stress

FUZZ = {
    "scene": ("scene file changed",),
    "run": ("run folder damaged", "run file changed"),
    "model": ("model file cut", "model file changed", "model file forged"),
}


def warm() -> None:
    """Compile the laws first: that takes longer than an instance may."""
    from cellsys.integrate import LinearlyImplicit, simulate
    from tests.mechanics.small_scenes import tiny_system

    shell = ("membrane_elasticity", "volume", "cortical_tension", "lamellipodium")
    for kinetics in ("clutch", "switching"):
        system = tiny_system(
            *shell, "focal_adhesion", "substrate_contact", "matrix_elasticity", "foundation",
            "polarity", focal_adhesion={"kinetics": kinetics},
        )  # fmt: skip
        simulate(system, LinearlyImplicit(step=0.5), [0.0, 1.0], seed=1)


def main() -> int:
    """Exit code."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from tests.hard.families import FAMILIES
    from tests.hard.side import processors, run, split

    parser = argparse.ArgumentParser(prog="python -m tests.hard", description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0, help="of the instances drawn")
    parser.add_argument("--family", choices=sorted(FAMILIES), action="append")
    names = sorted({case.name for group in FAMILIES.values() for case in group})
    parser.add_argument("--case", choices=names, action="append", help="of any family")
    parser.add_argument("--fuzz", choices=FUZZ, help="files of one kind only")
    parser.add_argument("--jobs", type=int, default=processors(), help="processes")
    parser.add_argument("--cases", action="store_true", help="also a line for every case")
    given = parser.parse_args()
    wanted = [*(given.case or ()), *FUZZ.get(given.fuzz, ())] or names
    chosen = {
        family: kept
        for family, group in FAMILIES.items()
        if given.family is None or family in given.family
        if (kept := tuple(case for case in group if case.name in wanted))
    }
    if not chosen:
        parser.error("no case of that name in that family")
    if given.jobs < 1:
        parser.error("--jobs must be at least 1")
    if split(chosen, False):
        warm()
    counts = run(chosen, 60.0 * given.minutes, given.seed, given.jobs)
    total = stress.Count()
    print(f"{'':40s}{'tried':>8s}{'held':>8s}{'refused':>8s}{'failed':>8s}{'s':>8s}")
    oracles = [f"  {case.name}" for group in split(chosen, True).values() for case in group]
    for name, c in counts.items():
        if name in chosen:
            total += c
        elif not given.cases and name not in oracles:
            continue
        print(f"{name:40s}{c.tried:8d}{c.held:8d}{c.refused:8d}{c.failed:8d}{c.seconds:8.1f}")
    if oracles:
        c = sum((counts[name] for name in oracles), stress.Count())
        print(f"against oracles: {c.tried} systems, {c.tried / given.minutes:.0f} a minute, "
              f"{c.failed} disagreements, in {len(oracles)} families: "
              + ", ".join(name.strip() for name in oracles))  # fmt: skip
    c = total
    print(f"tried {c.tried}, held {c.held}, refused {c.refused}, failed {c.failed}")
    return 1 if c.failed else 0


if __name__ == "__main__":
    sys.exit(main())
