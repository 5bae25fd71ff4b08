"""Every row of docs/measured.md: measures them, and writes the page.

python -m benchmarks.measure [JOB ...] [--data DIR] [--out out/measure]     # all: an hour on two cores
python -m benchmarks.measure --page                                         # only writes the page again

A job is a recipe or a benchmark that writes numbers.json. Its numbers go to docs/measured.json with the date;
docs/measured.md is docs/measured.md.j2 filled with them. DIR holds photographs, scans and gels (by default
VNTOOLKIT_REAL_DATA); without it, their rows keep what was measured before.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jinja2

from vntoolkit.io.atomic import write_text
from vntoolkit.report.recipes_page import read_numbers

ROOT = Path(__file__).parent.parent
STORE, TEMPLATE, PAGE = (ROOT / "docs" / f"measured.{end}" for end in ("json", "md.j2", "md"))
DATA = "DATA"  # stands for --data in a command

# job -> its command; jobs of a family stand together, the page says in which table
JOBS: dict[str, tuple[str, ...]] = {
    **{name: (f"recipes/{name}.py",) for name in ("figure02", "figure05", "figure06", "figure07")},
    "figure04": ("recipes/figure04.py",),
    "figure04_spandex": ("recipes/figure04.py", "--scene", "spandex"),
    "figure08": ("recipes/figure08.py", "--frames", "40"),
    "figure10": ("recipes/figure10.py", "--frames", "40"),
    "figure11": ("recipes/figure11.py",),
    **{name: (f"recipes/{name}.py", "--quick") for name in ("figure03", "head_and_board")},
    "materials": ("recipes/materials.py",),
    "real_objects": ("recipes/real_objects.py", "--data", DATA),
    "expected_errors": ("-m", "benchmarks.expected_errors", "--seeds", "1", "2"),
    "mistakes": ("-m", "benchmarks.mistakes"),
    "integration": ("-m", "benchmarks.integration", "--data", DATA),
    "gels": ("-m", "benchmarks.gels", "--data", DATA),
    "painted_objects": ("-m", "benchmarks.painted_objects", "--data", f"{DATA}/normal_integration"),
    "ratios": ("-m", "benchmarks.ratios"),
}


def command_of(job: str) -> str:
    """Return the command that prints a job's numbers, as the page shows it."""
    script, *rest = JOBS[job]
    if script == "-m":
        return " ".join(["python -m", *rest]).replace(DATA, "DIR")
    return " ".join(["vntoolkit recipe run", Path(script).stem, *rest]).replace(DATA, "DIR")


def measured(job: str, out: Path, data: Path | None) -> dict[str, Any] | None:
    """Run a job and return its date and numbers; None where it needs `data` and there is none."""
    if DATA in " ".join(JOBS[job]) and data is None:
        return None
    arguments = [each.replace(DATA, str(data)) for each in JOBS[job]]
    subprocess.run([sys.executable, *arguments, "--out", str(out / job)], check=True, cwd=ROOT)
    numbers = {each.what: [each.ours, each.unit] for each in read_numbers(out / job)}
    return {"date": datetime.date.today().isoformat(), "numbers": numbers}


def page_of(store: dict[str, Any]) -> str:
    """Return docs/measured.md: the template with the numbers of `store`; an unknown name is an error."""

    def value(job: str, what: str, digits: int = 2) -> str:
        ours = store[job]["numbers"][what][0]
        return ours if isinstance(ours, str) else f"{float(f'{ours:.{digits}g}'):g}"

    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, keep_trailing_newline=True)
    template = environment.from_string(TEMPLATE.read_text())
    dates = {job: each["date"] for job, each in store.items()}
    return template.render(v=value, command=command_of, date=dates)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=", ".join(JOBS))
    parser.add_argument("--data", type=Path, default=os.environ.get("VNTOOLKIT_REAL_DATA"))
    parser.add_argument("--out", type=Path, default=Path("out/measure"))
    parser.add_argument("--page", action="store_true", help="measure nothing")
    arguments = parser.parse_args()
    if unknown := set(arguments.jobs) - set(JOBS):
        parser.error(f"unknown jobs: {', '.join(sorted(unknown))}; expected some of {', '.join(JOBS)}")
    store = json.loads(STORE.read_text()) if STORE.exists() else {}
    for job in () if arguments.page else arguments.jobs or JOBS:
        started = time.perf_counter()
        if (found := measured(job, arguments.out, arguments.data)) is None:
            print(f"{job}: left out, it needs --data", flush=True)
            continue
        store[job] = found
        write_text(STORE, json.dumps(store, indent=1, sort_keys=True) + "\n")
        print(f"{job}: {len(found['numbers'])} numbers in {time.perf_counter() - started:.0f} s", flush=True)
    write_text(PAGE, page_of(store))
    print(PAGE)


if __name__ == "__main__":
    main()
