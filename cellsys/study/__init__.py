"""The main job: scene to report.

``cs.study(scene, out=...)`` and ``import cellsys.study`` share one name, so the module itself
can be called.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from cellsys.study.run import StudyResult, study

if TYPE_CHECKING:
    from cellsys.study.cells import CellsStudy
    from cellsys.study.crawler import CrawlerStudy
    from cellsys.study.gel import GelStudy

__all__ = ["StudyResult", "study"]


class _CallableModule(ModuleType):
    def __call__(
        self, *args: Any, **options: Any
    ) -> StudyResult | CrawlerStudy | CellsStudy | GelStudy:
        return study(*args, **options)


sys.modules[__name__].__class__ = _CallableModule
