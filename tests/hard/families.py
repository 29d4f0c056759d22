"""The families of hard cases, by name, for the stress command."""

from __future__ import annotations

from importlib import import_module

_FILES = {
    "Spectra": "test_1_spectra",
    "Margins": "test_1_margins",
    "Drawn": "test_1_drawn",
    "Coupling": "test_2_coupling",
    "Polarity": "test_3_polarity",
    "Data": "test_4_data",
    "Roll-out": "test_5_rollout",
    "Mechanics": "test_6_mechanics",
    "Gaps": "test_6_gaps",
    "Switching": "test_7_switching",
    "Integrators": "test_8_integrators",
    "Process": "test_9_process",
}
FAMILIES = {name: import_module(f"tests.hard.{file}").CASES for name, file in _FILES.items()}
