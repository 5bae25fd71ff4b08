"""The site: every finding has its section, every public name its place, every command runs as printed.

The pages run in the order of the navigation, in one folder that holds the films of `studio`: what one page
makes, the next may read.
"""

import importlib.util
import re
import sys
import tomllib
from pathlib import Path

import pytest

import vntoolkit
from tests.readme_commands import ROOT, next_of, run_step, steps_of
from vntoolkit import errors
from vntoolkit.__main__ import main
from vntoolkit.cli import GROUPS, VERBS
from vntoolkit.diagnosis.table import CHECK_NAMES
from vntoolkit.shipped import guide_section

DOCS = ROOT / "docs"
NAVIGATION = re.findall(r"^ +- .*: (\w+\.md)$", (ROOT / "mkdocs.yml").read_text(), flags=re.MULTILINE)


def findings_hook():
    spec = importlib.util.spec_from_file_location("findings", DOCS / "findings.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["findings"] = module  # where its dataclass looks for itself
    spec.loader.exec_module(module)
    return module


def test_every_finding_has_a_section_with_a_cause_and_what_the_program_prints() -> None:
    hook, page = findings_hook(), (DOCS / "wrong.md").read_text()
    assert sorted(hook.headings(page)) == sorted(CHECK_NAMES)
    assert all(hook.of_check(name) for name in CHECK_NAMES)
    for name in CHECK_NAMES:
        told = page.split(f"## `{name}`\n", 1)[1].split("\n## ", 1)[0]
        assert len(told.split()) > 10, f"{name}: no cause"


def test_every_error_names_a_section_of_the_guide() -> None:
    headings = set(re.findall(r"(?m)^### .* \{ #([\w-]+) \}$", (DOCS / "wrong.md").read_text()))
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and kind.__dict__.get("page")]
    assert {kind.page for kind in kinds} == {f"docs/wrong.md#{name}" for name in headings}
    assert not errors.BadInput.page  # its message says all


def test_messages_name_the_page_that_is_there_and_the_report_tells_its_sections(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["doctor", "nowhere.mkv"]) == 1
    page, _, section = re.search(r"see (\S+)", capsys.readouterr().err)[1].partition("#")
    assert f"{{ #{section} }}" in Path(page).read_text()
    assert all(guide_section(name) for name in CHECK_NAMES)
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["force-include"]["docs/wrong.md"] == "vntoolkit/docs/wrong.md"


def test_every_public_name_is_in_the_reference() -> None:
    page = (DOCS / "api.md").read_text()
    listed = set(re.findall(r"^::: (\S+)$", page, flags=re.MULTILINE))
    assert listed == {f"{module}.{name}" for name, module in vntoolkit._PUBLIC.items()}
    examples = "\n".join(step.text for step in steps_of(page) if step.language == "python")
    for name, module in vntoolkit._PUBLIC.items():
        assert f"vt.{name}" in examples or module.startswith("vntoolkit.cli."), f"vt.{name}: no example"


def test_the_navigation_names_every_page() -> None:
    assert sorted(NAVIGATION) == sorted(path.name for path in DOCS.glob("*.md"))


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(DOCS.glob("*.md"))], ids=lambda page: page.stem)
def test_every_verb_that_a_page_names_is_there(page: Path) -> None:
    text = page.read_text()
    printed = "\n".join(
        re.findall(r"`(vntoolkit [^`\n]+)`", text) + re.findall(r"(?ms)^```\w+\n(.*?)^```", text)
    )
    for verb, second in re.findall(r"(?m)^vntoolkit ([a-z][a-z-]*)(?: ([a-z]+))?", printed):
        assert verb in VERBS or verb in GROUPS, f"{page.name} names `vntoolkit {verb}`"
        if verb in GROUPS and second:
            assert f"{verb} {second}" in VERBS, f"{page.name} names `vntoolkit {verb} {second}`"


def test_the_licences_are_those_of_the_lock() -> None:
    pinned = re.findall(r"(?m)^([a-z0-9][\w.-]*)==", (ROOT / "requirements.lock").read_text())
    listed = re.findall(r"(?m)^\| ([a-z0-9][\w.-]*) \|", (DOCS / "licences.md").read_text())
    assert sorted(set(pinned)) == [name for name in listed if name != "package"]


def test_the_version_is_one() -> None:
    cited = re.search(r"(?m)^version: (\S+)$", (ROOT / "CITATION.cff").read_text())
    assert cited[1] == vntoolkit.__version__
    major, minor, _ = vntoolkit.__version__.split(".")
    released = re.search(r"(?m)^## (\d+)\.(\d+)", (ROOT / "CHANGELOG.md").read_text())
    assert released is None or released.groups() == (major, minor)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [p for p in NAVIGATION if any(s.is_run for s in steps_of((DOCS / p).read_text()))]
)
def test_every_command_of_a_page_runs_and_the_next_one_is_a_verb(page: str, studio: Path) -> None:
    for step in steps_of((DOCS / page).read_text()):
        if step.is_run:
            for following in next_of(run_step(step, studio)):
                verb, second = (*following.text.split()[1:], "", "")[:2]
                assert verb in VERBS or f"{verb} {second}" in VERBS, following.text
