"""Every command that stands in a block of the documents, and what becomes of it: run by a test, or
the reason why not.

    .venv/bin/python tests/support/documented.py

prints the list. A command is run by `tests/project/test_commands.py` unless a rule below says otherwise;
the first rule that matches "PAGE: COMMAND" counts. The site shows the same list.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from places import ROOT

HERE = "run by tests/project/test_commands.py"
FIRST = re.compile(
    r"([A-Z_]+=\S+ )*(\S*/)?(coulombus|make|pip|python3?|tshark|git|podman|cantools|candump|canplayer|can_\w+|"
    r"ci|echo|printf|mkfifo|dask|wireshark|head|grep|sed|cmp|wc|kill|sudo|for|timeout)(?=\s|$)"
)
MACHINE = "changes the machine's settings: for a rig's PC"
LIVE = "needs a bus or a host that lives: "
RULES = (
    # other tests run the page
    (r"docs/deploy\.md: ", "run by tests/cli/test_afternoon.py"),
    (r"docs/tutorials/sweep\.md: (dask|.*--dask)", "needs a cluster; tests/lab/sweep runs a sweep on one"),
    (r"docs/tutorials/", "run by tests/project/test_tutorials.py"),
    (r"docs/service\.md: (?!.*socketcan)", "run by tests/project/test_commands.py, on a live bus"),
    (
        r"docs/gallery\.md: coulombus diff",
        "ends with 1, as they differ; the site runs it: tests/project/test_site_gallery.py",
    ),
    (r"docs/gallery\.md: coulombus identify", "needs strokes, 13 s of a recording; the site runs it"),
    (
        r": python examples/worlds/(stability_map|stiffness|z_width)",
        "forty runs: tests/lab/test_world_examples.py makes some",
    ),
    (r"docs/plane\.md: coulombus analyse plane", "run by tests/cli/test_plane_command.py"),
    (r": coulombus analyse laws", "run by tests/analysis/theory/test_law_benchmarks.py"),
    (r"docs/export\.md: coulombus (export|plot|diff)", "run by tests/cli/test_export_docs.py"),
    # what installs, tests and measures this project
    (r": (sudo|echo|for)", MACHINE),
    (r": (make|git|pip|python3 -m venv|scripts/ci)", "installs or tests this checkout: .ci/run does the same"),
    (r": python -m pytest examples/ci", "run by tests/test_examples.py"),
    (r": .*(-m pytest|scripts/mutate)", "runs tests within tests: .ci/run and docs/safety.md have the runs"),
    (r": .*-m benchmarks", "a measurement of minutes to hours; the page has its figures"),
    (r": NUMBA_DISABLE_JIT=1 ", "everything in plain Python: `make fast` does it"),
    # hardware
    (r"--bus can:", "needs an adapter: tests/cli/test_adapter_verbs.py runs such verbs without hardware"),
    (r"socketcan:|: candump", "needs a CAN interface: tests/vm runs such verbs in a virtual machine"),
    (r"docs/months\.md: ", LIVE + "tests/host and tests/recording run `run --rotate`, `status` and `systemd`"),
    # living buses and programs with a window
    (r": can_(logger|player)", LIVE + "tests/sim_bus/server/test_other_clients.py runs both"),
    (r": can_viewer", "fills a terminal; tests/wire tries python-can's interface"),
    (r": timeout 300 sh", LIVE + "tests/sim_bus"),
    (r": kill", LIVE + "tests/lab replays such a session"),
    (r"wireshark", "opens a window; tests/monitor pipe the same bytes into tshark"),
    (r": coulombus demo", "half a minute in real time: tests/host/run/test_run.py"),
    (r": (coulombus )?(\S*)conformance|--junit", "a minute of real time: tests/conformance, tests/sim_bus"),
    (r": (coulombus emulate\b|.*coulombus run\b)", LIVE + "tests/host and tests/sim_bus"),
    (r": coulombus (watch|.*&& )|mkfifo|monitor -i", LIVE + "tests/monitor"),
    (r": coulombus (set|mark|replay .*--bus)", LIVE + "tests/host, tests/recording, tests/lab"),
    (
        r": coulombus (node|bridge|clear|inject (?!--list))|own_device\.(py|eds) .*coulombus:|--bus coulombus:bench --eds",
        LIVE + "tests/sim_bus",
    ),
    (r": coulombus world", LIVE + "tests/monitor/web/test_world_gateway.py"),
    (r": coulombus commission", "minutes of virtual time: tests/cli/test_commission_command.py"),
    (r": coulombus sweep", "64 runs: tests/cli/test_sweep_command.py runs smaller ones"),
    (r": coulombus experiment", "a study of many trials: tests/cli/test_experiment_command.py runs shorter ones"),
    (r": coulombus analyse study", "reads a study's folder: docs/tutorials/study.md analyses the one that it makes"),
    (r"--sensor amplifier", "files of three makers: tests/cli/test_init_command.py"),
    (r"\| jq ", "needs jq: tests/cli/test_eds_command.py and tests/monitor/test_decode.py read the JSON"),
)


class Documented(NamedTuple):
    """One command: where it stands, and what becomes of it."""

    page: str
    line: str
    fate: str


def pages() -> list[Path]:
    """Return the documents, in order."""
    tops = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")]
    return [*tops, *sorted((ROOT / "docs").rglob("*.md"))]


def commands_of(text: str) -> Iterator[str]:
    """Yield the command lines of a page's indented blocks, continuations joined."""
    fenced = False
    for line in re.sub(r" *\\\n\s+", " ", text).splitlines():
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced and line.startswith("    ") and FIRST.match(line.strip()):
            yield re.sub(r"\s+# .*$", "", line.strip())


def plain_formulas(text: str) -> str:
    r"""Return a page whose formulas between dollars are as programs print them: `$\sigma_2 \ge 0$` as sigma_2 >= 0."""

    def plain(found: re.Match[str]) -> str:
        latex = re.sub(r"\\operatorname\{(\w+)\}", r"\1", found[1]).replace(r"\ge", ">=")
        return re.sub(r"\\(\w+)", r"\1", latex)

    return re.sub(r"\$([^$\n]+)\$", plain, text)


def strangers(text: str) -> Iterator[str]:
    """Yield the lines of a page's indented blocks that are no commands: what a program prints, and
    text of other languages, stands between fences.
    """
    fenced = False
    for line in re.sub(r" *\\\n\s+", " ", text).splitlines():
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced and line.startswith("    ") and not FIRST.match(line.strip()):
            yield line


def rule_of(page: str, line: str) -> int | None:
    """Return which rule a command falls under; None: it is run here."""
    return next((n for n, (pattern, _) in enumerate(RULES) if re.search(pattern, f"{page}: {line}")), None)


def documented() -> list[Documented]:
    """Return every command of the documents."""
    found = []
    for path in pages():
        page = str(path.relative_to(ROOT))
        for line in commands_of(path.read_text()):
            rule = rule_of(page, line)
            found.append(Documented(page, line, HERE if rule is None else RULES[rule][1]))
    return found


def as_page() -> str:
    """Return the list as a page."""
    found = documented()
    run = sum("run by " in one.fate for one in found)
    lines = [
        "# All commands\n\nWhich command of these documents is run by which test, and why",
        f"the others are not. Of {len(found)} commands tests run {run}. Commands within sentences are not run:",
        "`tests/project/test_docs.py` compares their verbs and options with the program.\n\n| page | command | |\n|---|---|---|",
    ]
    escaped = ((one.page, one.line.replace("|", "\\|"), one.fate) for one in found)
    return "\n".join([*lines, *(f"| {page} | `{line}` | {fate} |" for page, line, fate in escaped)]) + "\n"


if __name__ == "__main__":
    for one in documented():
        print(f"{one.page}: {one.line}\n    {one.fate}")
