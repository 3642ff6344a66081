"""The errors that a user of this package can cause, all of one base class."""

from __future__ import annotations


class TorchOrenNayarError(Exception):
    """Base class of all errors that a user can cause.

    The message is ``argument: expected ..., got ...; mend``.

    Attributes:
        argument: name of the argument, file or setting.
        expected: what it should have been.
        got: what it was.
        mend: what to do about it.

    Example:
        >>> import torch_orennayar as ton
        >>> issubclass(ton.ShapeError, ton.TorchOrenNayarError)
        True
    """

    def __init__(self, argument: str, *, expected: str, got: str, mend: str) -> None:
        self.argument = argument
        self.expected = expected
        self.got = got
        self.mend = mend
        super().__init__(f"{argument}: expected {expected}, got {got}; {mend}")

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle with all attributes, so that errors reach the parent process from data loader workers."""
        return _rebuild, (type(self), self.argument, self.expected, self.got, self.mend)


def _rebuild(kind: type[TorchOrenNayarError], argument: str, expected: str, got: str, mend: str) -> TorchOrenNayarError:
    return kind(argument, expected=expected, got=got, mend=mend)


class ShapeError(TorchOrenNayarError, ValueError):
    """A tensor has the wrong shape or dtype, or shapes do not fit together."""


class RangeError(TorchOrenNayarError, ValueError):
    """A value is outside the range in which the result has a meaning, or is not finite."""


class ModelError(TorchOrenNayarError, ValueError):
    """A reflectance model is unknown or broken, or its name is taken."""


class CaptureError(TorchOrenNayarError, ValueError):
    """A capture does not determine the requested result (too few lights, coplanar lights, ...)."""


class FileError(TorchOrenNayarError, OSError):
    """A file is missing, damaged, of the wrong kind, or outside the folder it belongs in."""


class ExportError(TorchOrenNayarError, RuntimeError):
    """A graph could not be written, or does not compute what torch computes."""


class MissingPackageError(TorchOrenNayarError, ImportError):
    """A third-party package that only this part needs is not installed; the message holds the ``pip`` command."""
