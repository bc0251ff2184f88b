"""How the guide becomes a site: ``poe docs``. Nothing is asked of a network, then or later."""

import logging
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from latex2mathml.converter import convert
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import gpgrad_core  # noqa: E402 - found only now
from gpgrad_core.detection import (  # noqa: E402
    PipelineParams,
    register_pair,
    resolve_parameters,
)
from gpgrad_core.features import DETECTORS  # noqa: E402
from gpgrad_core.features.extraction import MOST_BYTES  # noqa: E402
from gpgrad_core.io.clouds import CLOUD_FORMATS  # noqa: E402
from gpgrad_core.io.folder import load_dataset  # noqa: E402
from gpgrad_core.mapping.gradient_map import MOST_CELLS  # noqa: E402
from gpgrad_core.params import Field, parameters_of, with_unit  # noqa: E402
from gpgrad_core.run.memo import Memo  # noqa: E402
from gpgrad_core.simulation.demo import demo_path  # noqa: E402

project = "gpgrad"
author = "the gpgrad authors"
version = release = gpgrad_core.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
root_doc = "index"
highlight_language = "none"  # of blocks that name none: listings and files
default_role = "py:obj"  # what docstrings put between single backticks

html_theme = "furo"
html_title = f"gpgrad {release}"
html_static_path = ["_static"]
html_css_files = ["guide.css"]
html_show_copyright = False
html_copy_source = False
html_math_renderer = "mathml"

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
napoleon_use_ivar = True  # one list of what a type holds
napoleon_attr_annotations = False  # the signature has the types
napoleon_use_rtype = False


class Table(Directive):
    """A table whose rows come from the package, so that it is never out of date."""

    def rows(self) -> list[str]:
        """Give the lines of the table."""
        raise NotImplementedError

    def run(self) -> list[nodes.Node]:
        """Write the table."""
        holder = nodes.container()
        self.state.nested_parse(StringList(self.rows(), "table"), self.content_offset, holder)
        return holder.children


class ParameterTable(Table):
    """A table of all parameters of a dataclass, from the same source as sliders and ``--help``."""

    required_arguments = 1

    def rows(self) -> list[str]:
        """Write a row for each parameter."""
        params = getattr(gpgrad_core, self.arguments[0])
        rows = ["| parameter | default | range | meaning |", "|---|---|---|---|"]
        for field in parameters_of(params):
            shown = "automatic" if field.default is None else str(field.default)
            rows.append(f"| `{field.path}` | {shown} | {allowed(field)} | {field.doc} |")
        return rows


class DetectorTable(Table):
    """A table of all detectors of keypoints."""

    def rows(self) -> list[str]:
        """Write a row for each detector."""
        rows = ["| detector | keypoints | searches at most |", "|---|---|---|"]
        for detector in DETECTORS.values():
            cells = min(MOST_BYTES / detector.bytes_a_cell, MOST_CELLS) / 1e6
            seeks = detector.seeks
            image = "the ground" if seeks == "landforms" else "the gradient image"
            rows.append(f"| `{detector.name}` | {seeks} of {image} | {cells:.2g} million cells |")
        return rows


class CloudFormatTable(Table):
    """A table of the formats of clouds, from the readers themselves."""

    def rows(self) -> list[str]:
        """Write a row for each ending."""
        rows = ["| ending | what is read |", "|---|---|"]
        return rows + [f"| `{ending}` | {kind.holds} |" for ending, kind in CLOUD_FORMATS.items()]


def allowed(field: Field) -> str:
    """Say which values a parameter may have."""
    if isinstance(field.kind, tuple):
        return ", ".join(field.kind)
    if field.kind is bool:
        return "yes or no"
    if field.bounds is None:
        return "any whole number"
    low, high = (f"{end:,.10g}" for end in (field.bounds.low, field.bounds.high))
    return with_unit(f"{low} to {high}", field.bounds)


def visit_math(translator: Any, node: Any) -> None:
    """Write an equation within a line as MathML, which browsers show without a script."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_math_block(translator: Any, node: Any) -> None:
    """Write an equation of its own."""
    translator.body.append(convert(node.astext().strip(), display="block"))
    raise nodes.SkipNode


def write_live_page(app: Sphinx, error: Exception | None) -> None:
    """Put a closure of the demo beside the pages, to be turned and moved without a server."""
    if error is not None or app.builder.name != "html":
        return
    from app.viewer.features.demo.pages import write_story  # noqa: PLC0415 - loads slowly
    from app.viewer.features.demo.story import story_of  # noqa: PLC0415
    from app.viewer.session.state import (  # noqa: PLC0415
        open_dataset,
        with_pair,
    )

    logging.getLogger("app").setLevel(logging.WARNING)
    dataset, memo = load_dataset(demo_path()), Memo()
    params = resolve_parameters(dataset.submaps, PipelineParams(), memo)
    state = with_pair(open_dataset(dataset, params), query_id="007", database_id="001")
    result = register_pair(state.query, state.database, params, memo)
    steps, path = story_of(state, result, closes_map=False), Path(app.outdir) / "loop_closure.html"
    write_story(state, result, steps, memo, False, path)


def setup(app: Sphinx) -> None:
    """Add what Sphinx does not bring."""
    app.connect("build-finished", write_live_page)
    app.add_directive("parameters", ParameterTable)
    app.add_directive("detectors", DetectorTable)
    app.add_directive("cloud-formats", CloudFormatTable)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
