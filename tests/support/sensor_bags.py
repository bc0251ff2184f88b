"""Writes bags as rovers record them with depth cameras and Livox scanners."""

import struct
from pathlib import Path

import cv2
import numpy as np

from gpgrad_core.recordings.trajectory import Poses
from tests.support.bags import BagWriter
from tests.support.image_folders import numbers, stamps_of, write_poses
from tests.support.stereo import Filmed, level_drive

FRAME = "camera_depth_optical_frame"


def compressed(depths: np.ndarray, a: float = 0.0, b: float = 0.0) -> bytes:
    """Pack depths as image_transport's compressedDepth does."""
    return struct.pack("<i2f", 0, a, b) + cv2.imencode(".png", depths)[1].tobytes()


def write_realsense(path: Path, filmed: Filmed | None = None, form: str = "16UC1") -> Path:
    """Write the bag of a RealSense on a rover, with its calibration and odometry."""
    filmed = filmed or level_drive()
    topic = "/camera/aligned_depth_to_color/image_raw"
    packed = f"{topic}/compressedDepth"
    with BagWriter(path, ros1=False, storage="mcap") as bag:
        bag.transform(stamps_of(1)[0], "base_link", FRAME, filmed.mount, 0, topic="/tf_static")
        for k, stamp in enumerate(stamps_of(len(filmed.body))):
            bag.odometry("/odom", stamp, filmed.body, k)
            bag.image("/camera/color/image_raw", stamp, FRAME, filmed.pairs[k][0], "mono8")
            info = topic.replace("image_raw", "camera_info")
            bag.camera(info, stamp, FRAME, filmed.size, filmed.projections[0])
            millimetres = filmed.millimetres(k)
            if form == "16UC1":
                bag.image(topic, stamp, FRAME, millimetres, form)
            elif form == "32FC1":
                bag.image(topic, stamp, FRAME, filmed.depths[k].astype(np.float32), form)
            elif form == "packed 16UC1":
                content = compressed(millimetres)
                bag.packed(packed, stamp, FRAME, content, "16UC1; compressedDepth png")
            else:
                inverse = np.nan_to_num(40_000 / filmed.depths[k] + 1)
                content = compressed(np.rint(inverse).astype(np.uint16), 40_000, 1.0)
                bag.packed(packed, stamp, FRAME, content, "32FC1; compressedDepth")
    return path


def write_baseprod(path: Path, filmed: Filmed | None = None) -> Path:
    """Write a bag like BASEPROD's: depths without CameraInfo or odometry.

    Both are in files beside it, with the camera's place: ``depth.yaml``, ``poses.txt`` and
    ``mount.txt``.
    """
    filmed = filmed or level_drive()
    with BagWriter(path, ros1=False, storage="mcap") as bag:
        bag.transform(stamps_of(1)[0], "base_link", FRAME, filmed.mount, 0, topic="/tf_static")
        for k, stamp in enumerate(stamps_of(len(filmed.body))):
            for side, image in zip(("left", "right"), filmed.pairs[k], strict=True):
                bag.image(f"/throttle/nav_cam/{side}/image_raw", stamp, "nav", image, "bayer_gbrg8")
            topic = "/throttle/camera/depth/image_rect_raw"
            bag.image(topic, stamp, FRAME, filmed.millimetres(k), "16UC1")
            x, y, z = filmed.body.translation[k].tolist()
            bag.fix("/gnss", stamp, (42.2 + 9.0e-6 * y, -1.5 + 1.21e-5 * x, 300.0 + z))
    write_poses(path.with_name("poses.txt"), filmed.body)
    mount = np.concatenate([filmed.mount.translation[0], filmed.mount.rotation[0].as_quat()])
    path.with_name("mount.txt").write_text(" ".join(map(str, mount)))
    width, height = filmed.size
    matrix = numbers(filmed.projections[0][:, :3])
    text = f"width: {width}\nheight: {height}\nK: [{matrix}]\n"
    path.with_name("depth.yaml").write_text(text)
    return path


def write_livox(path: Path, clouds: list[np.ndarray], sensor: Poses, package: str) -> Path:
    """Write the bag of a Livox scanner with its own poses; each scan has points of no return."""
    with BagWriter(path, ros1=package == "livox_ros_driver") as bag:
        for k, stamp in enumerate(stamps_of(len(sensor))):
            bag.stamped("/pose", stamp, sensor, k)
            points = np.vstack([np.zeros((2, 3)), clouds[k]])
            bag.livox("/livox/lidar", stamp, "livox_frame", points, package)
    return path
