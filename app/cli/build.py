"""``gpgrad build``: make submaps from scans and poses."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from typing_extensions import Doc

from app.cli.flags import Given, Overwrite
from app.cli.terminal import conclude, progress_bar, warn
from app.ending import reason_of
from gpgrad_core.errors import count
from gpgrad_core.io.records.files import check_apart
from gpgrad_core.recordings.build import build_dataset
from gpgrad_core.recordings.params import BuildParams, parse_condition
from gpgrad_core.recordings.recording import RecordingSources


@dataclass(frozen=True)
class Build:
    """Arguments of ``gpgrad build``."""

    scans: Annotated[
        tyro.conf.Positional[Path],
        Doc(
            "Folder of clouds or of image pairs with a file of poses, or a ROS 1 or ROS 2 bag of "
            "clouds, depth images or image pairs."
        ),
        tyro.conf.arg(metavar="SCANS"),
    ]
    out: Annotated[
        Path,
        Doc("Dataset folder to make. It must not exist yet, or must be empty."),
        tyro.conf.arg(metavar="FOLDER"),
    ]
    poses: Annotated[
        Path | None,
        Doc("File of poses, in TUM's or KITTI's format."),
        tyro.conf.arg(
            metavar="FILE",
            help_behavior_hint="(default: poses.txt beside the scans, or a bag's topic)",
        ),
    ] = None
    truth: Annotated[
        Path | None,
        Doc(
            "File of true poses, for evaluations; or of true positions: rows of time, x, y and z, "
            "or a .pos of RTKLIB."
        ),
        tyro.conf.arg(
            metavar="FILE", help_behavior_hint="(default: poses_gt.txt beside the scans, if any)"
        ),
    ] = None
    times: Annotated[
        Path | None,
        Doc("File of the scans' times [s], one in each row."),
        tyro.conf.arg(
            metavar="FILE",
            help_behavior_hint="(default: times.txt beside the scans, or else the scans' names)",
        ),
    ] = None
    mount: Annotated[
        Path | None,
        Doc(
            "File with the sensor's pose on the body whose poses are given: tx ty tz qx qy qz qw, "
            "or KITTI's calib.txt."
        ),
        tyro.conf.arg(
            metavar="FILE",
            help_behavior_hint=(
                "(default: mount.txt beside the scans, a bag's transforms, or else the body itself)"
            ),
        ),
    ] = None
    cloud_topic: Annotated[
        str | None,
        Doc(
            "Topic of a bag's clouds, depth images, or left images of a pair. It must be named if "
            "there are several."
        ),
        tyro.conf.arg(metavar="TOPIC", help_behavior_hint="(default: the only one)"),
    ] = None
    right_topic: Annotated[
        str | None,
        Doc("Topic of the right images of a pair. The topic of the left ones must be named too."),
        tyro.conf.arg(
            metavar="TOPIC", help_behavior_hint="(default: named like the left one, with right)"
        ),
    ] = None
    calibration: Annotated[
        tuple[Path, ...],
        Doc(
            "File with the calibration of a bag's camera, or one for the left and one for the "
            "right camera: a camera_info of ROS, or EuRoC's sensor.yaml."
        ),
        tyro.conf.arg(
            metavar="FILE [FILE]", help_behavior_hint="(default: CameraInfo beside the images)"
        ),
    ] = ()
    pose_topic: Annotated[
        str | None,
        Doc("Topic of a bag's poses. It must be named if there are several."),
        tyro.conf.arg(
            metavar="TOPIC", help_behavior_hint="(default: the only one, or else the transforms)"
        ),
    ] = None
    gnss_topic: Annotated[
        str | None,
        Doc("Topic of a bag's satellite positions (NavSatFix), which are kept as the truth."),
        tyro.conf.arg(metavar="TOPIC", help_behavior_hint="(default: the only one, if any)"),
    ] = None
    world_frame: Annotated[
        str | None,
        Doc("Frame to build in if the poses are transforms."),
        tyro.conf.arg(metavar="FRAME", help_behavior_hint="(default: the root of their tree)"),
    ] = None
    odometry: Annotated[
        Literal["kiss-icp"] | None,
        Doc(
            "What makes the poses of a LiDAR's scans that have none: kiss-icp, from the extra "
            "odometry."
        ),
        tyro.conf.arg(help_behavior_hint="(default: poses are read)"),
    ] = None
    keep: Annotated[
        tuple[str, ...],
        Doc(
            "Keep only points that meet these conditions on any of their numbers, such as "
            "intensity>3. Quote them, because > means something to a shell."
        ),
        tyro.conf.arg(
            metavar="CONDITION [CONDITION ...]", help_behavior_hint="(default: keep all)"
        ),
    ] = ()
    restart: Annotated[
        bool, Doc("Delete what a stopped build has left, instead of resuming it.")
    ] = False
    overwrite: Overwrite = False
    build: Annotated[Given[BuildParams], tyro.conf.arg(name="")] = Given(BuildParams)

    def run(self) -> None:
        sources = RecordingSources(
            poses=self.poses,
            truth=self.truth,
            times=self.times,
            mount=self.mount,
            cloud_topic=self.cloud_topic,
            right_topic=self.right_topic,
            calibration=self.calibration,
            pose_topic=self.pose_topic,
            gnss_topic=self.gnss_topic,
            world_frame=self.world_frame,
            odometry=self.odometry,
            keep=tuple(parse_condition(condition) for condition in self.keep),
        )
        named = (self.poses, self.truth, self.times, self.mount, *self.calibration)
        check_apart([self.out], [self.scans, *named])
        try:
            with progress_bar("build") as progress:
                report = build_dataset(
                    self.scans,
                    self.out,
                    self.build.over(BuildParams()),
                    sources=sources,
                    restart=self.restart,
                    overwrite=self.overwrite,
                    progress=progress,
                )
        except KeyboardInterrupt as stopped:
            stopped.args = (f"{reason_of(stopped)}; run the same command to resume",)
            raise
        warn(*report.notes)
        failed = {} if self.odometry is None else {"odometry_failed": report.num_failed}
        resumed = f", {report.num_resumed} of them resumed" if report.num_resumed else ""
        conclude(
            f"{count(report.num_submaps, 'submap')} of {count(report.num_scans, 'scan')}"
            f"{resumed}: {self.out}",
            output=self.out,
            submaps=report.num_submaps,
            scans=report.num_scans,
            resumed=report.num_resumed,
            **failed,
        )
