"""The documents: links lead somewhere, pictures exist, the README is short, and quoted messages are the code's own."""

from __future__ import annotations

import ast
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: Stands for a name or number, in the manual's messages and in those of the sources.
BLANK = "…"


def tracked(pattern: str) -> list[Path]:
    """Files of the repository that match, or all of the folder's where it is no checkout."""
    done = subprocess.run(
        ["git", "ls-files", pattern], cwd=ROOT, capture_output=True, encoding="utf-8", check=False
    )
    names = done.stdout.split() or [str(path.relative_to(ROOT)) for path in ROOT.glob(f"**/{pattern}")]
    return [ROOT / name for name in names]


PAGES = [page for page in tracked("*.md") if "build" not in page.parts and ".venv" not in str(page)]


def headings(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    titles = re.findall(r"^#+ (.+)$", text, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_exist(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith(("http:", "https:")):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.is_relative_to(ROOT), f"{page.name}: {target} leads out of the repository"
        assert file.exists(), f"{page.name}: there is no {target}"
        assert not anchor or anchor in headings(file), f"{page.name}: there is no heading {target}"


def test_the_readme_is_short():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 90
    assert {"    python3 dev.py demo", "    python3 dev.py test"} <= {
        line.partition("  #")[0].rstrip() for line in lines
    }


def test_history_stays_in_the_changelog():
    for page in PAGES:
        if page.name != "CHANGELOG.md" and "gigalit" not in page.parts:
            found = re.findall(
                r"\b(?=[0-9a-f]*[0-9])(?=[0-9a-f]*[a-f])[0-9a-f]{7}\b", page.read_text(encoding="utf-8")
            )
            assert not found, f"{page.name} names commits: {found}"


def test_files_and_symbols_that_are_named_exist():
    files = ["/" + path.relative_to(ROOT).as_posix() for path in tracked("*.py")]
    for page in PAGES:
        if page.name != "CHANGELOG.md":
            for name in re.findall(r"`([a-z0-9_/]+\.py)`", page.read_text(encoding="utf-8")):
                assert any(file.endswith("/" + name) for file in files), f"{page.name}: there is no {name}"
    method = (ROOT / "docs/method.md").read_text(encoding="utf-8")
    symbols = method[method.index("## Symbols") : method.index("## Sources")]
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "backend/dante_w").rglob("*.py"))
    words = set(re.findall(r"\w+", sources))
    for code in re.findall(r"`([^`]+)`", symbols):
        missing = set(re.findall(r"[A-Za-z_]\w+", code)) - words
        assert not missing, f"method.md: {code} is not in the backend"


def template(node: ast.AST) -> str | None:
    """A string of the sources with its blanks; None for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(template(part) or BLANK for part in node.values)
    return None


@cache
def templates() -> list[str]:
    """All strings of add-on and backend."""
    sources = [*(ROOT / "backend/dante_w").rglob("*.py"), *(ROOT / "dante_w_addon").rglob("*.py")]
    nodes = (node for source in sources for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))))
    return [text for text in map(template, nodes) if text]


def quotes(message: str, text: str) -> bool:
    """Whether all that stands between a message's blanks follows each other in a text.

    >>> quotes("…: is damaged (…); save it.", "…: is damaged (…); save it."), quotes("… is lost.", "… is found.")
    (True, False)
    """
    place = 0
    for part in message.split(BLANK):
        place = text.find(part.strip(": "), place)
        if place < 0:
            return False
    return True


def test_the_manual_quotes_messages_as_they_are():
    manual = (ROOT / "docs/manual.md").read_text(encoding="utf-8")
    quoted = re.findall(r"^\| `([^`]+)` \|", manual[manual.index("## Troubleshooting") :], flags=re.M)
    assert len(quoted) > 40
    unknown = [message for message in quoted if not any(quotes(message, text) for text in templates())]
    assert not unknown, "\n".join(unknown)
