"""What may see the ground in a bag: one module a kind of sensor; `SENSORS` has them by priority."""

from gpgrad_core.recordings.sensors.depth import DEPTH
from gpgrad_core.recordings.sensors.livox import LIVOX
from gpgrad_core.recordings.sensors.point_cloud import POINT_CLOUD
from gpgrad_core.recordings.sensors.sensor import Bag, Decode, Message, Sensor
from gpgrad_core.recordings.sensors.stereo_pair import STEREO_PAIR

SENSORS: tuple[Sensor, ...] = (POINT_CLOUD, LIVOX, DEPTH, STEREO_PAIR)

__all__ = ["SENSORS", "Bag", "Decode", "Message", "Sensor"]
