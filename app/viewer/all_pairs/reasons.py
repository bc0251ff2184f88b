"""Why a pair was looked at: the shortlist of its query."""

from html import escape

from app.viewer.widgets.html import FAINT, box
from gpgrad_core.shortlist import Candidate

HEADINGS = ("", "submap", "votes", "similarity")


def shortlist_html(
    query: str, database: str, shortlist: tuple[Candidate, ...], num_earlier: int
) -> str:
    """Write the shortlist of a query as a table that opens on a click.

    Args:
        query: Id of the query.
        database: Id of the database submap that is shown.
        shortlist: The earlier submaps that the query was compared with, the best first; empty if
            it was compared with all of them.
        num_earlier: Number of the earlier submaps.
    """
    if not shortlist:
        return ""
    rank = next((k for k, one in enumerate(shortlist, start=1) if one.id == database), None)
    found = (
        f"{database} is number {rank} among"
        if rank is not None
        else f"{database} is not among them, so this pair was not compared. They are"
    )
    lead = (
        f"{query} was compared with {len(shortlist)} of {num_earlier:,} earlier submaps. {found} "
        "the candidates whose keypoints fit best: by votes, which are associations that keep "
        "their distances, and by the similarity of all descriptors."
    )
    vectors = any(one.similarity for one in shortlist)  # of few submaps there are none
    look = "padding-left:1em;text-align:right;font-weight:inherit"
    head = "".join(f'<th style="{FAINT};{look}">{heading}</th>' for heading in HEADINGS)
    rows = "".join(
        f'<tr style="{"font-weight:700" if one.id == database else ""}">'
        + "".join(
            f'<td style="{look}">{escape(cell)}</td>'
            for cell in (
                str(k),
                one.id,
                str(one.votes),
                f"{one.similarity:.2f}" if vectors else "—",
            )
        )
        + "</tr>"
        for k, one in enumerate(shortlist, start=1)
    )
    return box(
        "shortlist",
        '<details><summary style="cursor:pointer">Why was this pair looked at?</summary>'
        f'<div style="line-height:1.45;margin:.3em 0">{escape(lead)}</div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums">'
        f'<tr style="font-weight:400">{head}</tr>{rows}</table></details>',
        "font-size:.85em",
    )
