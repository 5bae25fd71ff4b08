"""`vntoolkit recipe list|run`: the experiments of the paper, one script each."""

import difflib
import logging
import runpy
import sys
import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import vntoolkit
from vntoolkit.cli.output import print_next, print_table, say
from vntoolkit.errors import BadInput, VntError
from vntoolkit.report.recipes_page import RecipeRun, read_recipe_text, write_recipes_page

_LOG = logging.getLogger(__name__)
_EXPERIMENTS = ("Figure", "Table")  # first words of the summary; other recipes make data and pictures


def run_recipe(name: str, *arguments: str, out: Path | str | None = None) -> None:
    """Run one recipe by its name, or all; arguments are its own options, such as "--quick"."""
    run_command(name, *arguments, out=None if out is None else Path(out))


def list_command() -> None:
    """Print the name and the purpose of every recipe."""
    rows = [[name, summary_of(path)] for name, path in recipes().items()]
    print_table("vntoolkit recipe run NAME", ["recipe", "what"], rows, names=2)
    print_next("recipe", "run", next(iter(recipes())), "--quick")


def run_command(
    name: str,
    /,
    *arguments: Annotated[str, Parameter(allow_leading_hyphen=True)],
    out: Path | None = None,
) -> None:
    """Run one recipe, or all figures and tables of the paper with a page of their numbers and pictures.

    Parameters
    ----------
    name
        A name that `vntoolkit recipe list` shows, or all.
    arguments
        Options of the recipe, such as --data DIR; --quick where there is a shorter form. `-- --help` lists
        them.
    out
        Folder to write. Default: out/NAME; with all: out.
    """
    if name == "all":
        _run_all(out or Path("out"), list(arguments))
        return
    found = recipes()
    if name not in found:
        close = difflib.get_close_matches(name, found, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise BadInput(f"recipe '{name}': expected all, or one of {', '.join(found)}{hint}")
    understood = list(arguments)
    if "--quick" in arguments and '"--quick"' not in found[name].read_text("utf-8"):
        say(f"{name} has no shorter form: it runs in full")
        understood.remove("--quick")
    _run(found[name], ["--out", str(out or Path("out") / name), *understood])
    names = list(found)
    print_next("recipe", "run", names[(names.index(name) + 1) % len(names)])


def recipes() -> dict[str, Path]:
    """Return the scripts by name, from the installed package or from its repository."""
    package = Path(vntoolkit.__file__).parent
    for folder in (package / "recipes", package.parent / "recipes"):
        found = {path.stem: path for path in sorted(folder.glob("*.py"))}
        if found:
            return found
    raise BadInput(f"recipes: expected scripts in {package / 'recipes'}, got none; install the package again")


def summary_of(path: Path) -> str:
    """Return the first line of a script's docstring."""
    return read_recipe_text(path).summary


def _run(path: Path, arguments: list[str]) -> None:
    before = sys.argv
    sys.argv = [str(path), *arguments]
    try:
        runpy.run_path(str(path), run_name="__main__")
    finally:
        sys.argv = before


def _run_all(out: Path, arguments: list[str]) -> None:
    """Run every experiment; the page lists a failed one, and the others still run."""
    runs = []
    for name, path in recipes().items():
        text = read_recipe_text(path)
        if not text.summary.startswith(_EXPERIMENTS):
            continue
        print()
        say(f"{name}: {text.summary}", flush=True)
        started, failure = time.perf_counter(), ""
        try:
            _run(path, ["--out", str(out / name), *_understood(path, arguments)])
        except VntError as error:
            failure = str(error)
        except SystemExit as stopped:  # argparse: an argument is missing
            failure = f"did not run: see `vntoolkit recipe run {name} -- --help`" if stopped.code else ""
        except Exception as error:  # one fault must not lose hours of other recipes
            _LOG.exception("%s", name)
            failure = f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - started
        runs.append(RecipeRun(name=name, text=text, folder=out / name, seconds=seconds, failure=failure))
    page = write_recipes_page(out / "recipes.html", runs)
    failed = [run.name for run in runs if run.failure]
    say(f"{page}: {len(runs) - len(failed)} recipes" + (f"; failed: {', '.join(failed)}" if failed else ""))
    print_next("recipe", "list")


def _understood(path: Path, arguments: list[str]) -> list[str]:
    """Return those `--flag [value]` arguments whose flag the script has."""
    text, kept, known = path.read_text("utf-8"), [], True
    for argument in arguments:
        if argument.startswith("--"):
            known = f'"{argument}"' in text
        if known:
            kept.append(argument)
    return kept
