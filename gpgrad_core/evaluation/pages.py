"""Pages and texts that are made from templates, files beside the code that fills them."""

from pathlib import Path

TEMPLATES = Path(__file__).parent / "templates"


def render(template: Path, **values: object) -> str:
    """Fill a template of Jinja.

    Args:
        template: The file. In one that ends in ``.html`` all values are escaped.
        values: What it names; a name that is missing is an error.
    """
    # Imported here because commands that write no page need not wait for it.
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415

    environment = Environment(
        loader=FileSystemLoader(template.parent),
        autoescape=template.suffix == ".html",
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template.name).render(values)


def cell(text: str) -> str:
    """Write a text as a cell of a Markdown table."""
    return text.replace("|", "/")
