"""The pages name only what is there: links, files, modules, tests, notes on decisions."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    path
    for folder in (".", "benchmarks", "docs", "docs/benchmarks", "docs/decisions", "outputs")
    for path in (ROOT / folder).glob("*.md")
)
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))  # which are run with the site
# Pages that say how things are now; a note on a decision says how they were.
PRESENT = [ROOT / name for name in ("ARCHITECTURE.md", "docs/notation.md", "docs/physics.md")]
GUIDES = [
    ROOT / "docs" / f"{name}.md"
    for name in ("choosing", "coming-from", "errors", "index", "scenes", "theory", "units")
]
DECISIONS = ROOT / "docs" / "decisions"

each_page = pytest.mark.parametrize(
    "page", PAGES + TUTORIALS, ids=lambda page: str(page.relative_to(ROOT))
)
each_present_page = pytest.mark.parametrize("page", PRESENT, ids=lambda page: page.name)


def prose(page):
    """Return the lines of a page that are neither code nor rows of a table."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S)
    return [line for line in text.splitlines() if not line.startswith(("|", "    "))]


def anchor(heading):
    """Return what a heading is linked by."""
    return re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")


def anchors(page):
    return {anchor(line.lstrip("#")) for line in prose(page) if line.startswith("#")}


@each_page
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if "://" not in target:
            name, _, place = target.partition("#")
            linked = (page.parent / name).resolve() if name else page
            assert linked.exists(), target
            assert not place or place in anchors(linked), target


@each_present_page
def test_files_are_there(page):
    top = "treecode|mrs|scenarios|benchmarks|tests|docs"
    names = re.findall(rf"`((?:{top})/[\w./-]*)`", page.read_text())
    assert names
    assert not [name for name in names if not (ROOT / name).exists()]


@pytest.mark.parametrize("page", PRESENT + GUIDES + TUTORIALS, ids=lambda page: page.name)
def test_lines_are_short(page):
    assert not [line for line in prose(page) if len(line) > 110]


@pytest.mark.parametrize("package", ["treecode", "mrs", "mrs/output", "mrs/run"])
def test_architecture_lists_the_modules(package):
    table = (ROOT / "ARCHITECTURE.md").read_text().partition(f"| in `{package}/` |")[2]
    rows = table.partition("\n\n")[0].splitlines()[2:]
    listed = [name for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])]
    found = {
        path.name + "/" * path.is_dir()
        for path in (ROOT / package).iterdir()
        if path.suffix in (".py", ".json") or (path / "__init__.py").exists()
    }
    assert sorted(listed) == sorted(found - {"__init__.py"})


def messages():
    """Yield all texts in the sources, with dots for what is filled in."""
    for path in [*(ROOT / "mrs").rglob("*.py"), *(ROOT / "treecode").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                yield "".join(
                    part.value if isinstance(part, ast.Constant) else "..." for part in node.values
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_messages_that_are_explained_are_those_of_the_code():
    explained = re.findall(r"^### (.+)$", (ROOT / "docs" / "errors.md").read_text(), flags=re.M)
    texts = "\n".join(messages())
    assert explained
    assert [heading for heading in explained if heading.strip(" .:") not in texts] == []


def test_every_page_is_on_the_site():
    docs = ROOT / "docs"
    linked = set(re.findall(r"\]\(((?:tutorials/)?[\w-]+\.md)\)", (docs / "index.md").read_text()))
    pages = [*docs.glob("*.md"), *TUTORIALS]
    assert linked | {"index.md"} == {path.relative_to(docs).as_posix() for path in pages}


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.name)
def test_all_code_of_a_tutorial_is_run(page):
    """The build of the site runs code cells, with the kernel that the page names."""
    text = page.read_text()
    assert text.startswith("---\nfile_format: mystnb\nkernelspec:\n  name: python3\n---\n\n# ")
    fences = re.findall(r"^```.*$", text, flags=re.M)
    assert fences == ["```{code-cell}", "```"] * (len(fences) // 2)
    for code in re.findall(r"^```{code-cell}\n(.*?)^```$", text, flags=re.M | re.S):
        ast.parse(code)


def test_cited_tests_are_there():
    text = (ROOT / "docs" / "physics.md").read_text()
    cited = re.findall(r"`(test_\w+\.py)::(\w+)`", text)
    assert len(cited) == text.count("::")
    for file, name in cited:
        tree = ast.parse((ROOT / "tests" / file).read_text())
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert name in names, f"{file}::{name}"


def test_every_decision_is_a_dated_note_in_the_index():
    notes = sorted(DECISIONS.glob("[0-9]*.md"))
    lines = [
        f"* [{note.name[:4]}]({note.name}) {note.read_text().splitlines()[0].split('. ', 1)[1]}"
        for note in notes
    ]
    assert [int(note.name[:4]) for note in notes] == list(range(1, len(notes) + 1))
    index = " ".join((DECISIONS / "README.md").read_text().split())
    assert all(line in index for line in lines)
    assert index.count(".md) ") == len(notes)
    for note in notes:
        title, _, date, *_ = note.read_text().splitlines()
        assert title.startswith(f"# {note.name[:4]}. ")
        assert re.match(r"\d{4}-\d\d-\d\d", date), note.name
