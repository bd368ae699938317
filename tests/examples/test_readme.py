"""README and docs: the Python runs, the commands are those promised, the links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import celestcore
import pytest

pytest.importorskip("matplotlib").use("Agg")

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page: Path, *languages: str) -> list[str]:
    """Return the fenced blocks of a page in these languages, in order."""
    fence = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    return [body for language, body in fence.findall(page.read_text()) if language in languages]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=name)
def test_python_blocks_run_one_after_the_other(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {"__name__": "page"}
    for number, body in enumerate(blocks(page, "python"), start=1):
        exec(compile(body, f"{name(page)}, python block {number}", "exec"), scope)


def test_readme_has_python() -> None:
    assert blocks(README, "python")


def test_readme_sets_up_with_exactly_two_commands() -> None:
    lines = [line for body in blocks(README, "bash", "sh") for line in body.splitlines()]
    commands = [line.split("#")[0].strip() for line in lines if line.startswith("make ")]
    assert commands == ["make demo", "make test"]
    targets = (ROOT / "Makefile").read_text()
    assert all(f"\n{command.split()[1]}:" in targets for command in commands)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("https://", "mailto:")):
            continue
        target, _, heading = link.partition("#")
        file = (page.parent / target) if target else page
        assert file.exists(), f"{name(page)} links to {link}, which is not there"
        if heading:
            assert heading in headings(file), f"{name(page)}: no heading for {link}"


def headings(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as the forges make them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def _rust(modules: list[str]) -> str:
    """Source of a module, in a file of its own or in a folder's."""
    path = (ROOT / "rust/core/src").joinpath(*modules)
    return (
        path.with_suffix(".rs") if path.with_suffix(".rs").exists() else path / "mod.rs"
    ).read_text()


def test_the_equation_table_names_what_exists() -> None:
    table = (ROOT / "docs" / "theory.md").read_text().split("## From equation to function")[1]
    rows = [line.split("|") for line in table.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 10
    for _, _, rust, python, _ in rows:
        for path in re.findall(r"`([\w:]+)`", rust):
            *modules, item = path.split("::")
            source = _rust(modules)
            assert re.search(rf"\b(fn|struct) {item}\b", source), path
        for path in re.findall(r"`([\w.]+)`", python):
            found: object = celestcore
            for part in path.split("."):
                found = getattr(found, part)
