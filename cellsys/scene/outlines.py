"""A scene to start from, as a commented file: a preset with every parameter of its effects."""

from __future__ import annotations

import re
import textwrap

from cellsys.errors import ParameterError
from cellsys.scene.inherit import PRESETS
from cellsys.scene.listing import effect_list, effect_table, setting_text

OUTLINES = {
    "cell": "spreading",
    "pair": "two_cells",
    "ten": "ten_cells",
    "chain": "crawler",
    "passive": "passive_matrix",
    "membrane": "isolated_membrane",
}
_COMMON = {
    "duration": "a number with its unit, as every quantity",
    "sample": "between samples; divides the duration",
    "seed": "of the network and of what is drawn",
    "[training]": "runs that reduced models are learned from; without this table none are",
    "[effects]": "what acts; see cellsys effects",
    "[[cells]]": "one such table a cell",
}
_WIDE = 96
_STEPPER = (
    "# What steps it: auto (what suits the scene), BDF2, RKC or LinearlyImplicit, with a longest",
    "# step or a tolerance. cellsys run --error 0.02 finds them for an error.",
    '# run = { stepper = "BDF2", step = "1.25 s" }',
)


def outline(kind: str, name: str) -> str:
    """The text of a scene file of this kind.

    Parameters
    ----------
    kind : str
        One of `OUTLINES`.
    name : str
        Of the scene.

    Raises
    ------
    ParameterError
        For an unknown kind.
    """
    if kind not in OUTLINES:
        raise ParameterError(f"kind must be one of {', '.join(OUTLINES)}, got {kind!r}")
    told = {row["effect"]: row["what it is"] for row in effect_list()}
    parameters: dict[str, dict[str, tuple[str, str]]] = {}
    for row in effect_table():
        parameters.setdefault(row["effect"], {})[row["parameter"]] = setting_text(row)
    lines: list[str] = []
    inside = ""
    preset = (PRESETS / f"{OUTLINES[kind]}.toml").read_text(encoding="utf-8")
    for line in preset.splitlines():
        if line.startswith("["):
            inside = line.strip()
        key = line.partition("=")[0].strip()
        if line.startswith("name ="):
            lines.append(f"name = {_quoted(name)}")
        elif inside == "[effects]" and key in told:
            lines += ["", *_comment(told[key]), line, *_more(parameters.get(key, {}), line)]
        elif key in _COMMON and "#" not in line:
            if not any(_COMMON[key] in known for known in lines):
                lines += _comment(_COMMON[key])
            lines.append(line)
            if key == "seed" and "lead_node" not in preset:  # crawlers have a method of their own
                lines += ["", *_STEPPER]
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def _quoted(name: str) -> str:
    if re.search(r'[\x00-\x1f\x7f"\\]', name):
        raise ParameterError(f"a scene's name takes no quotes and no control characters: {name!r}")
    return f'"{name}"'


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDE, initial_indent="# ", subsequent_indent="# ")


def _more(parameters: dict[str, tuple[str, str]], line: str) -> list[str]:
    """The parameters that the line leaves at their defaults, commented out."""
    out: list[str] = []
    for name, (setting, meaning) in parameters.items():
        if not re.search(rf"\b{name} =", line):
            indent = "#     "
            out += textwrap.wrap(
                f"{setting}  {meaning}", _WIDE, initial_indent=indent, subsequent_indent=indent * 2
            )
    return out
