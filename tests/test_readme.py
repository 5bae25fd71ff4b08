"""Every command in the README runs as printed, in its order, beside the films of `studio` and data/."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.readme_commands import NOT_RUN, ROOT, Step, run_step, steps_of

README = ROOT / "README.md"


@pytest.mark.slow
def test_every_command_of_the_readme_runs(studio: Path) -> None:
    (studio / "data").symlink_to(ROOT / "data")
    steps = [step for step in steps_of(README.read_text()) if step.is_run]
    assert steps
    for step in steps:
        run_step(step, studio)


SAMPLE = """# Title

```sh
make demo   # not run
# a comment
echo one \\
     two
vntoolkit view out
```

```python
print(6 * 7)
```

```text
rm -rf nothing
```
"""


def test_blocks_are_read_as_a_person_would() -> None:
    steps = steps_of(SAMPLE)
    assert [(step.text, step.line) for step in steps if step.language == "sh"] == [
        ("make demo   # not run", 4),
        ("echo one two", 6),
        ("vntoolkit view out", 8),
    ]
    assert [step.is_run for step in steps] == [False, True, True, True]
    assert [step.serves for step in steps if step.language == "sh"] == [False, False, True]
    assert not Step("sh", "vntoolkit view out --html scene.html", 1).serves
    assert "make" in NOT_RUN
    assert not Step("sh", "vntoolkit live --camera 0 --rig rig.json", 1).is_run
    assert Step("sh", "vntoolkit live --video capture.mkv --rig rig.json", 1).is_run


def test_a_failing_command_is_named_with_its_line(tmp_path: Path) -> None:
    assert run_step(Step("sh", "echo one; pwd", 1), tmp_path).split() == ["one", str(tmp_path)]
    assert run_step(Step("python", "print(6 * 7)", 1), tmp_path) == "42\n"
    assert run_step(Step("python", r"print('it\'s')", 1), tmp_path) == "it's\n"  # no words of a shell
    with pytest.raises(AssertionError, match=r"line 17: exit status 3\n  exit 3"):
        run_step(Step("sh", "exit 3", 17), tmp_path)
    which = run_step(Step("sh", "command -v python", 1), tmp_path).strip()
    version = subprocess.run([which, "-V"], capture_output=True, text=True, check=True).stdout
    assert version.split()[1] == sys.version.split()[0]
