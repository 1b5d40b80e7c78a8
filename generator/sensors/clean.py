"""The sensor `clean`: the rendered video as it is."""

from generator.sensors.base import SensorModel


class Clean(SensorModel):
    """Adds nothing."""

    name = "clean"
    replaces = "all"
