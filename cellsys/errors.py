"""The exceptions a caller can catch.

Every one derives from `CellsysError` and from the builtin that describes it, so that
``except ValueError`` keeps working. A message names the value, the bound and the cure.
"""

from __future__ import annotations

from cellsys.renamed import old_names

__getattr__ = old_names(__name__)


class CellsysError(Exception):
    """Root of all errors raised on purpose by cellsys."""


class ParameterError(CellsysError, ValueError):
    """A parameter has a value outside its bound."""


class UnitError(ParameterError):
    """A quantity has no unit, an unknown unit or a unit of another dimension."""


class SceneError(ParameterError):
    """A scene file is contradictory or names something that does not exist."""


class DimensionError(CellsysError, ValueError):
    """Arrays do not fit together."""


class CausalityError(CellsysError, ValueError):
    """A bond graph has no computable set of equations; the message names the elements."""


class DataError(CellsysError, ValueError):
    """Data hold NaN or inf, or too few samples for what is asked of them."""


class RankError(DataError):
    """More directions are asked for than the data span."""


class UnknownNameError(CellsysError, KeyError):
    """Nothing has that name; the message lists the names there are."""

    def __str__(self) -> str:
        return str(self.args[0])  # a KeyError would show its repr


class RepresentationError(CellsysError, AttributeError):
    """A model's representation does not have the thing asked for (rows of V, say)."""


class NotSymbolicError(CellsysError, TypeError):
    """A system has no CasADi form although the integrator needs one."""


class IntegrationError(CellsysError, RuntimeError):
    """An integration failed.

    Attributes
    ----------
    time : float
        Time of the failure, s.
    state_norm : float
        Euclidean norm of the last finite state.
    step : float
        Step size at the failure, s.
    """

    def __init__(self, message: str, *, time: float, state_norm: float, step: float) -> None:
        super().__init__(
            f"{message} (t = {time:.6g} s, |x| = {state_norm:.6g}, step = {step:.3g} s)"
        )
        self.time, self.state_norm, self.step = float(time), float(state_norm), float(step)

    def __reduce__(self) -> tuple:
        # The message already carries the numbers; rebuild without adding them twice.
        return _rebuild_integration_error, (str(self), self.time, self.state_norm, self.step)


def _rebuild_integration_error(
    text: str, time: float, state_norm: float, step: float
) -> IntegrationError:
    error = IntegrationError.__new__(IntegrationError)
    RuntimeError.__init__(error, text)
    error.time, error.state_norm, error.step = time, state_norm, step
    return error


class FileFormatError(CellsysError, ValueError):
    """A file is truncated, foreign, or of another schema version."""


class LostRunError(CellsysError, OSError):
    """The folder of a run was removed, or taken over by another process, while it was written."""


class UnusedDataWarning(UserWarning):
    """A file holds arrays that nobody asks for, under names that nobody knows."""


class TransposedDataWarning(UserWarning):
    """An array of samples looks as if its rows were states and its columns samples."""


class DamagedRunWarning(UserWarning):
    """A run in the cache is damaged or incomplete, and is made again."""


class ForeignRunWarning(UserWarning):
    """Runs were made on another kind of processor: they may differ in the last digits."""


class ExecutorError(CellsysError, RuntimeError):
    """What was to run the work is gone: a scheduler that does not answer, workers that died."""


class MemoryBudgetError(CellsysError, MemoryError):
    """A scene or data set asks for more memory than there is."""
