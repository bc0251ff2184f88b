"""A ROS 1 or ROS 2 bag -> a recording."""

import contextlib
import itertools
from collections import defaultdict
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.georeference import check_place
from gpgrad_core.io.poses import make_pose
from gpgrad_core.recordings.bag_reader import BagReader, inner_files, other_files, read_bag
from gpgrad_core.recordings.params import BuildParams, PointFilter
from gpgrad_core.recordings.pose_files import (
    PoseFile,
    positions_of,
    read_mount,
    read_timed_poses,
    read_truth_file,
)
from gpgrad_core.recordings.recording import (
    NUM_SAMPLED,
    FoundPoses,
    FoundScans,
    ReadScans,
    Recording,
    RecordingSources,
    Scan,
    assemble,
    pair_stamps,
    time_span,
)
from gpgrad_core.recordings.sensors import SENSORS, STEREO_PAIR, Bag, Decode, Message, Sensor
from gpgrad_core.recordings.trajectory import FrameTree, Located, Poses, Trajectory
from gpgrad_core.types import MAX_COORDINATE

ODOMETRY = "nav_msgs/msg/Odometry"
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSES = (ODOMETRY, WITH_COVARIANCE, "geometry_msgs/msg/PoseStamped")
GNSS = ("sensor_msgs/msg/NavSatFix",)
IN_WORLD = "if the points are in the world already: --points-frame world"
BODY = "the body (child_frame_id)"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True, eq=False)
class FrameRows:
    """Collects transforms while a bag is read, all by the names of frames."""

    parents: dict[str, str] = field(default_factory=dict[str, str])
    # rows of time [s], offset [m] and quaternion
    rows: dict[str, list[list[float]]] = field(default_factory=lambda: defaultdict(list))
    disputed: dict[str, str] = field(default_factory=dict[str, str])  # see `FrameTree`
    static: set[str] = field(default_factory=set[str])  # frames whose transforms do not change

    def add(self, message: Message, *, static: bool, where: str) -> None:
        for transform in message.transforms:
            frames = transform.header.frame_id, transform.child_frame_id
            parent, child = map(frame_name, frames)
            first = self.parents.setdefault(child, parent)
            if first != parent:
                error = (
                    f"{where}: the frame {child!r}, over which the way from the poses to the "
                    f"clouds leads, has two parents, {first!r} and {parent!r}; name what does "
                    "without: --mount FILE, --pose-topic or --world-frame"
                )
                self.disputed.setdefault(child, error)
                continue
            if static:
                self.static.add(child)
                self.rows[child] = []  # only the latest counts
            move, turn = transform.transform.translation, transform.transform.rotation
            stamp = seconds(transform.header)
            values = [float(v) for v in (move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)]
            make_pose(values, f"{where}, {parent} > {child} at {stamp:.3f} s")
            self.rows[child].append([stamp, *values])

    def tree(self) -> FrameTree:
        edges: dict[str, Trajectory] = {}
        for child, rows in self.rows.items():
            fixed = child in self.static
            edges[child] = replace(_trajectory_of(rows, in_order=not fixed), fixed=fixed)
        return FrameTree(dict(self.parents), edges, self.disputed)


def _trajectory_of(
    rows: list[list[float]], covariance: Array | None = None, *, in_order: bool = True
) -> Trajectory:
    """Make a trajectory of rows of time [s], offset [m] and quaternion."""
    table = np.array(rows, np.float64)
    poses = Poses(table[:, 1:4], Rotation.from_quat(table[:, 4:]))
    make = Trajectory.in_order if in_order else Trajectory
    return make(table[:, 0], poses, covariance)


def frame_name(frame: str) -> str:
    """Remove the slash that ROS 1 may put before a frame's name."""
    return frame.lstrip("/")


def seconds(header: Message) -> float:
    """Time of a message [s]."""
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


def open_bag(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a ``.bag``, ``.mcap`` or ``.db3`` file, a folder of ROS 2, or one of such files.

    The poses are messages of `POSES`, or else transforms from the root of their tree. Satellite
    positions become the truth unless another is named; the antenna stands for the body.
    """
    keep = PointFilter(sources.keep)
    with read_bag(path) as reader:
        bag = _bag(path, reader, sources, params, keep)
        sensor, topics = _choose_sensor(reader, bag)
        pose_topic = None
        unused = ()
        if sources.odometry is not None:
            unused = tuple(
                f"{topic}: its poses are not used, for {sources.odometry} makes them"
                for topic in _topics(reader, POSES)
            )
        elif sources.poses is None and sources.pose_topic not in _topics(reader, TRANSFORMS):
            candidates = _topics(reader, POSES)
            if candidates or sources.pose_topic or not _topics(reader, TRANSFORMS):
                pose_topic = _choose(
                    reader, POSES, sources.pose_topic, "poses", "--pose-topic", path
                )
        gnss_topic, gnss_notes = _gnss_topic(reader, sources, path)
        contents = _gather(reader, topics, pose_topic, gnss_topic, path)
        parts, pair_notes = _put_together(contents, topics, path)
        stamps = np.array(contents.stamps[topics[0]])[parts[:, 0]]
        tree = contents.frames.tree()

        def between(target: str, source: str) -> Poses | None:
            found = tree.between(frame_name(target), frame_name(source), stamps[:1], params)
            return None if found is None or not found.valid.all() else found.poses

        decode = sensor.open(replace(bag, between=between), topics)
    read = _reader(path, topics, contents.logged, parts, decode, sensor.batch)
    sample = read if sensor.what == "clouds" else None
    placing = _Placing(path, contents, tree, stamps, sources, params, sample)
    body, span, notes = placing.body()
    notes += (*pair_notes, *gnss_notes, *unused)
    if others := other_files(path):
        notes += (f"{', '.join(others)}: not read, for a bag is of one kind of file",)
    if contents.unstamped:
        number = contents.unstamped
        have = "message has" if number == 1 else "messages have"
        notes += (f"{number:,} {have} no time: the time of recording is used",)
    if contents.uncertain:
        notes += (
            f"{contents.uncertain:,} of {len(contents.rows):,} poses have a covariance that is not "
            "finite or below 0: it is taken as unknown",
        )
    mount, mount_notes = placing.mount(required=bool(body.valid.any()))
    notes += mount_notes
    body = replace(body, valid=body.valid & mount.valid)
    moved = placing.moved()
    if moved is not None:
        read, body = _moved(read, moved.poses), replace(body, valid=body.valid & moved.valid)
        frames = f"{contents.frame!r} to {contents.pose_frame!r}, the frame of the poses"
        notes += (f"the points are moved from {frames}, by the transforms between the two",)
    truth, truth_name, later_notes = contents.truth(), f"{path}, {gnss_topic}", ()
    if sources.truth is not None:
        truth, truth_name = read_truth_file(sources.truth), str(sources.truth)
    elif truth is not None and body.valid.any():
        at_scans = truth.trajectory.at(stamps[body.valid], params)
        if not at_scans.valid.any():
            ignored = f"{truth_name}: was ignored, for it has no position at the time of a scan"
            truth, later_notes = None, (ignored,)
    return assemble(
        path,
        sources,
        params,
        FoundScans(
            labels=[f"{path.name}, {topics[0]}, message {k}" for k in parts[:, 0]],
            read=read,
            stamps=stamps,
            mount=mount.poses,
            keep=keep,
            advice=sensor.advice,
            in_world=placing.in_world,
        ),
        FoundPoses(body, span, truth=truth, truth_name=truth_name, notes=later_notes),
        texts=[
            *inner_files(path),
            *(sources.poses, sources.truth, sources.mount),
            *sources.calibration,
        ],
        notes=notes,
        name=path.resolve().stem,
    )


def _bag(
    path: Path, reader: BagReader, sources: RecordingSources, params: BuildParams, keep: PointFilter
) -> Bag:
    """Let sensors look into a bag; its transforms are not known yet."""
    first: dict[str, Message | None] = {}

    def peek(topic: str) -> Message | None:
        if topic not in first:
            connections = [c for c in reader.connections if c.topic == topic]
            message = next(iter(reader.messages(connections)), None) if connections else None
            first[topic] = (
                None if message is None else reader.deserialize(message[2], message[0].msgtype)
            )
        return first[topic]

    kinds = {name: str(info.msgtype) for name, info in reader.topics.items()}
    return Bag(path, kinds, peek, lambda _target, _source: None, sources, params, keep)


def _choose_sensor(reader: BagReader, bag: Bag) -> tuple[Sensor, tuple[str, ...]]:
    topic, right = bag.sources.cloud_topic, bag.sources.right_topic
    if right is not None and topic is None:
        raise InputError(f"--right-topic {right}: name the left images too: --cloud-topic TOPIC")
    every: list[str] = []
    for sensor in SENSORS if right is None else (STEREO_PAIR,):
        chosen = sensor.find(bag)
        listed = ", ".join(f"{t[0]} ({reader.topics[t[0]].msgcount:,})" for t in chosen)
        every += [listed] if listed else []
        if topic is not None:
            chosen = [topics for topics in chosen if topics[0] == topic]
        if len(chosen) == 1:
            return sensor, chosen[0]
        if len(chosen) > 1:
            raise InputError(
                f"{bag.path}: has {len(chosen)} topics of {sensor.what}, {listed}: choose one with "
                "--cloud-topic"
            )
    if topic is not None:
        raise InputError(
            f"{bag.path}: --cloud-topic {topic}: is not a topic of clouds, depth images or left "
            f"images of a pair there; it has {', '.join(every) or 'none'}"
        )
    names = sorted({kind.split("/")[-1] for sensor in SENSORS for kind in sensor.messages})
    raise InputError(
        f"{bag.path}: has no topic of clouds, depth images or image pairs ({', '.join(names)})"
    )


def _put_together(
    contents: "_Contents", topics: tuple[str, ...], path: Path
) -> tuple[Int[NDArray[np.intp], "n topics"], tuple[str, ...]]:
    """Find the messages that make each scan, by their numbers, and note which have no partner."""
    for topic in topics:
        if topic not in contents.stamps:
            raise InputError(f"{path}: its topic {topic} has no messages")
    first = np.array(contents.stamps[topics[0]])
    numbers = np.arange(len(first))
    if len(topics) == 1:
        return numbers[:, None], ()
    return pair_stamps(first, np.array(contents.stamps[topics[1]]), str(path), topics)


@dataclass(eq=False)
class _Contents:
    """What the first pass over a bag reads: everything but the points."""

    topic: str  # of the clouds, or of the first image of each scan
    # frame of the messages of each topic, and by `BODY` that of which the poses are
    named: dict[str, str] = field(default_factory=dict[str, str])
    # times of the messages of each of the sensor's topics [s], and when they were recorded [ns]
    stamps: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    logged: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    pose_topic: str | None = None
    rows: list[list[float]] = field(default_factory=list[list[float]])
    covariances: list[Array] = field(default_factory=list[Array])
    uncertain: int = 0  # poses whose covariance is none
    frames: FrameRows = field(default_factory=FrameRows)
    unstamped: int = 0  # messages without a time of measurement
    place_stamps: list[float] = field(default_factory=list[float])  # of satellite positions [s]
    places: list[list[float]] = field(default_factory=list[list[float]])

    @property
    def frame(self) -> str:
        return self.named.get(self.topic, "")

    @property
    def pose_frame(self) -> str:
        return self.named.get(f"{self.pose_topic}", "")

    @property
    def body_frame(self) -> str:
        """The frame whose poses they are, if the messages say."""
        return self.named.get(BODY, "")

    def name(self, of: str, frame: str, where: str) -> None:
        """Check the name of a frame; InputError if earlier messages have another one."""
        frame, before = frame_name(frame), self.named.setdefault(of, frame_name(frame))
        if frame != before:
            raise InputError(
                f"{where}: the frame of {of} changes from {before!r} to {frame!r}; cut the bag "
                "there, or put the two on a topic each"
            )

    def truth(self) -> PoseFile | None:
        """Satellite positions as a truth; None if there are none."""
        stamps, places = np.array(self.place_stamps), np.array(self.places)
        return positions_of(stamps, places) if self.places else None


def _gnss_topic(
    reader: BagReader, sources: RecordingSources, path: Path
) -> tuple[str | None, tuple[str, ...]]:
    """Choose the topic of satellite positions, if they are to be the truth; also give a note."""
    if sources.truth is not None:
        return None, ()
    topics = _topics(reader, GNSS)
    if sources.gnss_topic is None and len(topics) != 1:
        named = ", ".join(topics)
        note = f"satellite positions of {named} were ignored; name one of them: --gnss-topic"
        return None, (note,) if topics else ()
    chosen = _choose(reader, GNSS, sources.gnss_topic, "positions", "--gnss-topic", path)
    return chosen, (f"{chosen}: its satellite positions are kept as the truth",)


def _gather(
    reader: BagReader,
    topics: tuple[str, ...],
    pose_topic: str | None,
    gnss_topic: str | None,
    path: Path,
) -> _Contents:
    contents = _Contents(topics[0], pose_topic=pose_topic)
    transforms = _topics(reader, TRANSFORMS)
    wanted_topics = {*topics, pose_topic, gnss_topic, *transforms}
    connections = [c for c in reader.connections if c.topic in wanted_topics]
    for connection, logged, raw in reader.messages(connections):
        message, topic = reader.deserialize(raw, connection.msgtype), str(connection.topic)
        where = f"{path}, {topic}"
        if topic in (*topics, pose_topic):
            stamp = _stamp(contents, message, logged)
            at = f"{where}, at {stamp:.3f} s"
            contents.name(topic, message.header.frame_id, at)
            if topic == pose_topic:
                _add_pose(contents, message, connection.msgtype, stamp, at)
            else:
                contents.stamps[topic].append(stamp)
                contents.logged[topic].append(int(logged))
        elif topic == gnss_topic:
            _add_place(contents, message, logged, where)
        else:
            static = topic.endswith("tf_static")
            contents.frames.add(message, static=static, where=where)
    return contents


def _stamp(contents: _Contents, message: Message, logged: int) -> float:
    stamp = seconds(message.header)
    if stamp > 0:
        return stamp
    contents.unstamped += 1
    return 1e-9 * logged


def _add_place(contents: _Contents, message: Message, logged: int, where: str) -> None:
    """Read a NavSatFix; one without a fix has no position (its status is below 0)."""
    place = [float(message.latitude), float(message.longitude), float(message.altitude)]
    if int(message.status.status) < 0 or not np.isfinite(place).all():
        return
    check_place(place, where)
    contents.place_stamps.append(seconds(message.header) or 1e-9 * logged)
    contents.places.append(place)


def _add_pose(contents: _Contents, message: Message, kind: str, stamp: float, where: str) -> None:
    pose = message.pose.pose if kind in (ODOMETRY, WITH_COVARIANCE) else message.pose
    position, turn = pose.position, pose.orientation
    values = [position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w]
    make_pose([float(value) for value in values], where)
    contents.rows.append([stamp, *values])
    if kind == ODOMETRY:
        contents.name(BODY, message.child_frame_id, where)
    if kind in (ODOMETRY, WITH_COVARIANCE):
        covariance = np.asarray(message.pose.covariance, np.float64).reshape(6, 6)[:3, :3].copy()
        # Drivers that do not know it give -1, NaN, or the largest numbers there are.
        if not (covariance.diagonal().min() >= 0 and covariance.max() <= MAX_COORDINATE**2):
            covariance[:] = np.nan
            contents.uncertain += 1
        contents.covariances.append(covariance)


@dataclass(frozen=True, eq=False)
class _Placing:
    """Finds where the body and the sensor were at each scan of a bag."""

    path: Path
    contents: _Contents
    tree: FrameTree
    stamps: Float[Array, "n"]  # of the scans [s]
    sources: RecordingSources
    params: BuildParams
    sample: ReadScans | None  # reads the scans, if these are clouds

    @cached_property
    def in_world(self) -> bool:
        """Whether the points of the scans are in the frame of the poses already."""
        if self.params.points_frame != "auto" or self.sample is None:
            return self.params.points_frame == "world"
        contents, frame = self.contents, self.contents.frame
        if self.sources.poses is not None or not frame:
            return False
        if contents.pose_topic is None:
            robot = self._robot()
            body = robot and self.tree.between(frame, robot, self.stamps, self.params)
        elif frame == contents.body_frame or frame != contents.pose_frame:
            return False
        elif contents.body_frame:
            return True
        else:  # the header may be a copy of the cloud's
            body = self._trajectory().at(self.stamps, self.params)
        return bool(body) and self._look_alike(body, self.sample)

    def _robot(self) -> str | None:
        """Find the robot's frame below that of the clouds, if this one does not move itself."""
        frame = self.contents.frame
        world = frame_name(self.sources.world_frame or self.tree.root(frame))
        robot, still = self.tree.mover(frame), world in (frame, self.tree.carrier(frame))
        sure = self.params.points_frame == "world" and robot == self.tree.mover(world)
        return robot if still or sure else None

    def moved(self) -> Located | None:
        """Find how points in the world come into the frame of the poses, if given in another."""
        world, frame = self.contents.pose_frame, self.contents.frame
        robot = self.contents.body_frame or self.tree.mover(world)
        if not (self.in_world and world and frame) or frame == world:
            return None
        if robot and self.tree.is_below(frame, self.tree.carrier(robot)):
            return None
        return self.tree.between(world, frame, self.stamps, self.params)

    def _look_alike(self, body: Located, read: ReadScans) -> bool:
        """Whether scans look more alike from the body if their points are in the world."""
        posed = np.flatnonzero(body.valid)
        middles: dict[int, Array] = {}
        for k in posed[:: len(posed) // NUM_SAMPLED + 1].tolist():
            (scan,) = read([k])
            finite = scan.points[np.isfinite(scan.points).all(axis=1)]
            if len(finite):
                middles[k] = np.median(finite, axis=0).astype(np.float64)
        if not middles:
            return False
        centres = np.array([*middles.values()])
        in_body = body.poses[np.array([*middles])].inverse().apply(centres)
        return bool(in_body.var(axis=0).sum() < centres.var(axis=0).sum())

    def body(self) -> tuple[Located, str, tuple[str, ...]]:
        """Find the body's pose at each scan; also give the poses' time span in words, and notes."""
        if self.sources.odometry is not None:
            return Located.all_valid(Poses.identity(len(self.stamps))), "", ()
        if self.sources.poses is None and self.contents.pose_topic is None:
            return self._body_by_transforms()
        trajectory = self._trajectory()
        span = f"from {time_span(trajectory.stamps)}"
        return trajectory.at(self.stamps, self.params), span, ()

    def _trajectory(self) -> Trajectory:
        if self.sources.poses is not None:
            return read_timed_poses(self.sources.poses)
        if not self.contents.rows:
            raise InputError(f"{self.path}: its topic {self.contents.pose_topic} has no messages")
        covariances = np.array(self.contents.covariances)
        # In ROS, a covariance of zeros means that it is not known.
        has_covariance = bool(np.nan_to_num(covariances).any())
        return _trajectory_of(self.contents.rows, covariances if has_covariance else None)

    def _check_times(self, target: str, source: str, *, required: bool, advice: str = "") -> None:
        """Refuse a transform that no scan has, if it is required or others have theirs."""
        edges = self.tree.edges
        way = list(itertools.chain(*(self.tree.ways(target, source) or ())))
        met = [name for name in way if edges[name].at(self.stamps, self.params).valid.any()]
        missing = [name for name in way if name not in met]
        if missing and (required or not all(edges[name].fixed for name in met)):
            name = missing[0]
            raise InputError(
                f"{self.path}: the transform {self.tree.parents[name]} > {name} is given from "
                f"{time_span(edges[name].stamps)}, which is not within "
                f"{self.params.max_time_difference:g} s of any scan: they are from "
                f"{time_span(self.stamps)}; publish a transform that does not change on "
                f"/tf_static{advice}"
            )

    def _body_by_transforms(self) -> tuple[Located, str, tuple[str, ...]]:
        tree, frame = self.tree, self.contents.frame
        world = frame_name(self.sources.world_frame or tree.root(frame))
        if self.in_world and (robot := self._robot()) is not None:
            world, frame = frame, robot
        located = tree.between(world, frame, self.stamps, self.params)
        if located is None or world == frame:
            parents = tree.parents.items()
            listed = ", ".join(f"{parent} > {child}" for child, parent in parents) or "none"
            raise InputError(
                f"{self.path}: its transforms do not join the clouds' frame {frame!r} to "
                f"{world!r}; they have {listed}"
            )
        self._check_times(world, frame, required=False)
        moving = [edge.stamps for edge in tree.edges.values() if not edge.fixed]
        span = f"from {time_span(np.concatenate(moving))}" if moving else "fixed"
        return located, span, (f"poses are the transforms from {world} to {frame}",)

    def mount(self, *, required: bool) -> tuple[Located, tuple[str, ...]]:
        """Find the sensor's pose on the body at each scan, and note what was assumed."""
        body, frame = self.contents.body_frame, self.contents.frame
        notes = (
            f"the clouds are in {frame!r}, the frame of the poses: their points are taken as in "
            "the world; if they are in the sensor's frame, --points-frame sensor",
        ) * (self.in_world and self.params.points_frame == "auto")
        if self.sources.mount is not None:
            return self._fixed(read_mount(self.sources.mount).pose), notes
        if self.sources.odometry is not None:
            body = self.tree.carrier(frame)
        itself = self._fixed(Poses.identity())
        if self.in_world and self.tree.carrier(body) != self.tree.carrier(frame):
            return itself, notes
        if not body:
            if self.sources.poses is None and self.contents.pose_topic is None:
                return itself, ()
            return itself, (
                f"the poses are used as those of the clouds' frame {frame!r}; if they are of "
                f"another frame, say where the sensor sits on it: --mount FILE; {IN_WORLD}",
            )
        between = self.tree.between(body, frame, self.stamps, self.params)
        if between is None:
            raise InputError(
                f"{self.path}: no transforms join {body!r}, the frame of the poses, to the clouds' "
                f"frame {frame!r}; say where the sensor sits: --mount FILE with "
                f"tx ty tz qx qy qz qw; {IN_WORLD}"
            )
        if required:
            advice = ", or say where the sensor sits: --mount FILE"
            self._check_times(body, frame, required=True, advice=advice)
        return between, ()

    def _fixed(self, pose: Poses) -> Located:
        return Located.all_valid(pose.repeated(len(self.stamps)))


def _reader(
    path: Path,
    topics: tuple[str, ...],
    logged: dict[str, list[int]],
    parts: Int[NDArray[np.intp], "n topics"],
    decode: Decode,
    batch: int,
) -> ReadScans:
    """Make the reader of scans; each row of `parts` has the numbers of the messages of a scan."""
    times = {topic: np.array(logged[topic]) for topic in topics}
    in_order = all(bool(np.all(t[1:] >= t[:-1])) for t in times.values())

    def read(scans: Sequence[int]) -> Iterator[Scan]:
        topics_of_scans = parts[scans]
        numbers = iter(topics_of_scans[:, 0])
        with contextlib.closing(_messages(topics_of_scans)) as whole:
            while group := list(itertools.islice(whole, batch)):
                chosen = itertools.islice(numbers, len(group))
                yield from decode(group, [f"{path}, {topics[0]}, message {k}" for k in chosen])

    def _messages(
        topics_of_scans: Int[NDArray[np.intp], "n topics"],
    ) -> Generator[tuple[Message, ...]]:
        """Yield the messages of each scan; only those that wait for a partner are in memory."""
        if not len(topics_of_scans):
            return
        # If the bag is in order, the messages before the first wanted one are skipped unread.
        earliest = (times[t][topics_of_scans[:, c].min()] for c, t in enumerate(topics))
        since = int(min(earliest)) if in_order else None
        number = {t: 0 if since is None else int(np.searchsorted(times[t], since)) for t in topics}
        keys = [tuple(zip(topics, map(int, row), strict=True)) for row in topics_of_scans]
        left = {key for scan in keys for key in scan}
        pending: dict[tuple[str, int], Message] = {}
        with read_bag(path) as reader:
            connections = [c for c in reader.connections if c.topic in topics]
            messages = reader.messages(connections, start=since)
            for scan in keys:
                while not all(key in pending for key in scan):
                    following = next(messages, None)
                    if following is None:
                        raise InputError(f"{path}: has changed while it was read")
                    connection, _, raw = following
                    key = connection.topic, number[connection.topic]
                    number[connection.topic] += 1
                    if key in left:
                        pending[key] = reader.deserialize(raw, connection.msgtype)
                yield tuple(pending[key] for key in scan)
                for key in scan:
                    del pending[key]

    return read


def _moved(read: ReadScans, poses: Poses) -> ReadScans:
    def read_moved(scans: Sequence[int]) -> Iterator[Scan]:
        for k, scan in zip(scans, read(scans), strict=True):
            yield replace(scan, points=poses[k : k + 1].apply(scan.points))

    return read_moved


def _topics(reader: BagReader, kinds: Sequence[str]) -> dict[str, int]:
    """Find the topics of some message types, with the number of their messages."""
    topics = {name: info for name, info in reader.topics.items() if info.msgtype in kinds}
    return {name: int(info.msgcount) for name, info in topics.items()}


def _choose(
    reader: BagReader, kinds: Sequence[str], requested: str | None, what: str, flag: str, path: Path
) -> str:
    topics = _topics(reader, kinds)
    listed = ", ".join(f"{name} ({count:,})" for name, count in sorted(topics.items()))
    if requested is not None:
        if requested not in topics:
            raise InputError(
                f"{path}: {flag} {requested}: is not a topic of {what} there; it has "
                f"{listed or 'none'}"
            )
        return requested
    if len(topics) != 1:
        names = ", ".join(kind.split("/")[-1] for kind in kinds)
        has = f"has {len(topics)} topics of {what}, {listed}: choose one with {flag}"
        raise InputError(f"{path}: {has if topics else f'has no topic of {what} ({names})'}")
    return next(iter(topics))
