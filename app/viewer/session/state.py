"""The session: one immutable snapshot of what is open, what is set and what is shown."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from jaxtyping import Float
from typing_extensions import Doc

from app.viewer.session.layers import LAYERS, ColorMap, Layer, Locked
from app.viewer.session.methods import METHODS, MethodName
from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams, is_resolved, numbers_stay, with_numbers_of
from gpgrad_core.detection.choosing import closest_pair
from gpgrad_core.errors import InputError
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.types import Dataset, PairOfIds, Submap

Layout: TypeAlias = Literal["side by side", "registered", "gradient from above"]
Untrusted: TypeAlias = Literal["hidden", "grey", "shown"]
Compare: TypeAlias = Literal["both", "query", "database", "swipe", "blink"]
Role: TypeAlias = Literal["query", "database"]
Subject: TypeAlias = Literal["pair", "world"]
"""What the scene shows."""

ROLES: tuple[Role, Role] = get_args(Role)
FROM_ABOVE: Layout = "gradient from above"
"""Side by side like two maps, whatever the layer."""
NEEDS_TWO = "A loop closure needs two submaps. Add a cloud, or open another dataset, in Data."
"""Shown where one submap is all there is."""


FIELD_OF_VIEW, PARALLEL = np.deg2rad(45.0), np.deg2rad(1.5)
"""From the lower to the upper edge; the narrow one is so far away that lines run parallel."""


@dataclass(frozen=True)
class Camera:
    """A view of the scene, z up."""

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]
    parallel: bool = False  # whether it looks from afar through a narrow field of view

    @classmethod
    def at(
        cls, position: Float[Array, "3"], look_at: Float[Array, "3"], *, parallel: bool = False
    ) -> "Camera":
        (x, y, z), (u, v, w) = position.tolist(), look_at.tolist()
        return cls((x, y, z), (u, v, w), parallel)

    @property
    def field_of_view(self) -> float:
        return float(PARALLEL if self.parallel else FIELD_OF_VIEW)

    @property
    def with_perspective(self) -> "Camera":
        """The same view from near by, with perspective."""
        if not self.parallel:
            return self
        look_at, nearer = np.array(self.look_at), np.tan(PARALLEL / 2) / np.tan(FIELD_OF_VIEW / 2)
        return Camera.at(look_at - nearer * self.sight, look_at)

    @property
    def looks_down(self) -> bool:
        """Whether it looks straight down from afar, as onto a plan."""
        return self.parallel and bool(-self.sight[2] > 0.99 * self.distance)

    @property
    def sight(self) -> Float[Array, "3"]:
        return np.subtract(self.look_at, self.position)

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.sight))


@dataclass(frozen=True)
class Widget:
    """How a field of options or parameters is offered, where its name and type do not say that."""

    label: str = ""  # of the widget; empty takes the field's name
    # what people call its choices; a choice without another name keeps its own
    names: Mapping[str, str] = field(default_factory=dict[str, str])
    # by the names of other fields, the values that it has a meaning with
    needs: Mapping[str, tuple[object, ...]] = field(default_factory=dict[str, tuple[object, ...]])
    folded: bool = False  # whether it lies in the folded folder of what is rarely needed
    # whether a truth value is an eye, open where something is shown and else closed
    eye: bool = False
    # truth values that it belongs to: it unfolds below while one of them is true
    under: tuple[str, ...] = ()
    offered: bool = True  # whether it has a widget in the panel of its dataclass
    # of the box that stands above a number that may be automatic; without it, such a number has its
    # box in the folded folder
    automatic: str = ""


@dataclass(frozen=True)
class ViewOptions:
    """What is drawn and how; each field is a widget of the tab View, in this order."""

    layout: Annotated[
        Layout,
        Doc(
            "Each submap by itself, or the query laid onto the database as the registration says, "
            "or the gradient of each from above: there the cursor shows the same place in both."
        ),
    ] = "side by side"
    compare: Annotated[
        Compare,
        Doc(
            "How to compare registered submaps: both at once, one alone, the query left and the "
            "database right of a line, or one after the other."
        ),
        Widget(
            names={"query": "query only", "database": "database only"},
            needs={"layout": ("registered",)},
        ),
    ] = "both"
    swipe: Annotated[
        float,
        Bounds(0.0, 1.0, 0.01),
        Doc("Position of the line: the query is left of it, the database right."),
        Widget(needs={"layout": ("registered",), "compare": ("swipe",)}),
    ] = 0.5
    layer: Annotated[
        Layer,
        Doc(
            " ".join(("What the colours show.", *(one.help for one in LAYERS.values() if one.help)))
            + " What compares two submaps is grey where only one of them saw the ground."
        ),
        Widget(
            names={name: one.words for name, one in LAYERS.items()},
            needs={"layout": ("side by side", "registered")},
        ),
    ] = "gradient"
    beyond_noise: Annotated[
        bool,
        Doc(
            "Draws height differences white that noise explains: up to two standard deviations of "
            "both maps. The colours are of what is beyond."
        ),
        Widget(needs={"layer": ("difference",)}),
    ] = False
    surfaces: Annotated[
        bool,
        Doc("Gaussian-process surfaces, inferred from the points."),
        Widget(folded=True, eye=True, needs={"layout": ("side by side", "registered")}),
    ] = True
    color_map: Annotated[
        ColorMap,
        Doc("Colour map of the layer. Automatic chooses one that suits it."),
        Widget("Colours", folded=True, under=("surfaces",)),
    ] = "automatic"
    hillshade: Annotated[
        bool,
        Doc(
            "Lights elevation and gradient from the upper left. Without it the colours are exactly "
            "those of the legend."
        ),
        Widget(folded=True, under=("surfaces",)),
    ] = True
    exaggeration: Annotated[
        float,
        Bounds(1.0, 5.0, 0.5),
        Doc("How many times higher the scene is than the ground; all figures are of the ground."),
        Widget("Exaggerate heights", folded=True),
    ] = 1.0
    untrusted: Annotated[
        Untrusted,
        Doc("What to do with cells that the variance mask rejects."),
        Widget("Masked cells", folded=True, under=("surfaces",)),
    ] = "hidden"
    clouds: Annotated[
        bool,
        Doc("The measured points of the query (blue) and of the database (orange)."),
        Widget(
            "Point clouds",
            folded=True,
            eye=True,
            needs={"layout": ("side by side", "registered")},
        ),
    ] = False
    left_out: Annotated[
        bool,
        Doc(
            "The points that are in no map (red): outliers that no ground explains, and what "
            "stands on the ground, such as bushes and walls. Those far outside are not drawn."
        ),
        Widget("Points left out", folded=True, eye=True),
    ] = False
    point_size: Annotated[
        float,
        Bounds(0.005, 0.2, 0.005, "m"),
        Doc("Size of a point of the point clouds."),
        Widget(folded=True, under=("clouds", "left_out")),
    ] = 0.03
    keypoints: Annotated[
        bool,
        Doc("Inliers: full and green, or yellow if the pair is refused."),
        Widget(folded=True, eye=True),
    ] = True
    other_keypoints: Annotated[
        bool,
        Doc("Outliers are red rings, and keypoints without an association are small."),
        Widget(folded=True, eye=True),
    ] = False
    inlier_lines: Annotated[
        bool,
        Doc("Associations that agree with the registration (green)."),
        Widget(folded=True, eye=True),
    ] = True
    outlier_lines: Annotated[
        bool,
        Doc("Associations that do not agree with it (red, and broken)."),
        Widget(folded=True, eye=True),
    ] = False
    all_lines: Annotated[
        bool,
        Doc(
            "Draws a line for every association. Otherwise at most twenty-four of each kind are "
            "drawn, spread over the ground."
        ),
        Widget(folded=True, under=("inlier_lines", "outlier_lines")),
    ] = False
    raw_frames: Annotated[
        bool,
        Doc(
            "Side by side, shows each submap in its own frame. Otherwise the query is turned and "
            "levelled as the registration says, so that the same place looks the same."
        ),
        Widget(folded=True, needs={"layout": ("side by side",)}),
    ] = False
    frames: Annotated[
        bool, Doc("The box of each submap's points, from above."), Widget(folded=True, eye=True)
    ] = False
    locked: Annotated[
        Locked, Doc("Layer whose colours keep their range."), Widget(offered=False)
    ] = "none"
    low: Annotated[float, Doc("Value at the low end of a locked range."), Widget(offered=False)] = (
        0.0
    )
    high: Annotated[
        float, Doc("Value at the high end of a locked range."), Widget(offered=False)
    ] = 1.0
    picked: Annotated[
        Locked, Doc("Layer of which a range of values is picked out."), Widget(offered=False)
    ] = "none"
    picked_low: Annotated[float, Doc("Lowest of the values."), Widget(offered=False)] = 0.0
    picked_high: Annotated[float, Doc("Highest of the values."), Widget(offered=False)] = 0.0
    dark: Annotated[bool, Doc("Of no effect: each page chooses."), Widget(offered=False)] = False

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def ends(self) -> tuple[float, float] | None:
        """Values at the ends of the layer's colours, if they are locked."""
        is_range = self.locked == self.layer and self.low < self.high
        return (self.low, self.high) if is_range else None

    @property
    def picked_values(self) -> tuple[float, float] | None:
        """Lowest and highest value of the cells that are picked out of the layer, if any are."""
        is_range = self.picked == self.layer and self.picked_low < self.picked_high
        return (self.picked_low, self.picked_high) if is_range else None


@dataclass(frozen=True)
class Probe:
    """A place on a surface whose values are read."""

    role: Role  # whose surface it is
    x: float  # [m], in that submap's frame
    y: float


class Setting(NamedTuple):
    """A method with its parameters, as a person has set them."""

    method: MethodName
    params: PipelineParams


@dataclass(frozen=True)
class Tuning:
    """The parameters of a method while another one runs; see `ViewState`."""

    asked: PipelineParams
    params: PipelineParams
    resolved: bool


@dataclass(frozen=True, eq=False)
class ViewState:
    """All that determines a picture; the functions below make a changed copy."""

    dataset: Dataset
    query_id: str  # submap that is registered
    # submap that it is registered to. It is another one, unless the dataset has no other: then
    # there is no pair, and the one submap is shown alone
    database_id: str
    # of the pipeline, with numbers for what is automatic
    params: PipelineParams = field(
        default_factory=lambda: with_numbers_of(PipelineParams(), PipelineParams())
    )
    # the same as they were requested: what is automatic is None
    asked: PipelineParams = field(default_factory=PipelineParams)
    # whether the numbers of ``params`` are those of ``asked`` on the dataset; else a fit is due,
    # and they stand in for its result
    resolved: bool = False
    method: MethodName = "gradient"  # name of the method that runs with them
    # those of the other methods, which have their own
    others: Mapping[MethodName, Tuning] = field(default_factory=dict[MethodName, Tuning])
    options: ViewOptions = field(default_factory=ViewOptions)  # of the view
    source: str = ""  # path that the dataset was read from; empty if there is none
    match: int = 0  # number of the association that is pointed at, from 1; 0 for none
    probe: Probe | None = None  # the place whose values are read
    # A, the setting that the present one, B, is shown beside; None shows B alone
    reference: Setting | None = None

    def __post_init__(self) -> None:
        check_pair(self.dataset, self.query_id, self.database_id)

    @property
    def setting(self) -> Setting:
        return Setting(self.method, self.asked)

    @property
    def given(self) -> PipelineParams:
        """What the method runs with; None is what it fits to each submap by itself."""
        return self.asked if METHODS[self.method].fits_each else self.params

    @property
    def is_pair(self) -> bool:
        return self.query_id != self.database_id

    @property
    def query(self) -> Submap:
        return self.dataset.submap(self.query_id)

    @property
    def database(self) -> Submap:
        return self.dataset.submap(self.database_id)

    @property
    def names(self) -> str:
        """The pair in short, or the one submap there is."""
        return f"{self.query_id} → {self.database_id}" if self.is_pair else self.query_id

    @property
    def pair(self) -> tuple[Submap, Submap]:
        """The query and the database submap; an InputError if there is one submap alone."""
        if not self.is_pair:
            raise InputError(NEEDS_TWO)
        return self.query, self.database

    @property
    def compared_pair(self) -> PairOfIds:
        """Ids of the pair as it is compared and decided: the later submap is the query."""
        index = self.dataset.index
        query, database = self.query_id, self.database_id
        later = index.get(query, 0) >= index.get(database, 0)
        return (query, database) if later else (database, query)


def check_pair(dataset: Dataset, query_id: str | None, database_id: str | None) -> None:
    """Refuse a pair of one submap twice; the one submap of a dataset may stand alone."""
    if query_id is not None and query_id == database_id and len(dataset.submaps) > 1:
        raise InputError(f"{query_id} beside itself is no pair; name two different submaps")


def open_dataset(
    dataset: Dataset,
    params: PipelineParams,
    options: ViewOptions | None = None,
    source: str = "",
    used: PipelineParams | None = None,
) -> ViewState:
    """Start at the pair most worth looking at; ``used`` are the parameters resolved, if known."""
    state = ViewState(
        dataset, *promising_pair(dataset), options=options or ViewOptions(), source=source
    )
    guess = state.params
    others = {
        name: Tuning(asked, with_numbers_of(asked, guess), resolved=False)
        for name, method in METHODS.items()
        for asked in [method.adapt(params)]
    }
    state = replace(with_params(state, params), others=others)
    return state if used is None else with_fitted(state, used)


def with_pair(
    state: ViewState, *, query_id: str | None = None, database_id: str | None = None
) -> ViewState:
    """Choose the query, the database submap, or both; nothing is pointed at then.

    If the one that is named had the other role, the two change places. An InputError refuses one
    that the dataset does not have, and a pair of one submap.
    """
    if query_id is None:
        query_id = state.database_id if database_id == state.query_id else state.query_id
    elif database_id is None and query_id == state.database_id:
        database_id = state.query_id
    database_id = state.database_id if database_id is None else database_id
    chosen = replace(state, query_id=query_id, database_id=database_id)
    _ = chosen.query, chosen.database
    if same_pair(chosen, state):
        return chosen
    resolved = state.resolved and not METHODS[state.method].fits_each
    return replace(chosen, match=0, probe=None, resolved=resolved)


def with_method(state: ViewState, name: MethodName) -> ViewState:
    """Choose the method; the parameters of the present one stay until it is chosen again."""
    if name == state.method:
        return state
    here = Tuning(state.asked, state.params, state.resolved)
    there = state.others[name]
    return replace(
        state,
        method=name,
        asked=there.asked,
        params=there.params,
        # Another query may be there since.
        resolved=there.resolved and not METHODS[name].fits_each,
        others={**state.others, state.method: here},
        match=0,
    )


def with_params(state: ViewState, params: PipelineParams) -> ViewState:
    """Set parameters as a person gives them; what is automatic keeps its number until a fit."""
    if is_resolved(params):
        return replace(state, params=params, asked=params, resolved=True)
    return replace(
        state,
        params=with_numbers_of(params, state.params),
        asked=params,
        resolved=state.resolved and numbers_stay(state.asked, params),
    )


def with_fitted(state: ViewState, used: PipelineParams) -> ViewState:
    """Set what `resolve_parameters` returned for the requested parameters."""
    return replace(state, params=used, resolved=True)


def was_fitted(before: ViewState, after: ViewState) -> bool:
    """Whether a fit has changed one state into the other, rather than a person."""
    return (
        after.resolved
        and not before.resolved
        and (after.method, after.asked) == (before.method, before.asked)
    )


def registered(options: ViewOptions) -> ViewOptions:
    """Show both submaps, the query aligned with the database."""
    return replace(options, layout="registered", compare="both")


def as_drawn(options: ViewOptions) -> ViewOptions:
    """The options with those that their layout implies."""
    if options.layout != FROM_ABOVE:
        return options
    return replace(options, layer="gradient", surfaces=True, clouds=False)


def same_pair(first: ViewState, second: ViewState) -> bool:
    """Whether two snapshots show the same query and database."""
    return first.dataset is second.dataset and (
        (first.query_id, first.database_id) == (second.query_id, second.database_id)
    )


def same_verdict(first: ViewState, second: ViewState) -> bool:
    """Whether two snapshots need the verdict on the same pair in the same way."""
    return (
        same_pair(first, second) and first.method == second.method and first.given == second.given
    )


def same_search(first: ViewState, second: ViewState) -> bool:
    """Whether two snapshots search the same dataset for loop closures by the same method."""
    return first.dataset is second.dataset and first.method == second.method


def same_surfaces(first: ViewState, second: ViewState) -> bool:
    """Whether two snapshots show the same surfaces alike."""
    return (
        same_pair(first, second)
        and first.method == second.method
        and first.params.map == second.params.map
        and first.params.features.max_std_ratio == second.params.features.max_std_ratio
        and first.options == second.options
    )


def neighbour(dataset: Dataset, submap_id: str, step: int, *, skip: str | None = None) -> str:
    """The submap so many places further by ID, round the end; one may be passed over."""
    ids = [submap.id for submap in dataset.submaps]
    place = ids.index(submap_id)
    for _ in ids:
        place = (place + step) % len(ids)
        if ids[place] != skip:
            return ids[place]
    return submap_id


def promising_pair(dataset: Dataset) -> tuple[str, str]:
    """Choose the first (query, database): a revisit, as far as odometry tells.

    What the dataset prefers comes first. Else, of the submaps that are not neighbours along the
    way, take the two that odometry (or else the truth) has closest together. Without poses, take
    the last and the first.
    """
    ids = [submap.id for submap in dataset.submaps]
    preferred = dataset.preferred.get("query"), dataset.preferred.get("database")
    if preferred[0] in ids and preferred[1] in ids:
        return str(preferred[0]), str(preferred[1])
    return closest_pair(dataset) or (ids[-1], ids[0])
