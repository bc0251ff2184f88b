"""A ROS 2 node around `LoopCloser`: clouds and odometry in, loop closures out.

    python node.py --ros-args -r cloud:=/lidar/points -r odometry:=/odom -p length:=5.0

It needs ROS 2 with rclpy, tf2_ros, sensor_msgs_py and the standard messages.
"""

from collections.abc import Mapping

import numpy as np
import rclpy
from closing import Constraint, ScanCloser
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from sensor_msgs_py.point_cloud2 import read_points_numpy
from tf2_ros import Buffer, TransformException, TransformListener

import gpgrad_core as gg


class LoopClosingNode(Node):
    """Subscribes to ``cloud`` and ``odometry``, and publishes ``closures`` and ``path``."""

    def __init__(self) -> None:
        """Set up parameters, transforms and topics."""
        super().__init__("gpgrad")
        length = self.declare_parameter("length", 5.0).value
        voxel = self.declare_parameter("voxel", 0.05).value
        radius = self.declare_parameter("search_radius", 30.0).value
        self._transforms = Buffer()
        self._listener = TransformListener(self._transforms, self)
        self._body: tuple[str, str, gg.Pose] | None = None  # odometry's frame, child and pose
        self._closures = self.create_publisher(PoseWithCovarianceStamped, "closures", 10)
        self._path = self.create_publisher(Path, "path", 1)
        viewer = self.declare_parameter("viewer", "").value  # such as localhost:8090
        self._frame = "odom"
        live = gg.Live(viewer, on_corrected=self._publish_path) if viewer else None
        self._closer = ScanCloser(length, voxel, live, search_radius=radius)
        self.create_subscription(Odometry, "odometry", self._take_odometry, 100)
        self.create_subscription(PointCloud2, "cloud", self._take_cloud, 10)

    def _take_odometry(self, message: Odometry) -> None:
        pose = message.pose.pose
        found = _pose(pose.position, pose.orientation)
        self._body = message.header.frame_id, message.child_frame_id, found

    def _take_cloud(self, message: PointCloud2) -> None:
        if self._body is None:
            return
        self._frame, child, T_odom_body = self._body
        try:  # where the sensor sits on the body
            mount = self._transforms.lookup_transform(child, message.header.frame_id, Time())
        except TransformException as error:
            self.get_logger().warn(f"{message.header.frame_id}: {error}")
            return
        found = mount.transform
        T_odom_sensor = T_odom_body @ _pose(found.translation, found.rotation)
        points = read_points_numpy(message, field_names=("x", "y", "z"), skip_nans=True)
        try:
            for one in self._closer.add(points.astype(np.float64), T_odom_sensor):
                self._publish(one, message.header.stamp)
                self._publish_path(self._closer.poses)
        except gg.InputError as error:  # the viewer does not answer, or refuses the submap
            self.get_logger().error(str(error))

    def _publish(self, one: Constraint, stamp: object) -> None:
        self.get_logger().info(f"submap {one.query} closes a loop with {one.database}")
        closure = PoseWithCovarianceStamped()
        closure.header.stamp = stamp
        closure.header.frame_id = f"submap_{one.database}"
        closure.pose.covariance = list(one.covariance)
        _fill(closure.pose.pose, one.position, one.quaternion)
        self._closures.publish(closure)

    def _publish_path(self, poses: Mapping[str, gg.Pose]) -> None:
        path = Path()
        path.header.stamp, path.header.frame_id = self.get_clock().now().to_msg(), self._frame
        for pose in poses.values():
            corrected = PoseStamped()
            corrected.header = path.header
            _fill(corrected.pose, pose.translation, pose.quaternion)
            path.poses.append(corrected)
        self._path.publish(path)

    def destroy_node(self) -> None:
        """Remove temporary files too."""
        self._closer.close()
        super().destroy_node()


def _pose(position: object, turn: object) -> gg.Pose:
    return gg.Pose(
        np.array([position.x, position.y, position.z]),
        np.array([turn.x, turn.y, turn.z, turn.w]),
    )


def _fill(pose: object, position: object, turn: object) -> None:
    pose.position.x, pose.position.y, pose.position.z = map(float, position)
    names = ("x", "y", "z", "w")
    for name, value in zip(names, turn, strict=True):
        setattr(pose.orientation, name, float(value))


def main() -> None:
    """Run until interrupted."""
    rclpy.init()
    node = LoopClosingNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
