"""The points of a ROS message ``sensor_msgs/PointCloud2``."""

from typing import Any

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's types by the numbers that the message has for them."""


def points_of(message: Any, where: str) -> Float[NDArray[np.floating], "n 3"]:
    """Give x, y and z [m] of each point, NaN and all.

    Args:
        message: As rosbags deserialises it.
        where: Its topic and number, for the error message.

    Raises:
        InputError: If it has no x, y and z, or fewer bytes than it promises.
    """
    fields = {field.name: field for field in message.fields}
    missing = [name for name in "xyz" if name not in fields]
    if missing:
        held = ", ".join(fields) or "nothing"
        raise InputError(f"{where}: its points have no field {' or '.join(missing)}, only {held}")
    order = ">" if message.is_bigendian else "<"
    formats = [order + NUMBERS.get(fields[name].datatype, "") for name in "xyz"]
    if any(len(one) < 2 for one in formats):
        raise InputError(f"{where}: x, y and z are of no number type that PointCloud2 has")
    rows, columns = int(message.height), int(message.width)
    row_size = columns * int(message.point_step)
    # A driver that leaves row_step at 0 means rows without padding.
    step = max(int(message.row_step), row_size) if rows > 1 else row_size
    data = np.asarray(message.data, np.uint8)
    if rows * columns == 0:
        return np.empty((0, 3))
    ends = [
        fields[name].offset + np.dtype(f).itemsize for name, f in zip("xyz", formats, strict=True)
    ]
    if max(ends) > message.point_step or len(data) < (rows - 1) * step + row_size:
        raise InputError(
            f"{where}: is cut short: {rows * columns:,} points of {message.point_step} bytes are "
            f"promised, {len(data):,} bytes are there"
        )
    layout = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": formats,
            "offsets": [fields[name].offset for name in "xyz"],
            "itemsize": int(message.point_step),
        }
    )
    bodies = [data[k * step : k * step + row_size].tobytes() for k in range(rows)]
    table = np.frombuffer(b"".join(bodies), layout)
    points = np.column_stack([table[name] for name in "xyz"])
    return points.astype(np.float64 if points.dtype.itemsize > 4 else np.float32)
