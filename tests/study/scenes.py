"""The tiny scene of the study and command-line tests."""

TINY = """
name = "tiny"
duration = "40 s"
sample = "5 s"
seed = 7
[matrix]
diameter = "40 um"
nodes = 400
[[cells]]
position = ["0 um", "0 um"]
polarity = "60 deg"
radius = "5 um"
[effects]
drag = {}
membrane_elasticity = {}
volume = {}
cortical_tension = {}
focal_adhesion = { kinetics = "clutch" }
lamellipodium = { force = "600 pN" }
substrate_contact = {}
matrix_elasticity = { law = "buckling" }
foundation = {}
stiffness_sensing = {}
polarity = { kappa = "1/60 1/s" }
[training]
runs = 3
held_out = 1
duration = "40 s"
sample = "5 s"
"""


def tiny(**changes):
    """The scene's text with pieces replaced: `old=new` pairs of a mapping."""
    text = TINY
    for old, new in changes.get("replace", {}).items():
        if text.count(old) < 1:
            raise ValueError(f"{old!r} is not in the scene")
        text = text.replace(old, new)
    return text
