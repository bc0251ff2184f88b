"""Mutators of what is text: poses, graphs, TOML and JSON."""

import json
import random
from dataclasses import replace
from typing import Any

from tests.long.fuzz.mutation import WORDS, Case, at_random

SOUND_NUMBERS = ("0", "-1")
"""Odd words that may stand where a number stands."""
NOT_NUMBERS = tuple(word for word in WORDS if word not in ("", *SOUND_NUMBERS))
"""Words that may not, in any place where a number stands: positions end at 1e9 m."""


def _file(rows: list[list[str]], what: str, *, damaged: bool = True, separator: str = " ") -> Case:
    content = "\n".join(separator.join(row) for row in rows).encode()
    return Case(content, what, damaged)


def _lines_case(rng: random.Random, rows: list[list[str]], *, whole: bool = True) -> Case:
    """Damage one row of a file of rows of numbers.

    Args:
        rng: Draws.
        rows: The words of the rows.
        whole: Whether a row of another length must be refused.
    """
    what = rng.choice(("word", "word", "short", "long", "bytes", "random", "random"))
    row = rng.choice(rows)
    match what:
        case "word":
            row[rng.randrange(len(row))] = rng.choice(_no_numbers("#"))
        case "short" if whole:
            del row[rng.randrange(len(row))]
        case "long" if whole:
            row.insert(rng.randrange(len(row) + 1), "0.5")
        case "bytes":
            text = _file(rows, what).content
            place = rng.randrange(len(text))
            odd = rng.choice((b"\0", b"\xff", b"\x80\x80", b"\xed\xa0\x80"))
            return Case(text[:place] + odd + text[place:], what, damaged=True)
        case _:
            return at_random(rng, _file(rows, what).content)
    return _file(rows, what)


def _no_numbers(marks: str) -> list[str]:
    """Words that are no numbers, without those that hold a mark."""
    return [word for word in NOT_NUMBERS if not any(mark in word for mark in marks)]


def _columns_case(
    rng: random.Random,
    rows: list[list[str]],
    columns: tuple[int, ...],
    *,
    places: tuple[int, ...] = (),
    shortest: int = 0,
    marks: str = "#",
    separator: str = " ",
) -> Case:
    """Damage one row of a file whose columns have different meanings.

    Args:
        rng: Draws.
        rows: The words of the rows.
        columns: Those that hold numbers.
        places: Those that hold a latitude, a longitude or a height.
        shortest: A row loses a word from this column on.
        marks: What no odd word may hold, because it means something in the format.
        separator: What stands between words.
    """
    what = rng.choice(
        ("word", "range", "short", "random") if places else ("word", "short", "random")
    )
    row = rng.choice(rows[1:] if separator == "," or not places else rows)
    match what:
        case "word":
            row[rng.choice(columns)] = rng.choice(_no_numbers(marks))
        case "range":
            row[rng.choice(places)] = rng.choice(("-4e7", "1e7", "5e200"))
        case "short":
            if places:
                del row[rng.randrange(shortest, 5) :]
            else:
                del row[rng.randrange(len(row))]
        case _:
            return at_random(rng, _file(rows, what, separator=separator).content)
    return _file(rows, what, separator=separator)


def poses(rng: random.Random) -> Case:
    """Rows of poses_gt.txt, for submaps 0 to 2."""
    rows = [f"{k} {k}.5 0.25 -1 0 0 0 1".split() for k in range(3)]
    match rng.choice(("rows", "rows", "quaternion", "index")):
        case "quaternion":
            rows[1][rng.choice((4, 5, 6, 7))] = rng.choice(("0.5", "7", "-2"))
            return _file(rows, "quaternion")
        case "index":
            rows[1][0] = rng.choice(("0", "3", "1.5", "-1", "1e300", "2"))
            return _file(rows, "index")
        case _:
            return _lines_case(rng, rows)


def trajectory(rng: random.Random) -> Case:
    """TUM rows with covariance, or KITTI's rows."""
    if rng.random() < 0.3:
        rows = [f"1 0 0 {k} 0 1 0 0 0 0 1 0".split() for k in range(3)]
        return _lines_case(rng, rows)
    identity = ["1" if row == column else "0" for row in range(6) for column in range(6)]
    rows = [[*f"{k} 0 0 0 0 0 0 1".split(), *identity] for k in range(3)]
    if rng.random() < 0.2:
        rows[2][8 + rng.choice((1, 2, 6, 0))] = "-3"
        return _file(rows, "covariance")
    return _lines_case(rng, rows)


def times(rng: random.Random) -> Case:
    rows = [[f"{k}.25"] for k in range(4)]
    case = _lines_case(rng, rows, whole=False)
    # A time may be any number.
    return replace(case, damaged=case.damaged and case.what == "bytes")


def mount(rng: random.Random) -> Case:
    rows = [rng.choice(("0 0 1 0 0 0 1", "1 0 0 0 0 1 0 0 0 0 1 0.5")).split()]
    return _lines_case(rng, rows)


def positions(rng: random.Random) -> Case:
    """Rows of a truth of positions: time, x, y and z."""
    rows = [f"{k}.5 {k} -2.25 0".split() for k in range(3)]
    return _columns_case(rng, rows, (1, 2, 3))


def solution(rng: random.Random) -> Case:
    """A .pos of RTKLIB."""
    rows = [f"2021/07/08 10:00:0{k}.500 37.72 14.99 2012.3 1 12".split() for k in range(3)]
    return _columns_case(rng, rows, (0, 1, 2, 3, 4), places=(2, 3, 4), shortest=1, marks="%")


def katwijk(rng: random.Random) -> Case:
    """Rows of gps-latlong.txt."""
    rows = [f"2015_11_26_12_53_3{k}_149 4 52.21 4.42 5.5 0.01".split() for k in range(3)]
    return _columns_case(rng, rows, (0, 2, 3, 4), places=(2, 3, 4), shortest=1, marks="")


def places_table(rng: random.Random) -> Case:
    """A table of PLACES."""
    names = ["frame", "site", "drive", "northing", "easting", "elevation", "yaw", "pitch", "roll"]
    rows = [names, *([*f"ROVER 1 {k} 5000 -300 12 30 1 -2".split()] for k in range(2))]
    if rng.random() < 0.25:
        names[rng.randrange(1, 9)] = rng.choice(("x", "", "yaws"))
        return _file(rows, "column", separator=",")
    return _columns_case(rng, rows, tuple(range(1, 9)), marks=',"', separator=",")


def matrix(rng: random.Random) -> Case:
    """The 4x4 matrix of a .gt."""
    rows = [row.split() for row in ("1 0 0 5", "0 1 0 -3", "0 0 1 0.5", "0 0 0 1")]
    if rng.random() < 0.3:
        place = rng.choice(((0, 0), (1, 1), (1, 2), (3, 3), (3, 0)))
        rows[place[0]][place[1]] = rng.choice(("-1.5", "2", "1e200", "0.4"))
        return _file(rows, "no motion")
    return _lines_case(rng, rows)


def problems(rng: random.Random) -> Case:
    """A file of the registration benchmark."""
    names = ["id", "source", "target", "overlap", *(f"t{k}" for k in range(1, 13))]
    motion = ["1", "0", "0", "5", "0", "0", "-1", "2", "0", "1", "0", "0.5"]
    rows = [names, ["7", "a_000.pcd", "a_001.pcd", "0.25", *motion]]
    if rng.random() < 0.2:
        return replace(_lines_case(rng, rows[:1]), sound=False)  # it holds no problem
    if rng.random() < 0.25:
        rows[1][rng.choice((4, 5, 9, 10, 13))] = rng.choice(("3", "-7", "1e200"))
        return _file(rows, "motion")
    return _columns_case(rng, rows, tuple(range(3, 16)), marks="")


UPPER = ["1" if row == column else "0" for row in range(6) for column in range(row, 6)]


def g2o(rng: random.Random) -> Case:
    rows = [f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1".split() for k in range(3)]
    rows += [["EDGE_SE3:QUAT", str(k), str(k + 1), "1", *"000001", *UPPER] for k in (0, 1)]
    what = rng.choice(("rows", "rows", "vertex", "information", "tag"))
    match what:
        case "vertex":
            rows[rng.choice((3, 4))][rng.choice((1, 2))] = rng.choice(
                ("7", "-1", "0.5", "0" * 5000)
            )
            if rows[3][1:3] == ["0", "1"] and rows[4][1] == "0" * 5000:
                return Case(b"x", what, damaged=True)
        case "information":
            rows[3][rng.choice((10, 16, 21))] = rng.choice(("0", "-1", "1e30", "-1e300"))
        case "tag":
            rows[rng.randrange(5)][0] = rng.choice(("VERTEX_SE2", "EDGE", "vertex", "0", "#\0"))
        case _:
            return _lines_case(rng, rows)
    return _file(rows, what)


def _toml_nasty(rng: random.Random) -> Case:
    """What takes a parser too long or too deep."""
    size = rng.choice((100, 1000, 30_000, 49_000))
    text = rng.choice(
        (
            ".".join("a" * size) + " = 1", "x = " + "[" * size, "x = " + "{a=" * size,
            f"x = {'9' * size}",
            "[" + ".".join("a" * size) + "]", f'x = "{"a" * 1_100_000}"',
            f"{'a' * 3}.'b'." * size + "c=1",
            "x = " + "[" * size + "]" * size, f"x = 1e{'9' * size}", f"x = 0x{'f' * size}",
            "name = '''" + "[" * size, "[a]\n" * size, 'x = "\\u0000', "\0", '"""' + "\\" * size,
        )
    )  # fmt: skip
    return Case(text.encode(), "nasty", damaged=True)


def _toml(rng: random.Random, text: str, values: dict[str, tuple[str, ...]]) -> Case:
    """Damage TOML: give a key a wrong value, or damage any place."""
    what = rng.choice(("value", "value", "nasty", "unknown", "random", "random"))
    if what == "nasty":
        return _toml_nasty(rng)
    if what == "random":
        return at_random(rng, text.encode())
    lines = text.split("\n")
    if what == "unknown":
        return Case(("strange = 1\n" + text + "\n[[closed").encode(), what, damaged=True)
    key, wrong = rng.choice(tuple(values.items()))
    place = next(k for k, line in enumerate(lines) if line.startswith(f"{key} ="))
    lines[place] = f"{key} = {rng.choice(wrong)}"
    return Case("\n".join(lines).encode(), f"value of {key}", damaged=True)


NO_TEXT = ("1", "true", "[]", "{}", "1979-05-27", "nan", "'''", "[[1], 2]")
NO_NUMBER = ("'1'", "true", "[]", "{}", "1979-05-27", "nan", "inf", "1e400", "9" * 60, "-1",
             "9" * 5000, "--1")  # fmt: skip


def about(rng: random.Random) -> Case:
    text = (
        'name = "hills"\ndescription = "of sand"\n[sensor_noise]\nconstant = 0.01\n[preferred]\n'
        'query = "001"\n[preferred.map]\nlength_scale = 0.3\n'
    )
    values = {
        "name": NO_TEXT, "description": NO_TEXT, "constant": NO_NUMBER, "query": (*NO_TEXT,
        "'009'"),
        "length_scale": NO_NUMBER,
    }  # fmt: skip
    return _toml(rng, text, values)


def params(rng: random.Random) -> Case:
    text = (
        "[map]\nlength_scale = 0.3\n[registration]\ntrials = 100\nseed = 1\n"
        "[matching]\nmutual = true\n"
    )
    values = {
        "length_scale": NO_NUMBER, "trials": (*NO_NUMBER, "1.5"), "mutual": ("1", "'true'", "[]"),
        "seed": tuple(one for one in (*NO_NUMBER, "1.5") if one != "-1"),
    }  # fmt: skip
    return _toml(rng, text, values)


def session(rng: random.Random) -> Case:
    text = (
        'dataset = "/tmp/hills"\nquery = "001"\ndatabase = "000"\n[camera]\nposition = [0, 1, 2]\n'
        "look_at = [0, 0, 0]\n[params.map]\nlength_scale = 0.3\n[view]\n"
    )
    no_point = ("[]", "[1, 2]", "[true, 1, 2]", "[nan, 1, 2]", "[1e300, 1, 2]", "'x'", "[[1], 2]")
    values = {
        "dataset": (*NO_TEXT, '"a\\u0000b"', "'" + "a" * 5000 + "'"), "query": NO_TEXT,
        "database": NO_TEXT,
        "position": no_point, "look_at": no_point, "length_scale": NO_NUMBER,
    }  # fmt: skip
    return _toml(rng, text, values)


PAIR: dict[str, Any] = {
    "query": "001", "database": "000", "num_inliers": 9, "score": 0.5, "dissimilarity": 1.0,
    "overlap_area": 30.0, "accepted": True, "reason": "9 inliers",
    "T_database_query": {"x": 1.0, "y": 2.0, "yaw": 0.5}, "z_offset": 0.25,
    "covariance": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "z_std": 0.1, "scale": 1.0,
    "agreement": {"difference": 0.1, "possible": 0.1, "relief": 1.0},
}  # fmt: skip
REPORT: dict[str, Any] = {
    "dataset": "hills", "method": "gradient", "seed": 0, "params": {"map": {}},
    "versions": {"numpy": "2"},
    "seconds": {"total": 1.0}, "submaps": [{"id": "000", "num_points": 9}, {"id": "001",
    "num_points": 9}],
    "pairs": [PAIR],
}  # fmt: skip
OPTIONAL = ("z_offset", "covariance", "z_std", "scale", "agreement")


def closures(rng: random.Random) -> Case:
    report = json.loads(json.dumps(REPORT))
    pair = report["pairs"][0]
    what = rng.choice(
        ("pair", "pair", "motion", "top", "covariance", "text", "twice", "gone", "random")
    )
    no_number = ("9", [], {}, True, float("nan"), float("inf"), "false")
    match what:
        case "pair":
            key = rng.choice(
                ("num_inliers", "score", "overlap_area", "accepted", "reason", "query")
            )
            wrong = {
                "num_inliers": (*no_number, -1, 1.5, 10**12, 10**30, None),
                "score": (*no_number, None), "overlap_area": (*no_number, -1, None),
                "accepted": ("false", "true", 0, 1, None, []), "reason": (1, None, []),
                "query": (1, None, "000", "009", []),
            }[key]  # fmt: skip
            pair[key] = rng.choice(wrong)
        case "motion":
            motion = pair["T_database_query"]
            motion[rng.choice(tuple(motion))] = rng.choice((*no_number, None, 1e300))
            if rng.random() < 0.2:
                pair["T_database_query"] = rng.choice(([], {}, 1, "x", [[1, 0], [0, 1]]))
        case "covariance":
            odd = ([[1, 0], [0, 1]], [1, 2, 3], [[1, 0, 0]], [[1, 0, 0], [0, 1], [0, 0, 1]], "x",
            {},
                   [[1, 0, 0], [0, -1, 0], [0, 0, 1]], [[1, 5, 0], [0, 1, 0], [0, 0, 1]],
                   [[1e300] * 3] * 3, [["1", 0, 0], [0, 1, 0], [0, 0, 1]], [[True] * 3] * 3,
                   0)  # fmt: skip
            pair["covariance"] = rng.choice(odd)
        case "top":
            key = rng.choice(tuple(report))
            report[key] = rng.choice(
                (None, 1.5, [1], "x" if key not in ("dataset", "method") else 1)
            )
        case "twice":
            rng.choice((report["pairs"], report["submaps"])).append(
                pair if rng.random() < 0 else report["submaps"][0]
            )
        case "gone":
            key = rng.choice([key for key in pair if key not in OPTIONAL])
            del pair[key]
        case "text":
            nasty = ("{", "[]", "{}", "", "[" * 100_000, '{"a":' * 50_000,
            '{"dataset": ' + "9" * 5000 + "}",
                     '{"seed": NaN}', '{"seed": 1, "seed": 2}', '"' + "\\" * 999, "\0", "1e999",
                     "[" * 40 + "]" * 40)  # fmt: skip
            return Case(rng.choice(nasty).encode(), what, damaged=True)
        case _:
            return at_random(rng, json.dumps(report).encode())
    return Case(json.dumps(report).encode(), what, damaged=True)
