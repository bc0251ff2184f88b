"""How the guide becomes a site: ``poe docs``. Nothing is asked of a network, then or later."""

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
from gpgrad_core.params.fields import get_path, settings_of  # noqa: E402

project = "gpgrad"
author = "the gpgrad authors"
version = release = gpgrad_core.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
root_doc = "index"
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
napoleon_use_ivar = True
napoleon_use_rtype = False


class ParameterTable(Directive):
    """Tables of all parameters of a dataclass, from the same source as sliders and ``--help``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Write a row for each parameter."""
        params = getattr(gpgrad_core, self.arguments[0])
        rows = [".. list-table::", "   :header-rows: 1", "   :widths: 28 14 18 40", ""]
        cells = [("parameter", "default", "range", "meaning")]
        for setting in settings_of(params):
            default = get_path(params(), setting.path)
            bounds = setting.bounds
            if isinstance(setting.kind, tuple):
                allowed = ", ".join(setting.kind)
            elif bounds is not None:
                allowed = f"{bounds.low:,g} to {bounds.high:,g} {bounds.unit}".strip()
            else:
                allowed = "yes or no" if setting.kind is bool else "any whole number"
            shown = "automatic" if default is None else str(default)
            cells.append((f"``{setting.path}``", shown, allowed, setting.doc))
        for row in cells:
            rows += [f"   {'* -' if k == 0 else '  -'} {cell}" for k, cell in enumerate(row)]
        holder = nodes.container()
        self.state.nested_parse(StringList(rows, "parameters"), self.content_offset, holder)
        return holder.children


def visit_math(translator: Any, node: Any) -> None:
    """Write an equation within a line as MathML, which browsers show without a script."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_math_block(translator: Any, node: Any) -> None:
    """Write an equation of its own."""
    translator.body.append(convert(node.astext().strip(), display="block"))
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Add what Sphinx does not bring."""
    app.add_directive("parameters", ParameterTable)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
