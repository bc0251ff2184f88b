"""PointCloud2 messages -> scans."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.recordings.params import Condition, Tally, kept_points
from gpgrad_core.recordings.recording import Scan
from gpgrad_core.recordings.sensors.sensor import Bag, Decode, Message, Sensor, each_topic

TYPE = "sensor_msgs/msg/PointCloud2"
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's types by the numbers that the message uses for them."""


def points_of(
    message: Message, where: str, keep: Sequence[Condition] = (), tally: Tally | None = None
) -> Float[NDArray[np.floating], "n 3"]:
    """Read x, y and z [m] of each point that meets all conditions on any fields, NaN too.

    The tally counts them.
    """
    fields = {field.name: field for field in message.fields}
    names = list(dict.fromkeys([*"xyz", *(condition.field for condition in keep)]))
    missing = [name for name in names if name not in fields]
    if missing:
        held = ", ".join(fields) or "nothing"
        raise InputError(f"{where}: its points have no field {' or '.join(missing)}, only {held}")
    order = ">" if message.is_bigendian else "<"
    formats = [order + NUMBERS.get(fields[name].datatype, "") for name in names]
    wrong = [name for name, kind in zip(names, formats, strict=True) if len(kind) < 2]
    if wrong and wrong[0] in "xyz":
        raise InputError(f"{where}: x, y and z do not have a number type of PointCloud2")
    if wrong:
        raise InputError(f"{where}: {wrong[0]} does not have a number type of PointCloud2")
    rows, columns = int(message.height), int(message.width)
    row_size = columns * int(message.point_step)
    # Some drivers leave row_step at 0 when the rows have no padding.
    step = max(int(message.row_step), row_size) if rows > 1 else row_size
    data = np.asarray(message.data, np.uint8)
    if rows * columns == 0:
        return np.empty((0, 3))
    ends = [
        fields[name].offset + np.dtype(f).itemsize for name, f in zip(names, formats, strict=True)
    ]
    if max(ends) > message.point_step or len(data) < (rows - 1) * step + row_size:
        raise InputError(
            f"{where}: is cut short: it should hold {rows * columns:,} points of "
            f"{message.point_step} bytes, but it holds {len(data):,} bytes"
        )
    layout = np.dtype(
        {
            "names": names,
            "formats": formats,
            "offsets": [fields[name].offset for name in names],
            "itemsize": int(message.point_step),
        }
    )
    bodies = [data[k * step : k * step + row_size].tobytes() for k in range(rows)]
    table = np.frombuffer(b"".join(bodies), layout)

    def values_of(name: str) -> NDArray[np.float64]:
        return table[name].astype(np.float64)

    mask = kept_points(keep, values_of, where, tally)
    if mask is not None:
        table = table[mask]
    points = np.column_stack([table[name] for name in "xyz"])
    return points.astype(np.float64 if points.dtype.itemsize > 4 else np.float32)


def _open(bag: Bag, _topics: tuple[str, ...]) -> Decode:
    def decode(messages: Sequence[tuple[Message, ...]], where: Sequence[str]) -> Iterator[Scan]:
        for (message,), place in zip(messages, where, strict=True):
            yield Scan(points_of(message, place, bag.sources.keep, bag.tally))

    return decode


POINT_CLOUD = Sensor("clouds", (TYPE,), each_topic(TYPE), _open)
