"""The entry point: prints an error as one line, returns the exit status."""

# Nothing that is not loaded yet is imported here: a Ctrl-C before `main` leaves a traceback.
import _thread
import errno
import os
import sys
import time

# What a shell may have left there that libraries stumble over: figures are files, and a terminal of no width
# is as good as none.
os.environ["MPLBACKEND"] = "agg"
for _name in ("COLUMNS", "LINES"):
    if os.environ.get(_name, "80").strip("0") == "" or not os.environ.get(_name, "80").isascii():
        del os.environ[_name]

INTERRUPTED = 130  # the shell's convention for SIGINT
OWN_FAULT = 70  # EX_SOFTWARE of sysexits.h
_OUT_OF_CALLBACK_S = 0.1  # Python has left the hook by then, on a busy machine too
_REFUSALS_OF_THE_SYSTEM = {
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENOTDIR,
    errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.EMFILE, errno.ENFILE, errno.ESTALE,
}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status: 0 done, 1 error, 70 internal error, 130 interrupted."""
    try:
        from vntoolkit.threads import thread_policy  # inside: a Ctrl-C while it loads leaves no traceback

        with _NoInterruptLost(), thread_policy():
            return _run(arguments)
    except KeyboardInterrupt as interrupt:
        hint = str(interrupt) or "run the same command again to continue"
        print(f"\nvntoolkit: interrupted: {hint}", file=sys.stderr)
        _let_go(interrupt)
        return INTERRUPTED


def run() -> None:
    """Run the command line and exit the process with its status.

    After `main`, SIGINT gets its default action: a Ctrl-C while Python shuts down then leaves no traceback.
    """
    status = main()
    import signal

    if (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ):  # a background job of a shell ignores SIGINT
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(status)


class _NoInterruptLost:
    """Raise KeyboardInterrupt again where Python only prints it, as in a callback from compiled code."""

    def __enter__(self) -> None:
        self.before = sys.unraisablehook
        sys.unraisablehook = self.hook

    def __exit__(self, *_: object) -> None:
        sys.unraisablehook = self.before

    def hook(self, unraisable: "sys.UnraisableHookArgs") -> None:
        """Take what is to be printed."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            # Not threading.Timer: its start waits, on a busy machine until the interrupt strikes in here.
            _thread.start_new_thread(_interrupt_soon, ())
        else:
            self.before(unraisable)


def _let_go(interrupt: KeyboardInterrupt) -> None:
    """Free what the interrupted calls held, and do not tell if something half built fails to close."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        interrupt.__traceback__ = None
    finally:
        sys.unraisablehook = before


def _interrupt_soon() -> None:
    time.sleep(_OUT_OF_CALLBACK_S)
    _thread.interrupt_main()


def _run(arguments: list[str] | None) -> int:
    from cyclopts import CycloptsError

    from vntoolkit.cli import run_verb
    from vntoolkit.cli.messages import line_from_refusal, line_from_unforeseen, line_from_usage_error
    from vntoolkit.errors import VntError

    _set_up_logging()
    _print_whatever_comes()
    try:
        _require_sound_date()
        result = run_verb(arguments if arguments is not None else sys.argv[1:])
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except CycloptsError as error:
        return _fail(line_from_usage_error(error))
    except VntError as error:
        return _fail(f"{error}; see {error.page}" if error.page else str(error))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError as error:
        return _fail(line_from_unforeseen(error))
    except OSError as error:
        if error.errno not in _REFUSALS_OF_THE_SYSTEM:
            return _fail(line_from_unforeseen(error), OWN_FAULT)
        if error.filename is None:  # most likely of the standard output: what is held back is lost
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _fail(line_from_refusal(error))
    except SystemError as error:
        if _began_with_interrupt(error):
            raise KeyboardInterrupt from error
        return _fail(line_from_unforeseen(error), OWN_FAULT)
    except Exception as error:  # whatever is left becomes one line and a file with the traceback
        return _fail(line_from_unforeseen(error), OWN_FAULT)


def _began_with_interrupt(error: BaseException | None) -> bool:
    """True for a SystemError that compiled code made of the KeyboardInterrupt that struck within it."""
    while isinstance(error, SystemError):
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


def _fail(message: str, status: int = 1) -> int:
    import contextlib

    from vntoolkit.errors import printable_line
    from vntoolkit.shipped import with_guide

    with contextlib.suppress(OSError):
        print(f"vntoolkit: {printable_line(with_guide(message))}", file=sys.stderr)
    return status


def _print_whatever_comes() -> None:
    """Show as its escape what the terminal's encoding, or a name that is no UTF-8, has no character for."""
    import contextlib

    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, OSError):  # not a text file, or closed
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def _require_sound_date() -> None:
    if "SOURCE_DATE_EPOCH" in os.environ:
        from vntoolkit.io.results.manifest import now_utc

        now_utc()


def _set_up_logging() -> None:
    import logging

    from vntoolkit.cli.messages import OneLineFormatter

    shown = logging.StreamHandler()
    shown.setFormatter(OneLineFormatter("vntoolkit: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[shown])
    logging.getLogger("vntoolkit.diagnosis").setLevel(logging.INFO)  # what could not be checked is said
    logging.getLogger("vntoolkit.native").setLevel(logging.INFO)  # what is compiled takes a while
    if not sys.warnoptions:  # what libraries warn of tells a user nothing: what came of it is checked
        import warnings

        warnings.simplefilter("ignore")


if __name__ == "__main__":
    run()
