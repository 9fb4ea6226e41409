"""What `make docs` does besides MkDocs: pages made from the code, links out of docs/, diagrams.

- `reference/verbs.md` from click, `reference/rig-keys.md` from the rig file's models,
  `reference/python.md` for mkdocstrings from the public names, `reference/commands.md`: which test
  runs which command of the documents;
- CHANGELOG, CONTRIBUTING, SECURITY, and each source file that a page links to, as pages;
- the figures of the gallery, by the page's own commands (`site_gallery`);
- notebooks as pages; Mermaid's text as SVG (`site_diagrams`), formulas as MathML (`site_math`);
- a page that would load something from the network ends the build.
"""

from __future__ import annotations

import importlib
import inspect
import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from coulombus.cli.errors import STATUSES
from coulombus.cli.main import main
from coulombus.rigs.axis import Sections
from coulombus.rigs.field_help import accepted_range, fields_of, kinds_of, named_in, unit_of

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "scripts"), str(ROOT / "tests" / "support")]
from documented import as_page as commands_page  # noqa: E402, I001
from site_diagrams import svg  # noqa: E402
from site_gallery import FOLDER, PAGE, pictures, shown  # noqa: E402
from site_math import STYLE, raw_formula, typeset  # noqa: E402
from site_records import records_page  # noqa: E402

PROJECT = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
LINK = re.compile(r"(!?\[[^]]*\])\(([^)\s]+)\)")
MERMAID = re.compile(r"^```mermaid\n(.*?)^```$", re.M | re.S)
LOADED = re.compile(
    r"""<(?:script|img|iframe|link(?![^>]*rel="canonical"))\b[^>]*\b(?:src|href)=["']?(?:https?:)?//[^>]*>"""
)
TORN = re.compile(r"<em [^>]*>[^<]*</em>|<em>[^<]*[=|_{}][^<]*</em>")
"""Emphasis that begins and ends within formulas."""

FROM_DISK = """<script>
if (location.protocol === "file:") window.Worker = class extends EventTarget {
  constructor(url) {
    super()
    const frame = document.createElement("iframe"), script = document.createElement("script")
    frame.hidden = true
    document.body.append(frame)
    this.inside = frame.contentWindow
    this.inside.postMessage = data => this.dispatchEvent(new MessageEvent("message", {data}))
    this.ready = new Promise(done => script.onload = done)
    script.src = url
    frame.contentDocument.body.append(script)
  }
  postMessage(data) { this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", {data}))) }
  terminate() {}
}
</script>"""
"""The search runs in a worker, which a page opened from the disk may not have: there it runs in a
frame.
"""

FAQ_BOOST = 8
"""Weight of the FAQ among the results of a search; other pages have 1."""

NOT_FOUND = """
<p>The address has no page. The search at the top finds pages by their words.</p>
<ul>
<li><a href="index.html">First page</a></li>
<li><a href="faq.html">FAQ</a></li>
<li><a href="reference/verbs.html">All verbs</a></li>
<li><a href="runbook.html">The display stopped: runbook</a></li>
</ul>
"""
NOT_FOUND_ROOT = """<script>
{
  const parts = location.pathname.split("/").slice(0, -1), base = document.createElement("base")
  const at = parts.findIndex(part => FOLDERS.includes(part))
  base.href = (at < 0 ? parts : parts.slice(0, at)).join("/") + "/"
  document.head.append(base)
}
</script>"""
"""A server shows the page at the wrong address: its links begin at the site's first folder."""

API = ("coulombus", "coulombus.analysis", "coulombus.lab", "coulombus.recording")
"""The packages whose public names docs/api.md lists."""

BESIDE = ("coulombus.rigs.rig.Rig", "coulombus.host.laws.law.Parameters", "coulombus.monitor.callbacks.LiveBus")
"""Classes that the public functions return or take."""


def documented_names() -> dict[str, list[str]]:
    """Return what `reference/python.md` shows: a heading, and full names."""
    shown: dict[str, list[str]] = {}
    seen: set[str] = set()
    for package in API:
        values = [getattr(importlib.import_module(package), name) for name in importlib.import_module(package).__all__]
        names = [f"{value.__module__}.{value.__qualname__}" for value in values]
        shown[f"`{package}`"] = [name for name in names if name not in seen]
        seen.update(names)
    return {**shown, "Classes beside them": list(BESIDE)}


def verbs_page() -> str:
    """Return the reference of the command line, from click."""
    parts = [
        "# The verbs\n\nEach verb of `coulombus`, with its options and examples. The page is",
        "made from the program itself: `coulombus VERB --help` says the same.\n\n## Exit statuses\n",
        "| status | meaning |\n|---|---|",
        *(f"| {status} | {_cell(text)} |" for status, text in STATUSES.items()),
    ]
    for verb in main.commands.values():
        parts += _verb(verb, f"coulombus {verb.name}", "##")
    return "\n".join(parts) + "\n"


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")


def _verb(command: click.Command, name: str, head: str) -> Iterator[str]:
    context = click.Context(command, info_name=name)
    yield f"\n{head} `{name}`\n"
    yield f"    {name} {' '.join(command.collect_usage_pieces(context))}\n"
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        if paragraph.startswith("\b"):
            first, *rest = paragraph[1:].strip("\n").splitlines()
            yield f"{first}\n" if first.endswith(":") else f"    {first}"
            yield "\n".join(f"    {line.strip()}" for line in rest) + "\n"
        else:
            yield _cell(paragraph).replace("\\|", "|") + "\n"
    records = [record for p in command.get_params(context) if (record := p.get_help_record(context)) is not None]
    if records:
        yield "| option | what it does |\n|---|---|"
        yield from (f"| `{names.replace('|', chr(92) + '|')}` | {_cell(text)} |" for names, text in records)
        yield ""
    for sub in getattr(command, "commands", {}).values():
        yield from _verb(sub, f"{name} {sub.name}", "###")


def rig_keys_page() -> str:
    """Return all keys of the rig file, from its models."""
    parts = [
        "# The keys of the rig file\n\nEach key: what it accepts, its unit, its default. The page is",
        "made from the models that check the file. What a key is for stands in [the rig file](../rig-file.md).\n",
    ]
    for section, model in _sections(Sections, ()):
        parts += [f"\n## `{section}`\n\n| key | unit | accepted | default | meaning |\n|---|---|---|---|---|"]
        for key, info in fields_of(model).items():
            if kinds_of(info) or named_in(info):
                continue
            default = "required" if info.is_required() else f"`{_default(info)}`"
            accepted = accepted_range(info) or ("text" if info.annotation is str else "")
            cells = (f"`{key}`", unit_of(key), _cell(accepted), default, _cell(info.description or ""))
            parts.append("| " + " | ".join(cells) + " |")
    return "\n".join(parts) + "\n"


def _default(info: Any) -> str:
    value = info.get_default(call_default_factory=True)
    return json.dumps(list(value) if isinstance(value, tuple) else value) if value is not PydanticUndefined else ""


def _sections(model: type[BaseModel], above: tuple[str, ...]) -> Iterator[tuple[str, type[BaseModel]]]:
    for key, info in fields_of(model).items():
        named, kinds = named_in(info), kinds_of(info)
        path = (*above, key)
        if named is not None:
            yield f"[{'.'.join(path)}.NAME]", named
        for kind, section in kinds.items():
            many = "tuple" in str(info.annotation)
            brackets = ("[[", "]]") if many else ("[", "]")
            if any(not kinds_of(field) and named_in(field) is None for field in fields_of(section).values()):
                yield f"{brackets[0]}{'.'.join(path)}{brackets[1]}" + (f" of kind {kind}" if kind else ""), section
            yield from _sections(section, path)


def python_page() -> str:
    """Return the page that mkdocstrings fills with signatures, units, shapes and sources."""
    parts = [
        "# Python\n\nThe public names of the package, with units, shapes and errors. The page is made from",
        "the docstrings. [The Python API](../api.md) has them in a table, and promises which stay.",
    ]
    for title, names in documented_names().items():
        parts += [f"\n## {title}\n", *(f"::: {name}\n" for name in names)]
    return "\n".join(parts) + "\n"


def notebook_page(path: Path) -> str:
    """Return a notebook's cells as a page."""
    parts = []
    for cell in json.loads(path.read_text())["cells"]:
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    return "\n\n".join(parts) + "\n"


def source_page(path: Path) -> str:
    """Return a file of the repository as a page."""
    name = path.relative_to(ROOT)
    language = {".py": "python", ".toml": "toml", ".eds": "ini"}.get(path.suffix, "text")
    head = f"---\nsearch:\n  exclude: true\n---\n\n# {name}\n\nThe file `{name}` of the repository.\n\n"
    return f"{head}~~~~{language}\n{path.read_text()}\n~~~~\n"


def place_of(path: Path) -> str:
    """Return where a file of the repository is on the site."""
    name = path.relative_to(ROOT)
    if name.parts[0] == "docs":
        return str(Path(*name.parts[1:]))
    if str(name) in PROJECT:
        return f"project/{name}"
    return "index.md" if str(name) == "README.md" else f"repository/{name}.md"


def _pages() -> Iterator[tuple[Path, str]]:
    """Yield every page that people wrote, with its text."""
    for path in [*(ROOT / "docs").rglob("*.md"), *(ROOT / name for name in PROJECT)]:
        yield path, path.read_text()
    for path in (ROOT / "docs").rglob("*.ipynb"):
        yield path, notebook_page(path)


def _target(path: Path, link: str) -> Path | None:
    """Return the file that a link of a page names, where it is one of the repository."""
    name = link.partition("#")[0]
    if not name or "://" in link or link.startswith("mailto:"):
        return None
    file = (path.parent / name).resolve()
    return file if file.is_relative_to(ROOT) else None


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that nobody wrote."""
    pages = {
        "reference/verbs.md": verbs_page(),
        "reference/rig-keys.md": rig_keys_page(),
        "reference/python.md": python_page(),
        "reference/records.md": records_page(),
        "reference/commands.md": commands_page(),
        **{f"project/{name}": (ROOT / name).read_text() for name in PROJECT},
    }
    for path, text in _pages():
        for _, link in LINK.findall(text):
            target = _target(path, link)
            if target is not None and target.is_file() and place_of(target).startswith("repository/"):
                pages[place_of(target)] = source_page(target)
        if path.suffix == ".ipynb":
            place = place_of(path)
            files.remove(files.get_file_from_path(place))
            pages[place.removesuffix(".ipynb") + ".md"] = notebook_page(path)
    try:
        for name, content in pictures((ROOT / "docs" / PAGE).read_text()).items():
            files.append(File.generated(config, f"{FOLDER}/{name}", content=content))
    except RuntimeError as error:
        raise PluginError(f"{PAGE}: {error}") from error
    for place, text in pages.items():
        file = File.generated(config, place, content=text)
        if place.startswith("repository/"):
            file.inclusion = file.inclusion.NOT_IN_NAV
        files.append(file)
    return files


def on_config(config: Any) -> Any:
    """Name notebooks as the pages that they become."""
    config["nav"] = json.loads(json.dumps(config["nav"]).replace(".ipynb", ".md"))
    return config


def on_page_markdown(text: str, page: Any, config: Any, files: Files) -> str:
    """Turn links to files of the repository into links of the site, and diagrams into SVG."""
    place = page.file.src_path
    if place.startswith(("repository/", "reference/")):
        return text
    if place == PAGE:
        text = shown(text)
    if place == "faq.md":  # a question in the search's field is a heading there
        page.meta["search"] = {"boost": FAQ_BOOST}
    written = ROOT / "docs" / place
    if place.startswith("project/"):
        written = ROOT / Path(place).name
    elif not written.exists():
        written = written.with_suffix(".ipynb")

    def link(match: re.Match[str]) -> str:
        target = _target(written, match[2])
        if target is None or not target.exists():  # MkDocs warns of a link to nowhere
            return match[0]
        if target.is_dir():  # the site has none
            return match[1].strip("[]")
        site_path = place_of(target)
        site_path = site_path.removesuffix(".ipynb") + ".md" if site_path.endswith(".ipynb") else site_path
        hash_ = match[2].partition("#")[1] + match[2].partition("#")[2]
        return f"{match[1]}({os.path.relpath(site_path, Path(place).parent)}{hash_})"

    text = MERMAID.sub(lambda match: f"<div>{svg(match[1])}</div>\n", text)
    pieces = re.split(r"(^```.*?^```$|`[^`\n]+`)", text, flags=re.M | re.S)
    return "".join(piece if n % 2 else LINK.sub(link, piece) for n, piece in enumerate(pieces))


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Typeset the formulas of a page."""
    try:
        return typeset(html)
    except ValueError as error:
        raise PluginError(f"{page.file.src_path}: {error}") from error


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Refuse a page that loads from the network; let the search run from the disk."""
    if fault := LOADED.search(output):
        raise PluginError(f"{page.file.src_path} loads from the network: {fault[0]}")
    if fault := TORN.search(output):
        raise PluginError(f"{page.file.src_path}: a formula was read as emphasis: {fault[0]}; write \\_ and \\*")
    if fault := raw_formula(output):
        raise PluginError(
            f"{page.file.src_path}: a formula was not typeset: {fault}; write $...$ or $$ on its own line"
        )
    style = STYLE if "<math" in output else ""
    return output.replace("</head>", f"{style}{FROM_DISK}</head>", 1)


def on_post_template(output: str, template_name: str, config: Any) -> str:
    """Let the page for a wrong address work in any folder, and from the disk: relative links."""
    if template_name != "404.html":
        return output
    output = re.sub(r'((?:href|src)="|"search": ")/(?!/)', r"\1", output).replace('"base": "/"', '"base": "."')
    folders = sorted({Path(file).parts[0] for file in _places() if len(Path(file).parts) > 1})
    root = NOT_FOUND_ROOT.replace("FOLDERS", json.dumps(folders))
    output = re.sub(r"(<h1>404[^<]*</h1>)", rf"\1{NOT_FOUND}", output, count=1)
    return output.replace("<head>", f"<head>{root}", 1).replace("</head>", f"{FROM_DISK}</head>", 1)


def _places() -> Iterator[str]:
    """Yield the place of each page that is in a folder of the site."""
    yield from (place_of(path) for path, _ in _pages())
    yield from ("reference/verbs.md", "repository/a.md")


def on_post_build(config: Any) -> None:
    """Write the index of the search as a script, too: a page that is opened from the disk may read
    no other kind of file.
    """
    folder = Path(config["site_dir"]) / "search"
    (folder / "search_index.js").write_text(f"var __index = {(folder / 'search_index.json').read_text()}")
