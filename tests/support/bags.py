"""Writes bags like those of robots, with rosbags."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpgrad_core.recordings.sensors import DEFINITIONS
from gpgrad_core.recordings.trajectory import Poses
from tests.support.drive import MOUNT, Drive

CLOUD, ODOMETRY, STAMPED = (
    "sensor_msgs/msg/PointCloud2",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
)
TF = "tf2_msgs/msg/TFMessage"
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
"""A message type of ROS 1 whose package rosbags does not know."""


class BagWriter:
    """Writes messages of ROS 1 or of ROS 2."""

    def __init__(self, path: Path, *, ros1: bool, storage: str = "sqlite3") -> None:
        rosbag1, rosbag2, typesys = (
            pytest.importorskip(f"rosbags.{part}", reason="the extra 'ros' is not installed")
            for part in ("rosbag1", "rosbag2", "typesys")
        )
        self.ros1 = ros1
        stores = typesys.Stores
        self.store = typesys.get_typestore(stores.ROS1_NOETIC if ros1 else stores.ROS2_JAZZY)
        if ros1:
            self.store.register(typesys.get_types_from_msg(TF_DEFINITION, TF))
            self.writer: Any = rosbag1.Writer(path)
        else:
            plugins = {"sqlite3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}
            self.writer = rosbag2.Writer(path, version=9, storage_plugin=plugins[storage])
        self.connections: dict[str, Any] = {}
        self.writer.open()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def type(self, name: str) -> Any:
        return self.store.types[name]

    def header(self, stamp: float, frame: str) -> Any:
        seconds = int(stamp)
        time = self.type("builtin_interfaces/msg/Time")(
            sec=seconds, nanosec=round((stamp - seconds) * 1e9)
        )
        number = {"seq": 0} if self.ros1 else {}
        return self.type("std_msgs/msg/Header")(stamp=time, frame_id=frame, **number)

    def write(self, topic: str, kind: str, stamp: float, message: Any, late: float = 0.02) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        # A message is recorded slightly after it was measured.
        logged = round((stamp + late) * 1e9)
        self.writer.write(self.connections[topic], logged, serialize(message, kind))

    def cloud(
        self,
        topic: str,
        stamp: float,
        frame: str,
        points: np.ndarray,
        *,
        stamped: bool = True,
        intensity: np.ndarray | None = None,
        late: float = 0.02,
        **changed: Any,
    ) -> None:
        """Write points as a LiDAR's driver does, with other fields between and after them."""
        layout = np.dtype(
            {
                "names": ["x", "y", "intensity", "z"],
                "formats": ["<f4", "<f4", "<f4", "<f4"],
                "offsets": [0, 4, 8, 12],
                "itemsize": 24,
            }
        )
        table = np.zeros(len(points), layout)
        for name, column in zip("xyz", points.T, strict=True):
            table[name] = column
        if intensity is not None:
            table["intensity"] = intensity
        field = self.type("sensor_msgs/msg/PointField")
        fields = [
            field(name=name, offset=offset, datatype=7, count=1)
            for name, offset in (("x", 0), ("y", 4), ("intensity", 8), ("z", 12))
        ]
        message = self.type(CLOUD)(
            header=self.header(stamp if stamped else 0.0, frame),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=24,
            row_step=24 * len(points),
            data=np.frombuffer(table.tobytes(), np.uint8),
            is_dense=True,
        )
        for name, value in changed.items():
            setattr(message, name, value)
        self.write(topic, CLOUD, stamp, message, late)

    def image(self, topic: str, stamp: float, frame: str, image: np.ndarray, encoding: str) -> None:
        """Write an image as a camera's driver does."""
        kind = "sensor_msgs/msg/Image"
        message = self.type(kind)(
            header=self.header(stamp, frame),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=image[0].nbytes,
            data=np.frombuffer(image.tobytes(), np.uint8),
        )
        self.write(topic, kind, stamp, message)

    def packed(self, topic: str, stamp: float, frame: str, content: bytes, form: str) -> None:
        """Write an image that is compressed already."""
        kind = "sensor_msgs/msg/CompressedImage"
        data = np.frombuffer(content, np.uint8)
        message = self.type(kind)(header=self.header(stamp, frame), format=form, data=data)
        self.write(topic, kind, stamp, message)

    def camera(
        self,
        topic: str,
        stamp: float,
        frame: str,
        size: tuple[int, int],
        projection: np.ndarray,
        distortion: tuple[float, ...] = (0.0,) * 5,
        model: str = "plumb_bob",
    ) -> None:
        """Write the calibration of a camera."""
        kind = "sensor_msgs/msg/CameraInfo"
        values = {
            "d": np.array(distortion),
            "k": np.ravel(projection[:, :3]),
            "r": np.eye(3).ravel(),
            "p": np.ravel(projection),
        }
        region = self.type("sensor_msgs/msg/RegionOfInterest")(
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        message = self.type(kind)(
            header=self.header(stamp, frame),
            width=size[0],
            height=size[1],
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=region,
            **{name.upper() if self.ros1 else name: value for name, value in values.items()},
        )
        self.write(topic, kind, stamp, message)

    def livox(self, topic: str, stamp: float, frame: str, points: np.ndarray, package: str) -> None:
        """Write points as one of Livox's drivers does."""
        kind, point = (f"{package}/msg/{name}" for name in ("CustomMsg", "CustomPoint"))
        if kind not in self.store.types:
            typesys = pytest.importorskip("rosbags.typesys")
            for name in (point, kind):
                self.store.register(typesys.get_types_from_msg(DEFINITIONS[name], name))
        make = self.type(point)
        message = self.type(kind)(
            header=self.header(stamp, frame),
            timebase=round(1e9 * stamp),
            point_num=len(points),
            lidar_id=1,
            rsvd=np.zeros(3, np.uint8),
            points=[
                make(offset_time=k, x=x, y=y, z=z, reflectivity=k % 200, tag=16, line=k % 4)
                for k, (x, y, z) in enumerate(points.tolist())
            ],
        )
        self.write(topic, kind, stamp, message)

    def pose(self, poses: Poses, index: int) -> Any:
        x, y, z = (float(value) for value in poses.translation[index])
        qx, qy, qz, qw = (float(value) for value in poses.rotation[index].as_quat())
        return self.type("geometry_msgs/msg/Pose")(
            position=self.type("geometry_msgs/msg/Point")(x=x, y=y, z=z),
            orientation=self.type("geometry_msgs/msg/Quaternion")(x=qx, y=qy, z=qz, w=qw),
        )

    def odometry(
        self,
        topic: str,
        stamp: float,
        poses: Poses,
        index: int,
        variance: float = 0.0,
        *,
        frames: tuple[str, str] = ("odom", "base_link"),
    ) -> None:
        zero = self.type("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
        twist = self.type("geometry_msgs/msg/Twist")(linear=zero, angular=zero)
        covariance = np.diag(np.full(6, variance)).ravel()
        message = self.type(ODOMETRY)(
            header=self.header(stamp, frames[0]),
            child_frame_id=frames[1],
            pose=self.type("geometry_msgs/msg/PoseWithCovariance")(
                pose=self.pose(poses, index), covariance=covariance
            ),
            twist=self.type("geometry_msgs/msg/TwistWithCovariance")(
                twist=twist, covariance=np.zeros(36)
            ),
        )
        self.write(topic, ODOMETRY, stamp, message)

    def fix(
        self, topic: str, stamp: float, place: tuple[float, float, float], status: int = 0
    ) -> None:
        """Write latitude, longitude [degrees] and height [m] as a receiver's driver does."""
        kind = "sensor_msgs/msg/NavSatFix"
        state = self.type("sensor_msgs/msg/NavSatStatus")(status=status, service=1)
        message = self.type(kind)(
            header=self.header(stamp, "gnss"),
            status=state,
            latitude=place[0],
            longitude=place[1],
            altitude=place[2],
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )
        self.write(topic, kind, stamp, message)

    def stamped(self, topic: str, stamp: float, poses: Poses, index: int) -> None:
        message = self.type(STAMPED)(header=self.header(stamp, "map"), pose=self.pose(poses, index))
        self.write(topic, STAMPED, stamp, message)

    def transform(
        self, stamp: float, parent: str, child: str, poses: Poses, index: int, topic: str = "/tf"
    ) -> None:
        pose = self.pose(poses, index)
        move = self.type("geometry_msgs/msg/Vector3")(
            x=pose.position.x, y=pose.position.y, z=pose.position.z
        )
        message = self.type("geometry_msgs/msg/TransformStamped")(
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=self.type("geometry_msgs/msg/Transform")(
                translation=move, rotation=pose.orientation
            ),
        )
        self.write(topic, TF, stamp, self.type(TF)(transforms=[message]))


def write_bag(
    path: Path, drive: Drive, *, ros1: bool, poses: str, storage: str = "sqlite3"
) -> Path:
    """Write a drive as a bag.

    Its poses are ``odometry`` of the body with the static transform to the sensor, ``stamped``
    poses of the sensor, or ``tf``: only transforms.
    """
    slash = "/" if ros1 else ""
    with BagWriter(path, ros1=ros1, storage=storage) as bag:
        if poses != "stamped":
            frames = f"{slash}base_link", f"{slash}lidar"
            bag.transform(drive.stamps[0], *frames, MOUNT, 0, topic="/tf_static")
        for k, stamp in enumerate(drive.stamps):
            if poses == "odometry":
                bag.odometry("/odom", stamp, drive.body, k, variance=0.01 * k)
            elif poses == "stamped":
                bag.stamped("/pose", stamp, drive.sensor, k)
            else:
                bag.transform(stamp, f"{slash}odom", f"{slash}base_link", drive.body, k)
            bag.cloud("/points", stamp, f"{slash}lidar", drive.scans[k])
    return path
