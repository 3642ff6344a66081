"""The one family of errors that a user of this package can cause."""

from __future__ import annotations


class TorchOrenNayarError(Exception):
    """Base of every error that a user can cause; the message names what was wrong and the mend.

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
        """Survive pickling, so that errors cross process borders (data loader workers) whole."""
        return _rebuild, (type(self), self.argument, self.expected, self.got, self.mend)


def _rebuild(kind: type[TorchOrenNayarError], argument: str, expected: str, got: str, mend: str) -> TorchOrenNayarError:
    return kind(argument, expected=expected, got=got, mend=mend)


class ShapeError(TorchOrenNayarError, ValueError):
    """A tensor has the wrong shape, or shapes do not fit together."""


class RangeError(TorchOrenNayarError, ValueError):
    """A value is outside the range in which the answer means something, or is not finite."""


class ModelError(TorchOrenNayarError, ValueError):
    """A reflectance model is unknown, already taken, or broken."""


class CaptureError(TorchOrenNayarError, ValueError):
    """A capture does not determine what was asked for (too few lights, coplanar lights, ...)."""


class FileError(TorchOrenNayarError, OSError):
    """A file is missing, damaged, of the wrong kind, or outside the folder it belongs to."""


class ExportError(TorchOrenNayarError, RuntimeError):
    """A graph could not be written, or does not compute what torch computes."""


class MissingPackageError(TorchOrenNayarError, ImportError):
    """A third-party package that only this part needs is not installed; the message holds the ``pip`` command."""
