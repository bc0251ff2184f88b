"""What a kind of sensor is: which topics it makes scans of, and how."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from gpgrad_core.recordings.params import BuildParams, Tally
from gpgrad_core.recordings.recording import RecordingSources, Scan
from gpgrad_core.recordings.trajectory import Poses

Message: TypeAlias = Any
"""A message, or a part of one; rosbags makes its types while it runs."""
Decode: TypeAlias = Callable[[Sequence[tuple[Message, ...]], Sequence[str]], Iterator[Scan]]
"""Makes scans of as many tuples of messages, one from each topic; the texts name them in errors."""


@dataclass(frozen=True, eq=False)
class Bag:
    """What a sensor may ask of a bag."""

    path: Path  # the bag
    topics: Mapping[str, str]  # type of the messages of each topic, by its name
    peek: Callable[[str], Message | None]  # gives the first message of a topic; None if it has none
    # gives the fixed ``T_target_source`` of two frames; None if no transforms join them
    between: Callable[[str, str], Poses | None]
    sources: RecordingSources
    params: BuildParams
    tally: Tally = field(default_factory=Tally)

    def of_type(self, kinds: Sequence[str]) -> list[str]:
        """Find the topics of some types, sorted by name."""
        return sorted(topic for topic, kind in self.topics.items() if kind in kinds)


@dataclass(frozen=True)
class Sensor:
    """A kind of sensor."""

    what: str  # what its messages are called in messages to people
    messages: tuple[str, ...]  # the types of messages that it may need
    # finds the topics of each such sensor in a bag; the first one has its frame
    find: Callable[[Bag], list[tuple[str, ...]]]
    # makes the function that decodes the messages of some topics
    open: Callable[[Bag, tuple[str, ...]], Decode]
    # text of the types of messages that rosbags does not know, by their names
    definitions: Mapping[str, str] = field(default_factory=dict[str, str])
    batch: int = 1  # number of scans that are decoded at a time
    advice: str = ""  # what may be wrong if no scan has any points


def each_topic(*kinds: str) -> Callable[[Bag], list[tuple[str, ...]]]:
    """Make the `find` of a sensor that each topic of some types is."""

    def find(bag: Bag) -> list[tuple[str, ...]]:
        return [(topic,) for topic in bag.of_type(kinds)]

    return find
