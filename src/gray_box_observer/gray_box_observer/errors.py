"""Errors that a user can cause; each message says what, got, expected, and the next step."""


class GrayBoxError(Exception):
    """Root of every error this package raises on purpose."""


class ConfigurationError(GrayBoxError):
    """A parameter has a value that cannot be used."""


class BagError(GrayBoxError):
    """A bag, or a log to be made one, cannot be used."""


class SampleError(GrayBoxError):
    """Samples cannot be used as they are."""
