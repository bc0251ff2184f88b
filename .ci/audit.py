#!/usr/bin/env python3
"""Asks whether advisories are known against the libraries of this environment, and warns of them.

    .ci/audit.py

It asks the database of PyPI, and that of OSV where PyPI cannot be asked, through pip-audit, which
the extra `dev` brings. An advisory is news from outside and no fault of a change, so the exit code
is 0 whatever it finds; where neither database can be reached, it says that nothing was checked.
"""

import json
import os
import subprocess
import sys

DATABASES = ("pypi", "osv")
TIMEOUT = 300.0
"""Time for all libraries together [s]."""


def ask(database: str) -> str:
    """Ask a database about what is installed; gives pip-audit's JSON, or what it said instead."""
    command = [sys.executable, "-m", "pip_audit", "--local", "--skip-editable"]
    options = ["--format", "json", "--progress-spinner", "off", "--timeout", "10"]
    try:
        asked = subprocess.run(
            [*command, *options, "--vulnerability-service", database],
            capture_output=True,
            text=True,
            check=False,
            timeout=TIMEOUT,
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {TIMEOUT:.0f} s"
    return asked.stdout or (asked.stderr.strip().splitlines() or ["pip-audit said nothing"])[-1]


def read(answer: str) -> tuple[int, list[str]]:
    """Read what pip-audit says.

    Returns:
        How many libraries the database knows, and a line for each advisory. A library that the
        database could not be asked about is not among them, although pip-audit counts it as sound.

    Raises:
        ValueError: If it is no answer.
    """
    libraries = json.loads(answer)["dependencies"]
    checked = [library for library in libraries if "skip_reason" not in library]
    lines = [
        f"{library['name']} {library['version']}: {advisory['id']}"
        + (f", mended in {', '.join(advisory['fix_versions'])}" if advisory["fix_versions"] else "")
        for library in checked
        for advisory in library["vulns"]
    ]
    return len(checked), lines


def main() -> int:
    """Ask the databases in turn until one knows the libraries, and print what it says."""
    warning = "::warning::" if os.environ.get("GITHUB_ACTIONS") else "WARNING: "
    for database in DATABASES:
        try:
            count, lines = read(ask(database))
        except (ValueError, KeyError, TypeError):  # what it says instead of an answer
            continue
        if count:
            for line in lines:
                print(f"{warning}{line}")
            print(f"{count} libraries checked by {database}: {len(lines)} advisories")
            return 0
    print(f"{warning}no database of advisories can be reached from here: nothing was checked")
    return 0


if __name__ == "__main__":
    sys.exit(main())
