"""Errors that a user can cause; one line says what, got, expected, and the next step."""


class SimulationError(Exception):
    """Root of every error this package raises on purpose."""


class PlantError(SimulationError):
    """A plant parameter or state cannot be used."""


class ExcitationError(SimulationError):
    """A text is not in the excitation language, or asks for a voltage that no motor should see."""


class SensorError(SimulationError):
    """A sensor parameter cannot be used."""


class ScheduleError(SimulationError):
    """A scheduled change of a plant parameter cannot be understood or carried out."""


class ConfigurationError(SimulationError):
    """A simulation or node parameter has a value that cannot be used."""
