import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import viser

from app.viewer.features.save import tab as save_module
from app.viewer.features.save.tab import (
    ENDINGS,
    ReportTool,
    lines_below,
    report_html,
    write_dataset_page,
    write_report,
)
from app.viewer.session.decisions import Decisions, decide
from app.viewer.session.state import open_dataset
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import PipelineParams, detect_loop_closures
from gpgrad_core.io.records.closures import Decision
from gpgrad_core.pages.page import ACCEPTED, BARRED
from gpgrad_core.run import silent
from gpgrad_core.run.memo import Memo
from tests.core.pages.walk import PARAMS, read_page, walk
from tests.support.desk import make_desk
from tests.support.page import FakePage
from tests.support.synthetic import make_dataset, make_result
from tests.support.widgets import html_says

STATE = open_dataset(make_dataset(), PipelineParams(), source="/maps/hills")
RESULT = make_result(STATE)
LINK = "http://127.0.0.1:8080/#query=003&database=000"


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(save_module, "register_pair", lambda *_, **__: RESULT)


def test_the_page_has_all_of_it_and_asks_no_server(tmp_path: Path) -> None:
    write_report(STATE, Memo(), LINK, Decision(accepted=True), tmp_path / "report.html", silent)
    page = (tmp_path / "report.html").read_text()
    for words in (
        "hills: query 003, database 000",
        "<b>Accepted by hand</b>, threshold",
        "By the ground alone: Loop closure. Both submaps show the same place. Heights",
        "12 keypoints agree. They share 12 m².",
        "gpgrad detect /maps/hills --out closures.json --pair 003 000",
        "map.length_scale",
        "overlap",
        LINK.replace("&", "&amp;"),
    ):
        assert words in page
    assert set(re.findall(r'(?:src|href)="([a-z]+:)', page)) == {"data:", "http:"}
    assert page.count("http") == 2  # the link, and nothing that a browser would load


@pytest.mark.slow
def test_the_picture_is_opaque_and_twice_as_fine(tmp_path: Path) -> None:
    write_report(STATE, Memo(), LINK, Decision(), tmp_path / "report.png", silent)
    picture = cv2.imread(str(tmp_path / "report.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.shape[1] == 2640
    assert picture.shape[2] == 3 or (picture[..., 3] == 255).all()
    assert np.ptp(picture[:2000]) > 200


def test_what_a_person_wrote_is_text() -> None:
    page = report_html(STATE, RESULT, b"", decision=Decision(note="<script>alert(1)</script>"))
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "Link" not in page


def test_lines_below_a_picture_fit_on_it() -> None:
    below = lines_below(STATE, RESULT, link=LINK + "&x=" + "y" * 500)
    assert max(map(len, below.splitlines())) <= 140
    assert "Command: gpgrad detect" in below


@pytest.mark.slow
def test_a_page_is_asked_for_its_address_and_gets_the_file(server: viser.ViserServer) -> None:
    desk, page = make_desk(server, STATE), FakePage()
    desk.join(ReportTool(desk, Commands(server)))
    for kind in ENDINGS:
        html_says(desk.bridge, "here", page, kind=kind, link=LINK)
        assert desk.wait_idle(60)
    assert set(page.files) == {"report_003_000.html", "report_003_000.png"}
    assert b"query=003" in page.files["report_003_000.html"]
    for data in ({}, {"kind": "EXE", "link": LINK}, {"kind": "HTML", "link": 3.0}):
        html_says(desk.bridge, "here", page, **data)
    html_says(desk.bridge, "here", page, kind="HTML", link="javascript:alert(1)")
    assert desk.wait_idle(60)
    assert b"javascript" not in page.files["report_003_000.html"]
    desk.close()


@pytest.mark.slow
def test_the_page_of_the_dataset_has_verdicts_and_decisions(tmp_path: Path) -> None:
    dataset, _ = walk()
    state = open_dataset(dataset, PARAMS, source="/maps/walk")
    found = detect_loop_closures(dataset, PARAMS)
    refused = next(closure for closure in found.closures if closure.accepted)
    pair = refused.query_id, refused.database_id
    decisions = Decisions(verdicts={pair: False})
    for made, commands in ((Decisions(), 2), (decisions, 1)):
        path = tmp_path / "page.html"
        decided = replace(found, closures=decide(found.closures, made))
        write_dataset_page(Memo(), state, decided, made, path, silent)
        page = path.read_text(encoding="utf-8")
        assert page.count("<pre>") == commands
        assert "gpgrad evaluate /maps/walk --closures closures.json --out page" in page
        states = read_page(page).arrays["state"][0]
        accepted = sum(closure.accepted for closure in found.closures) - (made is decisions)
        assert np.count_nonzero(states & ACCEPTED) == accepted
        assert np.count_nonzero(states & BARRED) >= (made is decisions)
